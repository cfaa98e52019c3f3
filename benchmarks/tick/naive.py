"""What one would write first: PyBullet alone, one body for each thing, its TinyRenderer as the camera.

Every actor of the simulation is mirrored, by a reset of its pose; the chair is the product's own, driven by two motors
that keep a speed. SUMO's step is left out of its time, since one process holds one SUMO: what it lacks is given to it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from wcsim.config import CameraConfig, ChairConfig
from wcsim.core.constants import GRAVITY_MPS2
from wcsim.core.own_folder import create_temporary_folder
from wcsim.physics.bullet import Bullet, pybullet
from wcsim.physics.renderer.tiny_renderer import projection_matrix, view_matrix
from wcsim.physics.sensors.camera_geometry import camera_matrix, mount, pinhole, pose_of
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.physics.wheelchair.plant_body import urdf
from wcsim.types import F32, F64, I32, ActorState, StreetMesh


class NaiveLoop:
    """Chairs in a street of bodies; close it."""

    def __init__(
        self,
        mesh: StreetMesh,
        camera: CameraConfig | None,
        starts: Sequence[tuple[F64, float]],
        substeps: int,
        tick_s: float,
    ) -> None:
        """Chairs at `starts` (place, heading) in a street; a tick is `tick_s` long and has `substeps` physics steps.

        Without a camera they see nothing.
        """
        self.bullet = Bullet()
        self.camera = camera
        self.actors: dict[str, tuple[int, float]] = {}
        self.substeps = substeps
        self.bullet.setGravity(0, 0, -GRAVITY_MPS2)
        self.bullet.setTimeStep(tick_s / substeps)
        for vertices, indices in things(mesh):
            self._solid(vertices, indices)
        self.chairs = [self._chair(start_W_m, yaw_rad) for start_W_m, yaw_rad in starts]
        joints = range(self.bullet.getNumJoints(self.chairs[0]))
        names = {self.bullet.getJointInfo(self.chairs[0], i)[1].decode(): i for i in joints}
        self.wheels = (names["wheel_l"], names["wheel_r"])

    def tick(self, actors: Sequence[ActorState], wheel_radps: tuple[float, float]) -> list[tuple[F32, I32]]:
        """One tick; for each chair depth in metres and body numbers, both (H, W)."""
        for actor in actors:
            if actor.id not in self.actors:
                self.actors[actor.id] = self._box(actor)
            body, half_height = self.actors[actor.id]
            x, y, z = actor.p_W_m
            turn = (0, 0, np.sin(actor.yaw_rad / 2), np.cos(actor.yaw_rad / 2))
            self.bullet.resetBasePositionAndOrientation(body, (x, y, z + half_height), turn)
        for chair in self.chairs:
            for wheel, speed in zip(self.wheels, wheel_radps, strict=True):
                self.bullet.setJointMotorControl2(
                    chair, wheel, pybullet.VELOCITY_CONTROL, targetVelocity=speed, force=60
                )
        for _ in range(self.substeps):
            self.bullet.stepSimulation()
        return [self._look(chair, self.camera) for chair in self.chairs] if self.camera else []

    def close(self) -> None:
        """End the engine."""
        self.bullet.close()

    def _chair(self, start_W_m: F64, yaw_rad: float) -> int:
        place = (*start_W_m[:2], start_W_m[2] + 0.02)
        turn = (0, 0, np.sin(yaw_rad / 2), np.cos(yaw_rad / 2))
        with create_temporary_folder() as folder:
            path = folder / "chair.urdf"
            path.write_text(urdf(plant_spec(ChairConfig())), encoding="utf-8")
            body: int = self.bullet.loadURDF(str(path), place, turn)
        return body

    def _look(self, chair: int, camera: CameraConfig) -> tuple[F32, I32]:
        lens = pinhole(camera)
        place, q = self.bullet.getBasePositionAndOrientation(chair)
        yaw_rad = pybullet.getEulerFromQuaternion(q)[2]
        T_CW = camera_matrix(pose_of(place, yaw_rad, 0.0), mount(camera))
        width, height, near, far = lens.width_px, lens.height_px, lens.near_m, lens.range_m
        _, _, _, depth, bodies = self.bullet.getCameraImage(
            width, height, view_matrix(T_CW), projection_matrix(lens), shadow=0,
            renderer=pybullet.ER_TINY_RENDERER)  # fmt: skip
        z = far * near / (far - (far - near) * np.asarray(depth, np.float32).reshape(height, width))
        return z, np.asarray(bodies, np.int32).reshape(height, width)

    def _solid(self, vertices: list[list[float]], indices: list[int]) -> None:
        flags = pybullet.GEOM_FORCE_CONCAVE_TRIMESH
        shape = self.bullet.createCollisionShape(pybullet.GEOM_MESH, vertices=vertices, indices=indices, flags=flags)
        look = self.bullet.createVisualShape(pybullet.GEOM_MESH, vertices=vertices, indices=indices)
        self.bullet.createMultiBody(0, shape, look)

    def _box(self, actor: ActorState) -> tuple[int, float]:
        half = [0.5 * side for side in actor.size_lwh_m]
        shape = self.bullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half)
        look = self.bullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=half)
        return self.bullet.createMultiBody(0, shape, look), half[2]


def things(mesh: StreetMesh) -> Iterator[tuple[list[list[float]], list[int]]]:
    """Vertices and indices of everything of one class in one cell of the street: a house, a piece of pavement."""
    for first, last in zip(mesh.chunk_faces[:-1], mesh.chunk_faces[1:], strict=True):
        faces, classes = mesh.faces[first:last], mesh.face_class[first:last]
        for class_id in np.unique(classes):
            used, indices = np.unique(faces[classes == class_id], return_inverse=True)
            yield mesh.vertices_W_m[used].astype(float).tolist(), indices.ravel().tolist()
