"""A wheelchair in the engine: placed, told a joystick position, driven substep by substep, asked what it felt.

Once a tick `command`; each substep `before_step`, `Engine.step`, `after_step`; at the end of the tick `end_tick`, and
then `state`, `imu` and `contacts` answer.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.config import ChairConfig, ImuConfig
from wcsim.errors import PhysicsError
from wcsim.physics import drive
from wcsim.physics.contacts import ContactLog, Touch
from wcsim.physics.engine import GRAVITY_MPS2, PARK_Z_M, BodyTag, Engine, Role
from wcsim.physics.ghosts import MOST_IN_A_ROW, SUSPECT_N, Motion, Tyre, coast, is_ghost
from wcsim.physics.imu import Imu
from wcsim.physics.plant import PlantSpec, plant_spec, urdf
from wcsim.physics.pose import Quat, Rotation, added, euler, matrix, quaternion, rotate, rotate_back, velocity_at
from wcsim.physics.quiet import pybullet
from wcsim.types import F64, Contact, ImuFrame, Joystick, PlantState, chair_actor_id

Vec3 = tuple[float, float, float]
LEVEL_M: Final = 0.003  # ground that differs less under the wheels is level
PLACE_LIFT_M: Final = 0.001  # the street's collision margin
_PARK_STEP_M: Final = 20.0
_TURNING: Final = ("wheel_l", "wheel_r", "swivel_l", "swivel_r", "caster_l", "caster_r")
_FRAME: Final = -1  # PyBullet's index of the base link
_MOST_RADPS: Final = 30.0  # of any joint: a car that hits a caster would whirl its light fork round, into itself
_SPARE: Final = 1.5  # faster chairs need their casters to turn so much faster than they roll at top speed
_MOTORS_OFF: Final = drive.WheelCommand(radps=(0.0, 0.0), torque_Nm=(0.0, 0.0))
_AWAKE: Final = pybullet.ACTIVATION_STATE_DISABLE_SLEEPING | pybullet.ACTIVATION_STATE_WAKE_UP
_ASLEEP: Final = pybullet.ACTIVATION_STATE_ENABLE_SLEEPING | pybullet.ACTIVATION_STATE_SLEEP


class Wheelchair:
    """One chair with its controllers and IMU.

    Args:
        engine: Where it lives.
        chair: Plant and limits of the drive.
        imu: The sensor.
        seat: Number of the seat; its actor id in contacts of other chairs is `chair_actor_id(seat)`.

    Raises:
        ConfigError: `chair.plant` is unknown.
        PhysicsError: PyBullet refused the body.
    """

    def __init__(self, engine: Engine, chair: ChairConfig, imu: ImuConfig, seat: int) -> None:
        self.seat: Final = seat
        self.spec: Final[PlantSpec] = plant_spec(chair)
        self._engine = engine
        self._chair = chair
        self._com_B_m: Vec3 = self.spec.frame_com_m
        self._axle_m: Vec3 = (-self._com_B_m[0], 0.0, self.spec.wheel_radius_m - self._com_B_m[2])
        self.body_id: Final[int] = _load(engine, self.spec)
        self._links = _links(self.body_id, engine.client)
        self._joints = [self._links[name] for name in _TURNING]  # the drive wheels first
        self._drives = self._joints[:2]
        self._tyres = _tyres(self._links, self.spec)
        self._coasted = self._ghosts = 0
        self._part = {index: name.split("_")[0] for name, index in self._links.items() if "swivel" not in name}
        self._rolling = frozenset(self._part)
        most_radps = max(_MOST_RADPS, _SPARE * chair.v_max_mps / self.spec.caster_radius_m)
        _set_dynamics(self.body_id, self._links, self.spec, most_radps, engine.client)
        self._imu = Imu(imu, self._com_B_m, engine.step_s, GRAVITY_MPS2)
        self._log = ContactLog()
        self._contacts: tuple[Contact, ...] = ()
        self._joystick = Joystick(0.0, 0.0)
        self._state: PlantState | None = None
        self._drive = drive.DriveState()
        self.park()

    @property
    def parked(self) -> bool:
        """Whether it is out of the way; then its substeps do nothing."""
        return self._parked

    @property
    def ghosts(self) -> int:
        """How many steps were not taken because of a contact that cannot be, since the chair was made."""
        return self._ghosts

    def place(self, p_W_m: F64, yaw_rad: float) -> None:
        """Stand at a point of the ground, tilted as the ground under the wheels is, at rest, everything forgotten.

        Args:
            p_W_m: Where the body frame's origin comes to stand, (3,).
            yaw_rad: Heading.

        Raises:
            PhysicsError: The pose is not finite.
        """
        x, y, z = (float(value) for value in p_W_m)
        if not all(math.isfinite(value) for value in (x, y, z, yaw_rad)):
            raise PhysicsError(f"place({p_W_m}, {yaw_rad}) is not finite; expected a point on the ground and a heading")
        self.park()  # or it would stand on itself
        z_W_m, tilt = self._stance((x, y, z), yaw_rad)
        self._pose((x, y, z_W_m + PLACE_LIFT_M), tilt)
        self._wake(True)
        self._parked = False

    def park(self) -> None:
        """Stand far below the street, asleep."""
        self._pose((_PARK_STEP_M * self.seat, 0.0, PARK_Z_M), quaternion(0.0))
        self._wake(False)
        self._parked = True

    def command(self, joystick: Joystick) -> None:
        """Take what the driver wants from now on. Raises PhysicsError when it is not finite."""
        if not (math.isfinite(joystick.x) and math.isfinite(joystick.y)):
            raise PhysicsError(f"seat {self.seat}: joystick is {joystick}; expected two finite numbers in [-1, 1]")
        self._joystick = joystick

    def before_step(self) -> None:
        """Run the controllers and set the motors for the physics step to come."""
        if self._parked:
            return
        client = self._engine.client
        joints = pybullet.getJointStates(self.body_id, self._joints, physicsClientId=client)
        self._before = Motion(
            p_W_m=self._p_com_W_m,
            q_WB=self._q_WB,
            v_W_mps=self._v_W_mps,
            w_W_radps=self._w_W_radps,
            joints=[joint[:2] for joint in joints],
        )
        wanted = drive.step(
            self._drive,
            self._joystick,
            self._axle_speed_mps(),
            (joints[0][1], joints[1][1]),
            self._chair,
            self.spec,
            self._engine.step_s,
        )
        self._set_motors(wanted)

    def after_step(self) -> None:
        """Sample the IMU and add up what was touched."""
        if self._parked:
            return
        points = pybullet.getContactPoints(bodyA=self.body_id, physicsClientId=self._engine.client)
        self._coast_over_ghosts(points)
        self._read()
        self._imu.sample(self._rotation, self._v_W_mps, self._w_W_radps)
        ground, rolling = self._engine.rolling_ids, self._rolling
        for point in points:
            if point[3] not in rolling or point[2] not in ground:
                self._touch(point)

    def end_tick(self, rng_noise: np.random.Generator | None) -> None:
        """Close the tick for `imu` and `contacts`, and tell others how this chair moves; noise only with a generator.

        Raises:
            PhysicsError: The motion left the finite numbers.
        """
        self._imu_frame = self._imu.end_tick(rng_noise)
        self._contacts = self._log.close()
        self._tell()

    def state(self) -> PlantState:
        """The true state as of the last substep."""
        if self._state is None:
            self._state = self._state_now()
        return self._state

    def _state_now(self) -> PlantState:
        r = self._rotation
        cx, cy, cz = self._com_B_m
        origin = added(self._p_com_W_m, rotate(r, -cx, -cy, -cz))
        v_origin = velocity_at(origin, self._p_com_W_m, self._v_W_mps, self._w_W_radps)
        left, right = pybullet.getJointStates(self.body_id, self._drives, physicsClientId=self._engine.client)
        roll, pitch, yaw = euler(r)
        return PlantState(
            p_WB_m=np.array(origin),
            q_WB=np.array(self._q_WB),
            v_B_mps=np.array(rotate_back(r, *v_origin)),
            w_B_radps=np.array(rotate_back(r, *self._w_W_radps)),
            wheel_radps=np.array((left[1], right[1])),
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
        )

    def imu(self) -> ImuFrame:
        """What the IMU said of the last closed tick."""
        return self._imu_frame

    def contacts(self) -> tuple[Contact, ...]:
        """What was touched in the last closed tick."""
        return self._contacts

    def _stance(self, p_W_m: Vec3, yaw_rad: float) -> tuple[float, Quat]:
        """Height of the body's origin and its rotation, with all wheels on the ground or above it."""
        wheels_B_m = self.spec.stand_m()
        turn = matrix(quaternion(yaw_rad))
        wheels_W_m = np.array([added(p_W_m, rotate(turn, x, y, 0.0)) for x, y in wheels_B_m])
        heights = self._engine.ground_at(wheels_W_m)
        if np.isnan(heights).any() or np.ptp(heights) < LEVEL_M:
            return p_W_m[2], quaternion(yaw_rad)
        columns = np.array([(1.0, x, y) for x, y in wheels_B_m])
        (base, ahead, left), *_ = np.linalg.lstsq(columns, heights, rcond=None)
        lift = float((heights - columns @ (base, ahead, left)).max())
        roll_rad = math.asin(left / math.sqrt(1.0 + ahead**2 + left**2))
        return float(base) + lift, quaternion(yaw_rad, math.atan(ahead), roll_rad)

    def _pose(self, p_WB_m: Vec3, q: Quat) -> None:
        client = self._engine.client
        com = added(p_WB_m, rotate(matrix(q), *self._com_B_m))
        pybullet.resetBasePositionAndOrientation(self.body_id, com, q, physicsClientId=client)
        pybullet.resetBaseVelocity(self.body_id, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), physicsClientId=client)
        for index in self._links.values():
            pybullet.resetJointState(self.body_id, index, 0.0, 0.0, physicsClientId=client)
        self._drive = drive.DriveState()
        self._set_motors(_MOTORS_OFF)  # a motor that turns would wake a parked chair
        self._joystick = Joystick(0.0, 0.0)
        self._log.clear()
        self._contacts = ()
        self._read()
        self._imu.reset(self._rotation)
        self._imu_frame = self._imu.end_tick(None)
        self._tell()

    def _set_motors(self, wanted: drive.WheelCommand) -> None:
        pybullet.setJointMotorControlArray(
            self.body_id,
            self._drives,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=wanted.radps,
            forces=wanted.torque_Nm,
            physicsClientId=self._engine.client,
        )

    def _wake(self, awake: bool) -> None:
        state = _AWAKE if awake else _ASLEEP
        pybullet.changeDynamics(self.body_id, _FRAME, activationState=state, physicsClientId=self._engine.client)

    def _read(self) -> None:
        client = self._engine.client
        self._p_com_W_m, self._q_WB = pybullet.getBasePositionAndOrientation(self.body_id, physicsClientId=client)
        self._v_W_mps, self._w_W_radps = pybullet.getBaseVelocity(self.body_id, physicsClientId=client)
        self._rotation: Rotation = matrix(self._q_WB)
        self._state = None  # made when somebody asks

    def _axle_speed_mps(self) -> float:
        """Forward speed of the middle of the drive axle, which pitching hardly moves."""
        r = self._rotation
        v, _, _ = rotate_back(r, *self._v_W_mps)
        _, pitching, _ = rotate_back(r, *self._w_W_radps)
        return v + pitching * self._axle_m[2]

    def _coast_over_ghosts(self, points: Sequence[tuple[Any, ...]]) -> None:
        """Undo the step when the ground pushed a wheel hard where it was not, and nothing else did."""
        suspects = [point for point in points if point[9] > SUSPECT_N and point[3] in self._tyres]
        street, client = self._engine.rolling_ids, self._engine.client
        if not suspects or self._coasted == MOST_IN_A_ROW or any(point[2] not in street for point in points):
            self._coasted = 0
            return
        if any(is_ghost(point, self.body_id, self._tyres[point[3]], self._before, client) for point in suspects):
            coast(self.body_id, self._joints, self._before, self._engine.step_s, client)
            self._coasted += 1
            self._ghosts += 1
        else:
            self._coasted = 0

    def _touch(self, point: tuple[Any, ...]) -> None:
        """Count one contact point (PyBullet's fields: 2 other body, 3 own link, 5 place, 7 normal to us, 9 force)."""
        if point[9] <= 0.0:
            return
        tag = self._engine.tag_of(point[2])
        before = self._before
        part = self._part.get(point[3]) or self._frame_part(point[5])
        touch = Touch(
            point_W_m=point[5],
            v_chair_W_mps=velocity_at(point[5], before.p_W_m, before.v_W_mps, before.w_W_radps),
            normal_to_chair=point[7],
        )
        self._log.add(point[2], part, point[9] * self._engine.step_s, tag, touch)

    def _frame_part(self, point_W_m: Vec3) -> str:
        px, py, pz = self._p_com_W_m
        ahead, _, _ = rotate_back(self._rotation, point_W_m[0] - px, point_W_m[1] - py, point_W_m[2] - pz)
        return "footplate" if ahead + self._com_B_m[0] > self.spec.footplate_from_x_m else "body"

    def _tell(self) -> None:
        tag = BodyTag(
            role=Role.CHAIR,
            kind=Role.CHAIR.value,
            actor_id=chair_actor_id(self.seat),
            p_W_m=self._p_com_W_m,
            v_W_mps=self._v_W_mps,
            yaw_rate_radps=self._w_W_radps[2],
        )
        self._engine.tag(self.body_id, tag)


def _load(engine: Engine, spec: PlantSpec) -> int:
    """Load the plant's URDF; returns the body's id. Raises PhysicsError if PyBullet refuses it."""
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_IMPLICIT_CYLINDER
    with tempfile.TemporaryDirectory(prefix="wcsim-") as folder:
        path = Path(folder) / "chair.urdf"
        path.write_text(urdf(spec), encoding="utf-8")
        try:
            return int(pybullet.loadURDF(str(path), flags=flags, physicsClientId=engine.client))
        except pybullet.error as error:
            raise PhysicsError(f"PyBullet refused the wheelchair ({error}); expected a body: check the plant") from None


def _tyres(links: dict[str, int], spec: PlantSpec) -> dict[int, Tyre]:
    """The cylinders of drive wheels and casters by link index."""
    wheel = Tyre(radius_m=spec.wheel_radius_m, half_width_m=0.5 * spec.wheel_width_m)
    caster = Tyre(radius_m=spec.caster_radius_m, half_width_m=0.5 * spec.caster_width_m)
    return {links[name]: wheel if name.startswith("wheel") else caster for name in _TURNING if "swivel" not in name}


def _links(body: int, client: int) -> dict[str, int]:
    """Link indices by name; a joint is named like the link that it carries."""
    count = pybullet.getNumJoints(body, physicsClientId=client)
    return {pybullet.getJointInfo(body, i, physicsClientId=client)[1].decode(): i for i in range(count)}


def _set_dynamics(body: int, links: dict[str, int], spec: PlantSpec, most_radps: float, client: int) -> None:
    """Friction per part, no damping, and PyBullet's default joint motors off but for the swivels' bearing friction."""
    friction = {"wheel": spec.wheel_friction, "caster": spec.caster_friction, "antitip": spec.antitip_friction}
    for name, index in (("frame", _FRAME), *links.items()):
        pybullet.changeDynamics(
            body,
            index,
            lateralFriction=friction.get(name.split("_")[0], spec.frame_friction),
            rollingFriction=0.0,
            spinningFriction=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
            maxJointVelocity=most_radps,
            physicsClientId=client,
        )
    for name, index in links.items():
        if not name.startswith("antitip"):
            torque = spec.swivel_friction_Nm if name.startswith("swivel") else 0.0
            pybullet.setJointMotorControl2(
                body, index, pybullet.VELOCITY_CONTROL, targetVelocity=0.0, force=torque, physicsClientId=client
            )
