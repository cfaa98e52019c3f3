"""Embree as the oracle of the renderers, and random actors for the sample street."""

from __future__ import annotations

import math

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.instances import Instances, transforms
from wcsim.physics.renderer.store import GeometryStore
from wcsim.types import ActorKind, ActorState, ClassId

CAMERA = Pinhole(width_px=320, height_px=240, focal_px=168.6, near_m=0.1, range_m=40.0)

SIZES = {
    ActorKind.CAR: (4.6, 1.8, 1.5),
    ActorKind.TRUCK: (7.1, 2.4, 2.4),
    ActorKind.BUS: (12.0, 2.5, 3.4),
    ActorKind.TRAM: (22.0, 2.4, 3.2),
    ActorKind.MOTORCYCLE: (2.2, 0.9, 1.5),
    ActorKind.BICYCLE: (1.6, 0.65, 1.7),
    ActorKind.SCOOTER: (1.2, 0.5, 1.7),
    ActorKind.PEDESTRIAN: (0.215, 0.478, 1.719),
    ActorKind.WHEELCHAIR: (1.1, 0.62, 1.25),
    ActorKind.OTHER: (1.0, 0.7, 1.2),
}


def actor(kind, x, y, z=0.0, yaw=0.0, pitch=0.0, speed=1.3, size=None, number=0):
    return ActorState(
        id=f"{kind.value}{number}",
        kind=kind,
        p_W_m=np.array([x, y, z]),
        yaw_rad=yaw,
        pitch_rad=pitch,
        v_W_mps=speed * np.array([math.cos(yaw), math.sin(yaw), 0.0]),
        size_lwh_m=size or SIZES[kind],
    )


def crowd(seed, count=60):
    """Random actors of every kind on the sample street, turned and tilted at random."""
    rng = np.random.default_rng(seed)
    kinds = list(ActorKind)
    out = []
    for i in range(count):
        kind = kinds[i % len(kinds)] if i < 2 * len(kinds) else ActorKind.PEDESTRIAN
        x, y = rng.uniform(-5, 70), rng.uniform(-7, 7)
        yaw, pitch = rng.uniform(-math.pi, math.pi), rng.uniform(-0.1, 0.1)
        out.append(actor(kind, x, y, 0.12, yaw, pitch, number=i))
    return tuple(out)


def triangles(store: GeometryStore, instances: Instances):
    """Everything as one soup: corners (T, 3, 3) float64 and class (T,)."""
    corners = [store.vertices_W_m[store.global_faces()].astype(float)]
    classes = [store.face_class]
    table = store.templates
    for t, T_WM in zip(instances.template, transforms(instances), strict=True):
        vertices = table.vertices[table.vertices_of[t] : table.vertices_of[t + 1]].astype(float)
        rows = slice(table.faces_of[t], table.faces_of[t + 1])
        corners.append((vertices @ T_WM[:, :3].T + T_WM[:, 3])[table.faces[rows]])
        classes.append(table.face_class[rows])
    return np.concatenate(corners), np.concatenate(classes)


class Oracle:
    """Ray casts through pixel centres."""

    def __init__(self, store: GeometryStore, instances: Instances) -> None:
        corners, self.classes = triangles(store, instances)
        self.scene = rtcore_scene.EmbreeScene()
        faces = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
        self.mesh = TriangleMesh(self.scene, corners.reshape(-1, 3).astype(np.float32), faces)

    def image(self, camera: Pinhole, T_CW):
        """Depth (H, W) and class (H, W)."""
        R_WC = T_CW[:, :3].T
        u = (np.arange(camera.width_px) + 0.5 - camera.width_px / 2) / camera.focal_px
        v = (np.arange(camera.height_px) + 0.5 - camera.height_px / 2) / camera.focal_px
        gu, gv = np.meshgrid(u, v)
        direction = np.stack([gu, gv, np.ones_like(gu)], axis=-1).reshape(-1, 3) @ R_WC.T
        start = -R_WC @ T_CW[:, 3] + camera.near_m * direction  # what is nearer than the near plane is not drawn
        hit = self.scene.run(start.astype(np.float32), direction.astype(np.float32), output=1)
        depth = hit["tfar"] + camera.near_m
        found = (hit["primID"] >= 0) & (depth < camera.range_m)
        depth = np.where(found, depth, camera.range_m)
        classes = np.where(found, self.classes[hit["primID"]], ClassId.SKY)
        shape = (camera.height_px, camera.width_px)
        return depth.reshape(shape), classes.reshape(shape).astype(np.uint8)


def depth_agrees(depth, reference):
    """Where two depths are the same to 2 cm or 1 %."""
    return np.abs(depth - reference) <= np.maximum(0.02, 0.01 * reference)
