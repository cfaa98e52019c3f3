"""Small streets and a driving loop for the tests of the wheelchair."""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from tests.support import actors
from wcsim.config import ChairConfig, ImuConfig
from wcsim.physics.engine import PARK_Z_M, Engine
from wcsim.physics.sensors.base import Surroundings
from wcsim.physics.wheelchair.wheelchair import Wheelchair
from wcsim.types import ActorKind, ActorState, ClassId, Contact, Joystick, PlantState, StreetMesh

FORWARD = Joystick(0.0, 1.0)
NEUTRAL = Joystick(0.0, 0.0)


def mesh(vertices, faces, classes) -> StreetMesh:
    """A street mesh of one chunk; `classes` is one ClassId or one for each face."""
    faces = np.asarray(faces, np.int32)
    return StreetMesh(
        vertices_W_m=np.asarray(vertices, np.float32),
        faces=faces,
        face_class=np.broadcast_to(np.asarray(classes, np.uint8), len(faces)).copy(),
        chunk_vertices=np.array([0, len(vertices)], np.int32),
        chunk_faces=np.array([0, len(faces)], np.int32),
    )


def step_street(rise_m: float, at_x_m: float = 3.0, wall: ClassId = ClassId.KERB) -> StreetMesh:
    """A road that ends in a step up (or down) across the way at `at_x_m`, pavement beyond."""
    x, h = at_x_m, rise_m
    vertices = [(-20, -10, 0), (x, -10, 0), (x, 10, 0), (-20, 10, 0)]
    vertices += [(x, -10, h), (30, -10, h), (30, 10, h), (x, 10, h)]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    classes = [ClassId.ROAD] * 2 + [ClassId.SIDEWALK] * 2
    if h:
        faces += [[2, 1, 4], [2, 4, 7]]
        classes += [wall, wall]
    return mesh(vertices, faces, classes)


def flat_street() -> StreetMesh:
    """Two large triangles at height 0."""
    return step_street(0.0)


def fan_street(count: int) -> StreetMesh:
    """A flat floor of `count` slivers that all meet in one point behind the start."""
    rim = [(40.0, y, 0.0) for y in np.linspace(-4.0, 4.0, count + 1)]
    vertices = [(-5.0, 0.3, 0.0), *rim, (-5.0, -4.0, 0.0), (-5.0, 4.0, 0.0)]
    faces = [[0, k, k + 1] for k in range(1, count + 1)] + [[0, count + 2, 1], [count + 3, 0, count + 1]]
    return mesh(vertices, faces, ClassId.SIDEWALK)


def tiled_street(cell_m: float) -> StreetMesh:
    """A flat floor 44 m x 4 m of small triangles."""
    xs, ys = np.arange(-4.0, 40.0 + cell_m, cell_m), np.arange(-2.0, 2.0 + cell_m, cell_m) + 0.13
    gx, gy = np.meshgrid(xs, ys, indexing="ij")
    number = np.arange(gx.size).reshape(gx.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return mesh(np.c_[gx.ravel(), gy.ravel(), np.zeros(gx.size)], faces, ClassId.SIDEWALK)


def actor(actor_id: str, x: float, y: float, yaw: float = 0.0, kind=ActorKind.CAR, size=actors.CAR_LWH_M) -> ActorState:
    """An actor at rest on the ground."""
    return actors.actor(kind, x, y, yaw, name=actor_id, size=size)


@dataclass
class Ride:
    """What happened during a drive, tick by tick."""

    p_m: list[np.ndarray] = field(default_factory=list)
    peak: list[np.ndarray] = field(default_factory=list)
    lowpass: list[tuple[float, float, float]] = field(default_factory=list)  # every substep
    speed: list[float] = field(default_factory=list)
    yaw_rate: list[float] = field(default_factory=list)
    tilt: list[tuple[float, float]] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    end: PlantState | None = None

    def kinds(self) -> set[str]:
        return {contact.kind for contact in self.contacts}

    def peaks(self, after: int = 0) -> np.ndarray:
        return np.max(self.peak[after:], axis=0)


class Rig:
    """One engine, one chair, ready to drive."""

    def __init__(self, engine: Engine, street: StreetMesh, chair: ChairConfig) -> None:
        self.engine, self.config = engine, chair
        engine.add_street(street)
        self.chair = Wheelchair(engine, chair, ImuConfig(), seat=0)

    def place(self, x=0.0, y=0.0, z=0.0, yaw=0.0):
        self.chair.place(np.array([x, y, z]), yaw)
        return self

    def step(self) -> None:
        self.chair.before_step()
        self.engine.step()
        self.chair.after_step()

    def drive(self, stick: Joystick, ticks: int, before_tick: Callable[[int], None] | None = None) -> Ride:
        ride, substeps = Ride(), round(0.1 / self.engine.step_s)
        for tick in range(ticks):
            if before_tick:
                before_tick(tick)
            self.chair.command(stick)
            for _ in range(substeps):
                self.step()
            self.chair.end_tick(None)
            ride.lowpass += self.chair.sensors._sensors["imu"].lowpass_mps2.tolist()
            state = self.chair.state()
            ride.p_m.append(state.p_WB_m)
            ride.peak.append(self.chair.imu().accel_peak_mps2)
            ride.speed.append(float(state.v_B_mps[0]))
            ride.yaw_rate.append(float(state.w_B_radps[2]))
            ride.tilt.append((state.roll_rad, state.pitch_rad))
            ride.contacts += self.chair.contacts()
        ride.end = self.chair.state()
        return ride


@contextmanager
def rig(street: StreetMesh | None = None, hz: int = 240, **chair):
    """A rig on a street (flat if none), placed at the origin."""
    with Engine(1.0 / hz) as engine:
        yield Rig(engine, flat_street() if street is None else street, ChairConfig(**chair)).place()


def ray_down(engine: Engine, points_W_m: np.ndarray) -> np.ndarray:
    """Height (N,) of the first thing below 300 m at points (N, 2); -inf where there is nothing."""
    above, below = (np.c_[points_W_m, np.full(len(points_W_m), z_m)].tolist() for z_m in (300.0, 0.5 * PARK_Z_M))
    hits = engine.bullet.rayTestBatch(above, below)
    return np.array([hit[3][2] if hit[0] >= 0 else -np.inf for hit in hits])


def shoot(cameras, plant, actors=(), chairs=(), tick=0, seat=0, **more):
    """The images of one seat alone; see `Surroundings` for the arguments."""
    more = {"signals": (), "buffers": None, "counted": False, **more}
    return cameras.frames(seat, Surroundings(tick=tick, plant=plant, actors=actors, chairs=chairs, **more))
