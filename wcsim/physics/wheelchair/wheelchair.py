"""A wheelchair in the engine: placed, commanded by a joystick, driven in substeps, and read.

Once a tick `command`; each substep `before_step`, `Engine.step`, `after_step`; at the end of the
tick `end_tick`, and then `state`, `imu` and `contacts` answer.

On a plane with nothing in reach it may go through a tick without the engine: `can_roll`, `rolled`,
`roll`.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from wcsim.config import ChairConfig, ImuConfig
from wcsim.core.frames import (
    LEVEL,
    Quat,
    Rotation,
    Vec3,
    add_vectors,
    compute_point_velocity,
    matrix_from_quaternion,
    quaternion_from_ypr,
    rotate_vector,
    rotate_vector_inverse,
    rpy_from_matrix,
)
from wcsim.errors import PhysicsError
from wcsim.physics.bullet import pybullet
from wcsim.physics.engine import PARK_Z_M, SUSPECT_N, BodyTag, Engine, Role
from wcsim.physics.sensors.base import BodyMotion, Mount, NoiseKeys
from wcsim.physics.sensors.camera import CameraRig
from wcsim.physics.sensors.registry import SensorSet
from wcsim.physics.wheelchair import drive_controller
from wcsim.physics.wheelchair.contacts import MOST_IN_A_ROW, ContactLog, ContactPoint, Motion
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec
from wcsim.physics.wheelchair.plant_body import (
    FRAME,
    ChairBody,
    check_springs,
    dressed,
    load_body,
    urdf,
)
from wcsim.physics.wheelchair.rolling import Plane, RolledTick, RollingPlant
from wcsim.physics.wheelchair.wheel_track import WheelTrack
from wcsim.types import F64, Contact, ImuFrame, Joystick, Outline, PlantState, chair_actor_id

LEVEL_M: Final = 0.003  # ground that differs less under the wheels is level
_PLACE_LIFT_M: Final = 0.001  # the street's collision margin
_PARK_STEP_M: Final = 20.0
_MOTORS_OFF: Final = (0.0, 0.0, 0.0, 0.0)
_AWAKE: Final = pybullet.ACTIVATION_STATE_DISABLE_SLEEPING | pybullet.ACTIVATION_STATE_WAKE_UP
_ASLEEP: Final = pybullet.ACTIVATION_STATE_ENABLE_SLEEPING | pybullet.ACTIVATION_STATE_SLEEP


class Wheelchair:
    """One chair with its controllers and sensors.

    Args:
        engine: Where it lives.
        chair: Plant and limits of the drive.
        imu: The sensor that every chair has.
        seat: Number of the seat; its actor id in contacts of other chairs is
            `chair_actor_id(seat)`.
        others: Sections of its other sensors, by their names in `physics/sensors/registry.py`.
        rig: It draws the pictures of the chair's cameras, if any.
        tick_s: From one `end_tick` to the next.

    Raises:
        ConfigError: `chair.plant` is unknown, cannot stand, or does not go with the limits in
            `chair` or the step.
        PhysicsError: PyBullet refused the body.
    """

    def __init__(
        self,
        engine: Engine,
        chair: ChairConfig,
        imu: ImuConfig,
        seat: int,
        others: Mapping[str, object] | None = None,
        rig: CameraRig | None = None,
        tick_s: float = 0.1,
    ) -> None:
        self.seat: Final = seat
        self._aside_m: Vec3 = (_PARK_STEP_M * seat, 0.0, PARK_Z_M)
        self._engine = engine
        self._chair = chair
        self._coasted = self._ghosts = 0
        self._log = ContactLog(tick_s)
        self._contacts: tuple[Contact, ...] = ()
        self._joystick = Joystick(0.0, 0.0)
        self._state: PlantState | None = None
        self._rotation: Rotation = LEVEL
        self._joints: tuple[tuple[Any, ...], ...] = ()
        self._rolls = self._waking = False
        spec = plant_spec(chair)
        self._mount = Mount(
            seat=seat,
            engine=engine,
            com_B_m=spec.frame_com_m,
            wheel_radius_m=spec.wheel.radius_m,
            track_m=spec.wheel.track_m,
            rig=rig,
        )
        self.sensors: Final = SensorSet({"imu": imu, **(others or {})}, self._mount)
        self._take(spec, load_body(engine, spec, chair.v_max_mps))
        self.park()

    @property
    def spec(self) -> PlantSpec:
        """The plant of the chair at the moment."""
        return self._spec

    @property
    def outline(self) -> Outline:
        """The box around the chair and its user."""
        return self._outline

    @property
    def body_id(self) -> int:
        """PyBullet's id of its body; another one after `become`."""
        return self._body.id

    def become(self, spec: PlantSpec, sensors: Mapping[str, object] | None = None) -> None:
        """Be another plant, with other sections of some sensors, from now on.

        It is parked then, until it is placed. Other frictions, springs and motors cost nothing.
        Other masses or shapes need a new body: some milliseconds, and 10 to 13 kB that PyBullet
        never frees.

        Raises:
            ConfigError: Its springs are too stiff for the engine's step; the chair does not change.
            PhysicsError: PyBullet refused the body.
        """
        # Before anything is changed, so that a refused plant leaves the chair as it was.
        check_springs(spec, self._engine.step_s)
        # The text is all that Bullet builds a body from: with equal texts the old body will do.
        if urdf(spec) != urdf(self._spec):
            self._engine.remove_body(self._body.id)
            self._take(spec, load_body(self._engine, spec, self._chair.v_max_mps))
        elif spec != self._spec:
            self._take(spec, dressed(self._engine, self._body.id, spec, self._chair.v_max_mps))
        self.sensors.fit(replace(self._mount, com_B_m=spec.frame_com_m), sensors or {})
        self.park()

    def _take(self, spec: PlantSpec, body: ChairBody) -> None:
        engine = self._engine
        self._spec = spec
        self._body = body
        engine.feet[body.id] = body.part
        self._com_B_m: Vec3 = spec.frame_com_m
        self._wheel_radius_m = spec.wheel.radius_m
        self._axle_from_com_z_m = spec.wheel.radius_m - self._com_B_m[2]
        self._footplate_from_x_m = spec.footplate_from_x_m
        self._outline = spec.outline
        self.wheels_m = spec.wheels_m()  # see `PlantSpec`
        self._setting = drive_controller.settings(self._chair, spec, engine.step_s)
        self._memory = drive_controller.new_state()
        self._track = WheelTrack(body.id, body.tyres, engine.step_s, engine.bullet)
        joint_of = {
            name: body.joints.index(link)
            for name, link in body.links.items()
            if link in body.joints
        }
        self._rolling = RollingPlant.of(spec, self._chair, joint_of)

    def can_roll(self, plane: Plane) -> bool:
        """Whether it may roll over that plane without the engine, where nothing is in reach."""
        free = not self._parked and not self._coasted
        return free and self._rolling.can_roll(self.state(), self._rotation, plane)

    def rolled(self, plane: Plane, steps: int) -> RolledTick:
        """What a tick of so many steps over that plane would lead to, without the engine."""
        now = Motion(self._p_com_W_m, self._q_WB, self._v_W_mps, self._w_W_radps, self._joints)
        drive = self._memory, self._setting, self._joystick
        return self._rolling.tick(now, plane, *drive, steps, self._engine.step_s)

    def roll(self, tick: RolledTick) -> None:
        """Go through a tick as `rolled` says; the body in the engine lies aside."""
        if not self._rolls:
            self._rolls = True
            body, bullet = self._body.id, self._engine.bullet
            bullet.resetBasePositionAndOrientation(body, self._aside_m, quaternion_from_ypr(0.0))
            bullet.resetBaseVelocity(body, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            # A motor that turns would wake it.
            self._set_motors(_MOTORS_OFF)
            self._wake(False)
        self._p_com_W_m, self._q_WB, self._v_W_mps, self._w_W_radps, joints = tick.motion
        self._joints = tuple(joints)
        self._rotation = matrix_from_quaternion(self._q_WB)
        self._memory[:] = tick.memory
        self._state = None
        self.sensors.sample_rows(tick.rows, (joints[0][0], joints[1][0]))
        self._track.take(tick.hubs_W_m, np.hypot(tick.rows[:, 9], tick.rows[:, 10]))

    def stop_rolling(self) -> None:
        """Be in the engine again, moving as it does now."""
        if not self._rolls:
            return
        self._rolls = False
        body, bullet = self._body, self._engine.bullet
        bullet.resetBasePositionAndOrientation(body.id, self._p_com_W_m, self._q_WB)
        bullet.resetBaseVelocity(body.id, self._v_W_mps, self._w_W_radps)
        for index, (place, rate, *_) in zip(body.joints, self._joints, strict=True):
            bullet.resetJointState(body.id, index, place, rate)
        self._wake(True)
        # Bullet wakes a body one step late, and takes its speed in that step.
        self._waking = True

    @property
    def parked(self) -> bool:
        """Whether it is out of the way; then its substeps do nothing."""
        return self._parked

    @property
    def hanging(self) -> int:
        """How many of its wheels touch nothing at the moment."""
        if self._rolls:
            return 0
        touching = {point[3] for point in self._engine.bullet.getContactPoints(bodyA=self._body.id)}
        return sum(link not in touching for link in self._body.tyres)

    @property
    def ghosts(self) -> int:
        """How many steps were not taken since the chair was made, as a contact could not be."""
        return self._ghosts

    def place(self, p_W_m: F64, yaw_rad: float) -> None:
        """Stand at a point of the ground, tilted like it, at rest, without memory.

        Args:
            p_W_m: Where the body frame's origin comes to stand, (3,).
            yaw_rad: Heading.

        Raises:
            PhysicsError: The pose is not finite.
        """
        x, y, z = (float(value) for value in p_W_m)
        if not all(math.isfinite(value) for value in (x, y, z, yaw_rad)):
            raise PhysicsError(
                f"place({p_W_m}, {yaw_rad}) is not finite; expected a point on the ground and a "
                "heading"
            )
        # Out of the way first: the rays that find the ground would hit its own body.
        self.park()
        z_W_m, tilt = self._stance((x, y, z), yaw_rad)
        self._pose((x, y, z_W_m + _PLACE_LIFT_M), tilt)
        self._wake(True)
        self._parked = False

    def park(self) -> None:
        """Stand far below the street, asleep."""
        self._pose(self._aside_m, quaternion_from_ypr(0.0))
        self._wake(False)
        self._parked = True
        self._rolls = self._waking = False

    def remove(self) -> None:
        """Leave the engine for good; nothing but `parked` may be read afterwards."""
        self._engine.remove_body(self._body.id)
        self._parked = True

    def forget(self, actor_id: str) -> None:
        """Forget another wheelchair that has left for good."""
        self._log.forget(actor_id)

    def follow_step(self) -> None:
        """Fit controllers, sensors and track to the engine's new step; between two ticks."""
        step_s = self._engine.step_s
        self._setting = drive_controller.settings(self._chair, self._spec, step_s)
        self.sensors.set_step(step_s)
        self._track.set_step(step_s)

    def command(self, joystick: Joystick) -> None:
        """Follow this joystick from now on. Raises PhysicsError when it is not finite."""
        if not (math.isfinite(joystick.x) and math.isfinite(joystick.y)):
            raise PhysicsError(
                f"seat {self.seat}: joystick is {joystick}; expected two finite numbers in [-1, 1]"
            )
        self._joystick = joystick

    def before_step(self) -> None:
        """Run the controllers and set the motors for the physics step to come."""
        if self._parked or self._rolls:
            return
        joints, stick = self._joints, self._joystick
        r, v_W, w_W = self._rotation, self._v_W_mps, self._w_W_radps
        # 1. The motion before the step: by it contacts are judged, and a step may be taken back.
        self._before = Motion(self._p_com_W_m, self._q_WB, v_W, w_W, joints)

        # 2. The motors, by the speed of the drive axle's middle, which pitching hardly moves.
        forward = r[0] * v_W[0] + r[3] * v_W[1] + r[6] * v_W[2]
        pitching = r[1] * w_W[0] + r[4] * w_W[1] + r[7] * w_W[2]
        axle_mps = forward + pitching * self._axle_from_com_z_m
        left, right = joints[0][1], joints[1][1]
        v_mps = drive_controller.speed_mps(axle_mps, 0.5 * (left + right) * self._wheel_radius_m)
        self._set_motors(
            drive_controller.step(self._memory, self._setting, stick.x, stick.y, v_mps, left, right)
        )
        if not self._body.arms:
            return

        # 3. The springs of sprung casters; PyBullet adds up the forces before a step.
        arms = zip(self._body.springs, joints[2:], strict=False)
        self._engine.bullet.setJointMotorControlArray(
            self._body.id,
            self._body.arms,
            pybullet.TORQUE_CONTROL,
            forces=[
                -arm.preload_N - arm.stiffness_Npm * up[0] - arm.damping_Nspm * up[1]
                for arm, up in arms
            ],
        )

    def after_step(self) -> None:
        """Sample the sensors and add up what was touched."""
        if self._parked or self._rolls:
            return
        body, engine, before = self._body, self._engine, self._before
        if self._waking:
            self._waking = False
            before.coast(body.id, body.joints, engine.step_s, engine.bullet)

        # 1. Contacts. PyBullet's fields: 2 other body, 3 own link, 5 place, 7 normal, 9 force.
        ground = engine.rolling_ids
        touches: list[tuple[Any, ...]] = []
        suspects: list[tuple[Any, ...]] = []
        touched = body.id in engine.touched()
        for point in engine.bullet.getContactPoints(bodyA=body.id) if touched else ():
            if point[2] not in ground or point[3] not in body.part:
                touches.append(point)
            if point[9] > SUSPECT_N and point[3] in body.tyres:
                suspects.append(point)
        # Without a suspect, too, while it coasts: that ends the count of steps in a row.
        if suspects or self._coasted:
            self._coast_over_ghosts(suspects, touches)

        # 2. Sensors and track.
        self._read()
        wheel_rad = (self._joints[0][0], self._joints[1][0])
        self.sensors.sample(BodyMotion(self._rotation, self._v_W_mps, self._w_W_radps, wheel_rad))
        self._track.after_step(self._v_W_mps)

        # 3. What was touched, by the motion before the step: after it the chair has been pushed.
        for point in touches:
            # PyBullet lists points that are merely close, too, which have no force.
            if point[9] <= 0.0:
                continue
            v_W_mps = compute_point_velocity(
                point[5], before.p_W_m, before.v_W_mps, before.w_W_radps
            )
            self._log.add(
                point[2],
                body.part.get(point[3]) or self._frame_part(point[5]),
                point[9] * engine.step_s,
                engine.tag_of(point[2]),
                ContactPoint(point[5], v_W_mps, point[7]),
            )

    def end_tick(self, noise: NoiseKeys | None) -> None:
        """Close the tick for sensors, `contacts` and the motion that others see.

        Noise only with keys.

        Raises:
            PhysicsError: The motion left the finite numbers.
        """
        self.sensors.end_tick(noise)
        self._contacts = self._log.close()
        self._update_tag()

    def state(self) -> PlantState:
        """The true state as of the last substep."""
        if self._state is not None:
            return self._state
        r = self._rotation
        cx, cy, cz = self._com_B_m
        origin = add_vectors(self._p_com_W_m, rotate_vector(r, -cx, -cy, -cz))
        v_origin = compute_point_velocity(origin, self._p_com_W_m, self._v_W_mps, self._w_W_radps)
        roll, pitch, yaw = rpy_from_matrix(r)
        self._state = PlantState(
            p_WB_m=np.array(origin),
            q_WB=np.array(self._q_WB),
            v_B_mps=np.array(rotate_vector_inverse(r, *v_origin)),
            w_B_radps=np.array(rotate_vector_inverse(r, *self._w_W_radps)),
            wheel_radps=np.array((self._joints[0][1], self._joints[1][1])),
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
        )
        return self._state

    def drive_accel_mps2(self) -> float:
        """The reference acceleration ahead at the moment; the drive's jerk limits its change."""
        return float(self._memory[drive_controller.A_REF_MPS2])

    def imu(self) -> ImuFrame:
        """The IMU's reading in the last closed tick."""
        frame: ImuFrame = self.sensors.felt("imu")
        return frame

    def contacts(self) -> tuple[Contact, ...]:
        """What was touched in the last closed tick."""
        return self._contacts

    def wheel_track(self) -> tuple[F64, F64]:
        """Where its wheels were since it was placed, and its speed: see `WheelTrack.samples`."""
        return self._track.samples()

    def _stance(self, p_W_m: Vec3, yaw_rad: float) -> tuple[float, Quat]:
        """Height of the body's origin, and its rotation, with all wheels on the ground or above."""
        wheels_B_m = self._spec.stand_m()
        turn = matrix_from_quaternion(quaternion_from_ypr(yaw_rad))
        wheels_W_m = [add_vectors(p_W_m, rotate_vector(turn, x, y, 0.0)) for x, y in wheels_B_m]
        heights = self._engine.ground_at(np.array(wheels_W_m))
        # Where a wheel has no ground below there is no plane; on level ground rounding must not
        # tilt the chair.
        if np.isnan(heights).any() or np.ptp(heights) < LEVEL_M:
            return p_W_m[2], quaternion_from_ypr(yaw_rad)
        columns = np.array([(1.0, x, y) for x, y in wheels_B_m])
        (base, ahead, left), *_ = np.linalg.lstsq(columns, heights, rcond=None)
        # The plane of least squares is below some wheel's ground: raised until no wheel is in it.
        lift = float((heights - columns @ (base, ahead, left)).max())
        roll_rad = math.asin(left / math.sqrt(1.0 + ahead**2 + left**2))
        return float(base) + lift, quaternion_from_ypr(yaw_rad, math.atan(ahead), roll_rad)

    def _pose(self, p_WB_m: Vec3, q: Quat) -> None:
        body, bullet = self._body, self._engine.bullet
        com = add_vectors(p_WB_m, rotate_vector(matrix_from_quaternion(q), *self._com_B_m))
        bullet.resetBasePositionAndOrientation(body.id, com, q)
        bullet.resetBaseVelocity(body.id, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        for index in body.links.values():
            bullet.resetJointState(body.id, index, 0.0, 0.0)
        self._memory[:] = 0.0
        self._joystick = Joystick(0.0, 0.0)
        self._log.clear()
        self._contacts = ()
        self._track.clear()
        self._read()
        # A motor that turns would wake a parked chair.
        self._set_motors(_MOTORS_OFF)
        self.sensors.reset(BodyMotion(self._rotation))
        self._update_tag()

    def _set_motors(self, targets: tuple[float, float, float, float]) -> None:
        """Target speeds and torque limits of the drive wheels."""
        self._engine.bullet.setJointMotorControlArray(
            self._body.id,
            self._body.drives,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=targets[:2],
            forces=targets[2:],
        )

    def _wake(self, awake: bool) -> None:
        state = _AWAKE if awake else _ASLEEP
        self._engine.bullet.changeDynamics(self.body_id, FRAME, activationState=state)

    def _read(self) -> None:
        body, bullet = self._body, self._engine.bullet
        self._p_com_W_m, self._q_WB = bullet.getBasePositionAndOrientation(body.id)
        self._v_W_mps, self._w_W_radps = bullet.getBaseVelocity(body.id)
        self._joints = bullet.getJointStates(body.id, body.joints)
        self._rotation = matrix_from_quaternion(self._q_WB)
        self._state = None  # `state` makes it anew

    def _coast_over_ghosts(
        self, suspects: list[tuple[Any, ...]], touches: list[tuple[Any, ...]]
    ) -> None:
        """Undo the step when nothing but ground pushed a wheel hard, and that where it was not."""
        body, engine, before = self._body, self._engine, self._before
        # With another touch in the step the push may be real. After three steps in a row it counts
        # as real.
        if touches or self._coasted == MOST_IN_A_ROW:
            suspects = []
        for point in suspects:
            if before.is_ghost(point, body.id, body.tyres[point[3]], engine.bullet):
                before.coast(body.id, body.joints, engine.step_s, engine.bullet)
                self._coasted += 1
                self._ghosts += 1
                return
        self._coasted = 0

    def _frame_part(self, point_W_m: Vec3) -> str:
        (x, y, z), (px, py, pz) = point_W_m, self._p_com_W_m
        ahead, _, _ = rotate_vector_inverse(self._rotation, x - px, y - py, z - pz)
        return "footplate" if ahead + self._com_B_m[0] > self._footplate_from_x_m else "body"

    def _update_tag(self) -> None:
        tag = BodyTag(
            role=Role.CHAIR,
            kind=Role.CHAIR.value,
            actor_id=chair_actor_id(self.seat),
            p_W_m=self._p_com_W_m,
            v_W_mps=self._v_W_mps,
            yaw_rate_radps=self._w_W_radps[2],
        )
        self._engine.tag(self.body_id, tag)
