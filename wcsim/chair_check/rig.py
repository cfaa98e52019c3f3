"""The test rig: plain streets, and one chair on one of them that is driven tick by tick."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from wcsim.chair_check.row import TICK_S, TrialSetup
from wcsim.core.closing import ClosingContextBase
from wcsim.core.frames import forward_vector
from wcsim.physics.bullet import Bullet, pybullet
from wcsim.physics.engine import Engine
from wcsim.physics.wheelchair.rolling import Plane
from wcsim.physics.wheelchair.wheelchair import Wheelchair
from wcsim.types import F64, ClassId, Joystick, PlantState, StreetMesh

FORWARD: Final = Joystick(0.0, 1.0)
NEUTRAL: Final = Joystick(0.0, 0.0)
FACE_X_M: Final = 4.0  # where steps and walls stand across the way
_HALF_M: Final = 40.0  # of a street
_TIED_M: Final = 0.3  # behind the drive axle
_FIRM_NM: Final = 5000.0
_FIXED: Final = 4  # pybullet.JOINT_FIXED


def make_sloped_street(ahead_rad: float = 0.0, left_rad: float = 0.0) -> StreetMesh:
    """One plane through the origin that rises ahead (x) and to the left (y) by these angles."""
    return make_heightfield_street(
        lambda x, y: x * math.tan(ahead_rad) + y * math.tan(left_rad),
        _HALF_M,
        _HALF_M,
        2.0 * _HALF_M,
    )


def make_heightfield_street(
    height_m: Callable[[float, float], float], long_m: float, wide_m: float, cell_m: float
) -> StreetMesh:
    """Road around the origin, so long and wide to each side, with a height for each x and y."""
    columns, rows = round(2.0 * long_m / cell_m) + 1, round(2.0 * wide_m / cell_m) + 1
    xs = np.linspace(-long_m, long_m, columns).tolist()
    ys = np.linspace(-wide_m, wide_m, rows).tolist()
    vertices = [(x, y, height_m(x, y)) for x in xs for y in ys]
    corners = [i * rows + k for i in range(columns - 1) for k in range(rows - 1)]
    faces = [
        face for a in corners for face in ([a, a + rows, a + rows + 1], [a, a + rows + 1, a + 1])
    ]
    return _mesh(vertices, faces, [ClassId.ROAD] * len(faces))


def make_step_street(rise_m: float, face: ClassId = ClassId.KERB) -> StreetMesh:
    """A level road up to x = FACE_X_M, and level ground `rise_m` higher (or lower) behind it."""
    x, far, half, h = FACE_X_M, FACE_X_M + _HALF_M, _HALF_M, rise_m
    vertices = [(-half, -half, 0.0), (x, -half, 0.0), (x, half, 0.0), (-half, half, 0.0)]
    vertices += [(x, -half, h), (far, -half, h), (far, half, h), (x, half, h)]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [2, 1, 4], [2, 4, 7]]
    return _mesh(vertices, faces, [ClassId.ROAD] * 2 + [ClassId.SIDEWALK] * 2 + [face] * 2)


def _mesh(
    vertices: list[tuple[float, float, float]], faces: list[list[int]], classes: list[ClassId]
) -> StreetMesh:
    return StreetMesh(
        vertices_W_m=np.array(vertices, np.float32),
        faces=np.array(faces, np.int32),
        face_class=np.array(classes, np.uint8),
        chunk_vertices=np.array([0, len(vertices)], np.int32),
        chunk_faces=np.array([0, len(faces)], np.int32),
    )


@dataclass(slots=True)
class _Ride:
    """What a drive showed, one item a tick."""

    states: list[PlantState] = field(default_factory=list)
    # Of the low-passed accelerometer, (3,) each.
    peaks_mps2: list[F64] = field(default_factory=list)

    @property
    def p_m(self) -> F64:
        """Places of the chair's origin, (ticks, 3)."""
        return np.array([state.p_WB_m for state in self.states])

    @property
    def speed_mps(self) -> F64:
        """Forward speeds at the end of each tick, (ticks,)."""
        return np.array([state.v_B_mps[0] for state in self.states])

    @property
    def peak_mps2(self) -> float:
        """The largest low-passed acceleration on any axis."""
        return float(np.max(self.peaks_mps2))


class ChairTestRig(ClosingContextBase):
    """An engine with a street and one chair, placed at the origin.

    Args:
        setup: The chair and the rate of the physics.
        street: What it stands on; a plane if none.
        iterations: Of the engine's solver, in a step.
        slope_rad: Of that plane: how it rises ahead (x) and to the left (y).
    """

    def __init__(
        self,
        setup: TrialSetup,
        street: StreetMesh | None = None,
        iterations: int = 50,
        slope_rad: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.engine: Final = Engine(1.0 / setup.hz, iterations)
        self.setup: Final = setup
        self.engine.add_street(make_sloped_street(*slope_rad) if street is None else street)
        self._rises = tuple(map(math.tan, slope_rad)) if street is None and setup.rolling else ()
        self.chair: Final = Wheelchair(self.engine, setup.chair, setup.imu, seat=0)
        self.place(0.0)

    def close(self) -> None:
        """End the engine."""
        self.engine.close()

    @property
    def body(self) -> int:
        """PyBullet's id of the chair."""
        return self.chair.body_id

    @property
    def bullet(self) -> Bullet:
        """The engine's world in PyBullet."""
        return self.engine.bullet

    def place(self, x_m: float, y_m: float = 0.0, yaw_rad: float = 0.0, z_m: float = 0.0) -> None:
        """Stand the chair there, at rest."""
        self.chair.place(np.array([x_m, y_m, z_m]), yaw_rad)

    def links(self) -> dict[str, int]:
        """Link indices by name."""
        count = self.bullet.getNumJoints(self.body)
        return {self.bullet.getJointInfo(self.body, i)[12].decode(): i for i in range(count)}

    def drive(
        self,
        stick: Joystick,
        seconds: float,
        until: Callable[[PlantState], bool] | None = None,
        pull_N: float = 0.0,
    ) -> _Ride:
        """Drive with a joystick position for whole ticks.

        Args:
            stick: The driver's.
            seconds: For how long.
            until: Ends the drive early when it holds of the state at the end of a tick.
            pull_N: A force along -x of the world, tied to the chair behind its axle near the
                ground.
        """
        ride = _Ride()
        for _ in range(round(seconds / TICK_S)):
            self.chair.command(stick)
            plane = self._plane()
            if plane is not None and pull_N == 0.0 and self.chair.can_roll(plane):
                self.chair.roll(self.chair.rolled(plane, self.setup.substeps))
            else:
                for _ in range(self.setup.substeps):
                    if pull_N > 0.0:
                        state = self.chair.state()
                        tied_m = state.p_WB_m - _TIED_M * forward_vector(state.yaw_rad, 0.0)
                        force_N = -pull_N, 0.0, 0.0
                        self.bullet.applyExternalForce(
                            self.body, -1, force_N, tied_m.tolist(), pybullet.WORLD_FRAME
                        )
                    self.substep()
            self.chair.end_tick(None)
            ride.states.append(self.chair.state())
            ride.peaks_mps2.append(self.chair.imu().accel_peak_mps2)
            if until is not None and until(ride.states[-1]):
                break
        return ride

    def substep(self) -> None:
        """One physics step with controllers and sensors."""
        self.chair.stop_rolling()
        self.chair.before_step()
        self.engine.step()
        self.chair.after_step()

    def weigh_N(self) -> dict[str, float]:
        """Mean loads over half a second, by name, after two seconds of rest; see `loads_N`."""
        self.drive(NEUTRAL, 2.0)
        steps = self.setup.hz // 2
        sums: dict[str, float] = {}
        for _ in range(steps):
            self.substep()
            for name, load in self.loads_N().items():
                sums[name] = sums.get(name, 0.0) + load / steps
        self.chair.end_tick(None)
        return sums

    def _plane(self) -> Plane | None:
        """What the chair stands on, where it shall roll."""
        if not self._rises:
            return None
        x_m, y_m, _ = self.chair.state().p_WB_m.tolist()
        rise_x, rise_y = self._rises
        return Plane(x_m * rise_x + y_m * rise_y, rise_x, rise_y)

    def turn_swivels(self, angle_rad: float) -> None:
        """Turn every caster's fork to an angle; 0 is trailing."""
        for name, index in self.links().items():
            if name.startswith("swivel"):
                self.bullet.resetJointState(self.body, index, angle_rad, 0.0)

    def lock(self, *prefixes: str) -> None:
        """Hold the joints of links whose names begin so; all that move if none is named."""
        for name, index in self.links().items():
            kind = self.bullet.getJointInfo(self.body, index)[2]
            if kind == _FIXED or (prefixes and not name.startswith(prefixes)):
                continue
            angle = self.bullet.getJointState(self.body, index)[0]
            self.bullet.setJointMotorControl2(
                self.body, index, pybullet.POSITION_CONTROL, targetPosition=angle, force=_FIRM_NM
            )

    def free(self, prefix: str) -> None:
        """Take the bearing friction from the joints of links whose names begin so."""
        for name, index in self.links().items():
            if name.startswith(prefix):
                self.bullet.setJointMotorControl2(
                    self.body, index, pybullet.VELOCITY_CONTROL, force=0.0
                )

    def loads_N(self) -> dict[str, float]:
        """Normal force in the last step of every link that touches something; of "frame", too."""
        names = {index: name for name, index in self.links().items()}
        loads: dict[str, float] = {}
        for point in self.bullet.getContactPoints(bodyA=self.body):
            name = names.get(point[3], "frame")
            loads[name] = loads.get(name, 0.0) + float(point[9])
        return loads
