"""Ray casts through pixel centres with Embree, which shares no code with the renderers: what they are checked against.

It needs the package `embreex`, which only the development extra brings.
"""

from __future__ import annotations

import importlib.util

import numpy as np

from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import Instances
from wcsim.physics.renderer.models.catalog import actor_templates
from wcsim.types import F32, F64, U8, Bool, ClassId


def has_embree() -> bool:
    """Whether rays can be cast on this machine."""
    return importlib.util.find_spec("embreex") is not None


class RayOracle:
    """The street and the actors of one moment; raises ModuleNotFoundError without `embreex`, see `has_embree`."""

    def __init__(self, store: GeometryStore, instances: Instances) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        corners_W_m, self._class_of = triangles(store, instances)
        faces = np.arange(3 * len(corners_W_m), dtype=np.int32).reshape(-1, 3)
        self._scene = rtcore_scene.EmbreeScene()
        self._mesh = TriangleMesh(self._scene, corners_W_m.reshape(-1, 3).astype(np.float32), faces)

    def image(self, camera: Pinhole, T_CW: F64) -> tuple[F32, U8]:
        """Depth in metres and class, (H, W) each, of the camera at `T_CW` (3, 4)."""
        R_WC = T_CW[:, :3].T
        u = (np.arange(camera.width_px) + 0.5 - camera.width_px / 2) / camera.focal_px
        v = (np.arange(camera.height_px) + 0.5 - camera.height_px / 2) / camera.focal_px
        columns, rows = np.meshgrid(u, v)
        direction = np.stack([columns, rows, np.ones_like(columns)], axis=-1).reshape(-1, 3) @ R_WC.T
        start = -R_WC @ T_CW[:, 3] + camera.near_m * direction  # what is nearer than the near plane is not drawn
        hit = self._scene.run(start.astype(np.float32), direction.astype(np.float32), output=1)
        depth_m = hit["tfar"] + camera.near_m
        found = (hit["primID"] >= 0) & (depth_m < camera.range_m)
        shape = (camera.height_px, camera.width_px)
        classes = np.where(found, self._class_of[hit["primID"]], ClassId.SKY)
        return (
            np.where(found, depth_m, camera.range_m).reshape(shape).astype(np.float32),
            classes.reshape(shape).astype(np.uint8),
        )


def triangles(store: GeometryStore, instances: Instances) -> tuple[F64, U8]:
    """Everything as one soup: corners (T, 3, 3) in W and class (T,)."""
    corners = [store.arrays.vertices[store.global_faces()].astype(np.float64)]
    classes = [store.arrays.face_class]
    table = actor_templates()
    for t, T_WM in zip(instances.template, instances.placed.T_WM, strict=True):
        vertices = table.vertices[table.vertices_of[t] : table.vertices_of[t + 1]].astype(np.float64)
        rows = slice(table.faces_of[t], table.faces_of[t + 1])
        corners.append((vertices @ T_WM[:, :3].T + T_WM[:, 3])[table.faces[rows]])
        classes.append(table.face_class[rows])
    return np.concatenate(corners), np.concatenate(classes)


def depth_agrees(depth_m: F32, reference_m: F32) -> Bool:
    """Where two depths are the same to 2 cm or 1 %."""
    return np.asarray(np.abs(depth_m - reference_m) <= np.maximum(0.02, 0.01 * reference_m), np.bool_)
