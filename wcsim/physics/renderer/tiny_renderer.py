"""The reference renderer: the same triangles as PyBullet visuals, drawn by its TinyRenderer.

It is some eighty times slower than the rasteriser and holds the GIL; it is there to compare with.
It differs twice. TinyRenderer samples pixel corners: its pixel (u, v) is the ray through
(u, v + 1), where the rasteriser takes (u + 0.5, v + 0.5); `corner_shift` moves the rasteriser
there. And it never draws the back of a face.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from wcsim.core.closing import ClosingContextBase
from wcsim.core.frames import quaternion_from_ypr
from wcsim.errors import PhysicsError
from wcsim.physics.buffers import Images
from wcsim.physics.bullet import Bullet, pybullet
from wcsim.physics.renderer.base import Pinhole, check_images
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import Instances
from wcsim.physics.renderer.models.catalog import actor_templates
from wcsim.physics.renderer.models.paint import VARIANTS, Paint, class_paint_table
from wcsim.types import F64, U8, Bool, ClassId

_FACES_PER_BODY = 30_000  # Bullet takes 131072 vertices and 524288 indices a mesh at most
_PARKED_M = (0.0, 0.0, -1.0e5)  # where bodies wait that no actor needs in this picture


@dataclass(frozen=True, slots=True, order=True)
class _Model:
    """One template at one size in one paint: PyBullet cannot scale a body afterwards."""

    template: int
    scale_m: tuple[float, float, float]
    colour: int


class TinyRenderer(ClosingContextBase):
    """Draws a `GeometryStore` with PyBullet in a DIRECT client of its own."""

    def __init__(self, store: GeometryStore) -> None:
        """Connect and load the street.

        Raises:
            PhysicsError: PyBullet gave no client, or refused a mesh.
        """
        self._bullet = Bullet()
        self._class_of: U8 = np.zeros(0, np.uint8)  # by body number
        self._instance_of: dict[int, int] = {}  # by body the row of its instance in this picture
        self._pool: dict[_Model, list[tuple[int, ...]]] = {}
        corners = store.arrays.vertices[store.global_faces()].astype(np.float64)
        for class_id in np.unique(store.arrays.face_class):
            own = corners[store.arrays.face_class == class_id]
            colour = class_paint_table()[class_id]
            for start in range(0, len(own), _FACES_PER_BODY):
                self._body(own[start : start + _FACES_PER_BODY], int(class_id), colour)

    def close(self) -> None:
        """Disconnect; a second call does nothing."""
        self._bullet.close()

    def render(
        self,
        camera: Pinhole,
        T_CW: F64,
        instances: Instances,
        out: Images,
        shown: Bool | None = None,
    ) -> None:
        """Draw into `out`; see `Renderer.render`, and the module on where pixels are sampled."""
        check_images(camera, out)
        if shown is None:
            shown = np.ones(len(instances), np.bool_)
        self._place(instances, np.flatnonzero(shown).tolist())
        width, height = camera.width_px, camera.height_px
        _, _, rgba, depth, body = self._bullet.getCameraImage(
            width,
            height,
            view_matrix(T_CW),
            projection_matrix(camera),
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
        )
        near, far = camera.near_m, camera.range_m
        # OpenGL's depth buffer is not linear: this undoes `projection_matrix`.
        z = far * near / (far - (far - near) * np.asarray(depth, np.float64).reshape(height, width))
        number = np.asarray(body, np.int64).reshape(height, width)
        hit = (number >= 0) & (z < far)
        out.depth_m[:] = np.where(hit, z, far)
        out.class_id[:] = np.where(hit, self._class_of[np.where(hit, number, 0)], ClassId.SKY)
        if out.instance is not None:
            rows = np.full(len(self._class_of), -1, np.int32)
            rows[list(self._instance_of)] = list(self._instance_of.values())
            out.instance[:] = np.where(hit, rows[np.where(hit, number, 0)], -1)
        if out.rgb is not None:
            out.rgb[:] = np.asarray(rgba, np.uint8).reshape(height, width, 4)[..., :3]

    def _place(self, instances: Instances, rows: Sequence[int]) -> None:
        """Put a body of the right model under these instances, and park the others."""
        used = Counter[_Model]()
        self._instance_of.clear()
        for i in rows:
            # Rounded: a model of the pool fits each actor of this size, whatever float32 changed.
            length, width, height = (round(float(side), 6) for side in instances.scale_m[i])
            colour = int(instances.colour_seed[i]) % VARIANTS
            model = _Model(int(instances.template[i]), (length, width, height), colour)
            pool = self._pool.setdefault(model, [])
            if used[model] == len(pool):
                pool.append(self._actor(model))
            turns = instances.yaw_rad[i], instances.pitch_rad[i], instances.roll_rad[i]
            q, p_W_m = quaternion_from_ypr(*map(float, turns)), instances.p_W_m[i].tolist()
            for body in pool[used[model]]:
                self._instance_of[body] = i
                self._bullet.resetBasePositionAndOrientation(body, p_W_m, q)
            used[model] += 1
        for model, pool in self._pool.items():
            for body in chain(*pool[used[model] :]):
                self._bullet.resetBasePositionAndOrientation(body, _PARKED_M, (0.0, 0.0, 0.0, 1.0))

    def _actor(self, model: _Model) -> tuple[int, ...]:
        """Bodies of one new actor, one a class, and one a colour of what shines."""
        table, t = actor_templates(), model.template
        vertices = table.vertices[table.vertices_of[t] : table.vertices_of[t + 1]]
        rows = slice(table.faces_of[t], table.faces_of[t + 1])
        corners = (vertices.astype(np.float64) * model.scale_m)[table.faces[rows]]
        classes, paints = table.face_class[rows].astype(np.int64), table.face_paint[rows]
        part = classes * 256 + np.where(paints >= Paint.UNLIT, paints, 0).astype(np.int64)
        bodies = []
        for number in np.unique(part):
            own, class_id = part == number, number // 256
            colour = table.paints[np.bincount(paints[own]).argmax(), model.colour]
            bodies.append(self._body(corners[own], int(class_id), colour.astype(np.float64)))
        return tuple(bodies)

    def _body(self, corners: F64, class_id: int, colour: F64) -> int:
        """A standing body of triangles (T, 3, 3).

        Raises:
            PhysicsError: PyBullet refused it.
        """
        vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        shape = self._bullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=vertices.tolist(),
            indices=index.ravel().tolist(),
            rgbaColor=[*(colour / 255.0).tolist(), 1.0],
        )
        body = int(self._bullet.createMultiBody(0, -1, shape)) if shape >= 0 else -1
        if body < 0:
            raise PhysicsError(
                f"PyBullet refused a visual mesh of {len(corners)} triangles (class {class_id})"
            )
        grown = np.zeros(max(body + 1, len(self._class_of)), np.uint8)
        grown[: len(self._class_of)] = self._class_of
        grown[body] = class_id
        self._class_of = grown
        return body


def corner_shift(T_CW: F64, focal_px: float) -> F64:
    """T_CW (3, 4) with which a renderer of pixel centres samples where TinyRenderer does."""
    shear = np.eye(3)
    shear[0, 2] = 0.5 / focal_px
    shear[1, 2] = -0.5 / focal_px
    return shear @ T_CW


def view_matrix(T_CW: F64) -> list[float]:
    """OpenGL's view matrix, column by column: its camera looks along -z and y is up."""
    view = np.eye(4)
    view[:3] = T_CW * np.array([1.0, -1.0, -1.0])[:, None]
    return view.T.ravel().tolist()


def projection_matrix(camera: Pinhole) -> list[float]:
    """OpenGL's projection matrix, column by column."""
    near, far = camera.near_m, camera.range_m
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2.0 * camera.focal_px / camera.width_px
    matrix[1, 1] = 2.0 * camera.focal_px / camera.height_px
    matrix[2, 2] = -(far + near) / (far - near)
    matrix[2, 3] = -2.0 * far * near / (far - near)
    matrix[3, 2] = -1.0
    return matrix.T.ravel().tolist()
