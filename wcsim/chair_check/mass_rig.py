"""The mass rig and the tilt table: a chair's weight, inertia and grip, and when it tips.

How far a chair can be tilted until its uphill wheels carry nothing is as ISO 7176-1 asks. The table
is level ground and gravity turns, at most 0.2 degrees a second. Brakes are on, casters and swivels
are held at the angle that brings the tip line nearest to the centre of mass, and everything grips,
so that nothing slides. A chair on a beam rolls freely where it is tilted sideways, casters
trailing, and its beam's bearing has no friction.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Final

import numpy as np

from wcsim.chair_check.rig import FORWARD, NEUTRAL, ChairTestRig
from wcsim.chair_check.row import (
    TICK_S,
    TrialResult,
    TrialSetup,
    TrialSpec,
    make_trial_spec,
    run_trial,
)
from wcsim.chair_check.static_balance import (
    FORWARD_DOWN,
    LEFT_DOWN,
    REAR_DOWN,
    StaticChair,
    Vec2,
    compute_inertia_kgm2,
    compute_level_loads_N,
    compute_tip_angle_rad,
    find_uphill_feet,
    find_worst_swivel_rad,
    make_static_chair,
)
from wcsim.core.frames import deg2rad, rad2deg
from wcsim.physics.bullet import pybullet
from wcsim.physics.engine import GRAVITY_MPS2
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec
from wcsim.types import F64

# The mass rig.
_LIFT_M: Final = 20.0
_TORQUE_NM: Final = 20.0
_PUSH_S: Final = 0.5
_COAST_S: Final = 2.0
_COAST_MPS: Final = 1.0
_PULL_RATE_NPS: Final = 200.0
_SLIP_MPS: Final = 0.02
_UNIT_AXES: Final = np.eye(3)
_AXIS_NAMES: Final = ("roll", "pitch", "yaw")

# The tilt table.
_SLOW_TILT_RADPS: Final = deg2rad(0.2)
# A faster table lets the chair fall hard onto its anti-tips.
_FAST_TILT_RADPS: Final = deg2rad(4.0)
# The slow part begins so far below the tilt that is expected, and is given up so far above it.
_SLOW_FROM_RAD: Final = deg2rad(2.0)
_GIVE_UP_RAD: Final = deg2rad(3.0)
_SETTLE_S: Final = 10.0
_QUIET_RADPS: Final = 1e-3
_STAGE_SHARES: Final = (1 / 3, 2 / 3, 1.0)
_GRIP: Final = 2.0
# Many wheels that are held at once are stiff.
_SOLVER_ITERATIONS: Final = 1000
_COM_HEIGHTS_M: Final = (0.50, 0.60)
_TIP_ROW: Final = "{way}_com_{cm}cm"


def make_mass_rig_trials(setup: TrialSetup) -> Iterator[TrialSpec]:
    """The rows of one plant."""
    spec = plant_spec(setup.chair)
    yield make_trial_spec("mass", _mass_kg, spec.whole_kg)
    chair = make_static_chair(spec)
    loads = compute_level_loads_N(chair)
    yield make_trial_spec("drive_wheel_share", _drive_wheel_share, _share_on_wheels(loads))
    for axis, inertia in enumerate(compute_inertia_kgm2(spec)):
        measure = partial(_turning_inertia_kgm2, axis=axis)
        yield make_trial_spec("inertia_{axis}", measure, float(inertia), axis=_AXIS_NAMES[axis])
    yield make_trial_spec("turning_loss", _turning_loss_per_s)
    yield make_trial_spec("coasting_loss", _coasting_mps2, speed_mps=_COAST_MPS)
    # The friction of each foot, weighted with its load.
    friction = {foot.name: foot.friction for foot in chair.feet}
    grip = sum(load * friction[name] for name, load in loads.items()) / (
        spec.whole_kg * GRAVITY_MPS2
    )
    yield make_trial_spec("grip", _grip, grip)


def make_tip_trials(setup: TrialSetup, only: Sequence[str] = ()) -> Iterator[TrialSpec]:
    """The rows of one plant: each way to tip at each height of the centre of mass.

    What is expected takes a moment to find, so rows whose names begin with none of the words of
    `only` are left out.
    """
    for name, downhill, antitips in _tip_cases(setup):
        for height_m in _COM_HEIGHTS_M:
            if only and not _tip_row_name(name, height_m).startswith(tuple(only)):
                continue
            expected_deg = rad2deg(
                _expected_tip_rad(setup.at_com_height(height_m), downhill, antitips)
            )
            measure = partial(_tip_deg, height_m=height_m, downhill=downhill, antitips=antitips)
            yield make_trial_spec(
                _TIP_ROW, measure, expected_deg, way=name, cm=round(100 * height_m)
            )


def tip_ratio_rows(setup: TrialSetup, rows: Mapping[str, TrialResult]) -> Iterator[TrialResult]:
    """Share of each tip angle that is left as the centre of mass is raised; same pivots."""
    low_m, high_m = _COM_HEIGHTS_M
    for name, _, _ in _tip_cases(setup):
        pair = rows.get(_tip_row_name(name, low_m)), rows.get(_tip_row_name(name, high_m))
        if pair[0] is None or pair[1] is None:
            continue
        found = partial(_known_value, value=pair[1].value / pair[0].value)
        yield run_trial(
            make_trial_spec("{way}_falls", found, way=name, low=low_m, high=high_m), setup
        )


def _mass_kg(setup: TrialSetup) -> float:
    """Mass of chair and user: what the scales under all wheels show."""
    with ChairTestRig(setup) as rig:
        return sum(rig.weigh_N().values()) / GRAVITY_MPS2


def _drive_wheel_share(setup: TrialSetup) -> float:
    """Share of the weight that rests on the drive wheels."""
    with ChairTestRig(setup) as rig:
        return _share_on_wheels(rig.weigh_N())


def _share_on_wheels(loads_N: Mapping[str, float]) -> float:
    on_wheels_N = sum(load for name, load in loads_N.items() if name.startswith("wheel"))
    return on_wheels_N / sum(loads_N.values())


def _turning_inertia_kgm2(setup: TrialSetup, axis: int) -> float:
    """Moment of inertia about an axis: 0 roll, 1 pitch, 2 yaw.

    A known torque acts for half a second; the rate gives the inertia.
    """
    with ChairTestRig(setup) as rig:
        _lift_off(rig)
        _apply_torque(rig, _UNIT_AXES[axis])
        return _TORQUE_NM * _PUSH_S / float(_angular_rate_radps(rig)[axis])


def _turning_loss_per_s(setup: TrialSetup) -> float:
    """Share of its yaw rate that a floating chair loses in a second: by damping alone."""
    with ChairTestRig(setup) as rig:
        _lift_off(rig)
        _apply_torque(rig, _UNIT_AXES[2])
        before = float(_angular_rate_radps(rig)[2])
        for _ in range(2 * setup.hz):
            rig.engine.step()
        return 0.5 * (1.0 - float(_angular_rate_radps(rig)[2]) / before)


def _coasting_mps2(setup: TrialSetup) -> float:
    """How fast it slows down on level ground with its motors off, from its top speed."""
    with ChairTestRig(setup) as rig:
        before = rig.drive(FORWARD, 4.0).speed_mps[-1]
        wheels = [index for name, index in rig.links().items() if name.startswith("wheel")]
        for _ in range(round(_COAST_S * setup.hz)):
            rig.chair.before_step()
            rig.bullet.setJointMotorControlArray(
                rig.body, wheels, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(wheels)
            )
            rig.engine.step()
            rig.chair.after_step()
        after = float(rig.chair.state().v_B_mps[0])
    return (float(before) - after) / _COAST_S


def _grip(setup: TrialSetup) -> float:
    """Pull along the ground at which it slides with held wheels, as a share of its weight."""
    with ChairTestRig(setup) as rig:
        rig.drive(NEUTRAL, 2.0)
        rig.lock("wheel", "caster", "swivel")
        spec = rig.chair.spec
        # Towards its casters: pulled away from them, wheels that are held hop before they slide.
        way = -1.0 if all(pair.swivel_x_m < 0.0 for pair in spec.casters) else 1.0
        pull_N = 0.0
        while pull_N < 3.0 * spec.whole_kg * GRAVITY_MPS2:
            pull_N += _PULL_RATE_NPS / setup.hz
            place = rig.chair.state().p_WB_m + np.array([spec.mass.com_x_m, 0.0, 0.0])
            rig.chair.before_step()
            rig.bullet.applyExternalForce(
                rig.body, -1, (way * pull_N, 0.0, 0.0), place.tolist(), pybullet.WORLD_FRAME
            )
            rig.engine.step()
            rig.chair.after_step()
            if way * float(rig.chair.state().v_B_mps[0]) > _SLIP_MPS:
                break
        return pull_N / (spec.whole_kg * GRAVITY_MPS2)


def _lift_off(rig: ChairTestRig) -> None:
    """Lift the chair off the ground, without gravity, every joint held."""
    place, turn = rig.bullet.getBasePositionAndOrientation(rig.body)
    up = (place[0], place[1], place[2] + _LIFT_M)
    rig.bullet.resetBasePositionAndOrientation(rig.body, up, turn)
    rig.bullet.setGravity(0.0, 0.0, 0.0)
    rig.lock()


def _apply_torque(rig: ChairTestRig, axis: F64) -> None:
    """Give the chair a torque about an axis of the world for a while, as a pair of forces."""
    lever = np.roll(axis, 1)
    force = _TORQUE_NM * np.cross(axis, lever) / 2.0
    for _ in range(round(_PUSH_S * rig.setup.hz)):
        middle = np.array(rig.bullet.getBasePositionAndOrientation(rig.body)[0])
        for sign in (1.0, -1.0):
            rig.bullet.applyExternalForce(
                rig.body,
                -1,
                (sign * force).tolist(),
                (middle + sign * lever).tolist(),
                pybullet.WORLD_FRAME,
            )
        rig.engine.step()


def _angular_rate_radps(rig: ChairTestRig) -> F64:
    return np.array(rig.bullet.getBaseVelocity(rig.body)[1])


def _known_value(_setup: TrialSetup, value: float) -> float:
    return value


def _tip_cases(setup: TrialSetup) -> Iterator[tuple[str, Vec2, bool]]:
    yield "tip_forward", FORWARD_DOWN, True
    yield "tip_rear", REAR_DOWN, True
    antitips_x_m = [pair.p_m[0] for pair in plant_spec(setup.chair).antitips]
    if any(x_m > 0.0 for x_m in antitips_x_m):
        yield "tip_forward_no_antitips", FORWARD_DOWN, False
    if any(x_m < 0.0 for x_m in antitips_x_m):
        yield "tip_rear_no_antitips", REAR_DOWN, False
    yield "tip_lateral", LEFT_DOWN, True


def _tip_row_name(way: str, height_m: float) -> str:
    return _TIP_ROW.format(way=way, cm=round(100 * height_m))


def _expected_tip_rad(setup: TrialSetup, downhill: Vec2, antitips: bool) -> float:
    """The tilt at which a chair tips, from the masses and contact points that its file declares."""
    return compute_tip_angle_rad(_chair_on_table(setup, downhill, antitips), downhill)


def _tip_deg(setup: TrialSetup, height_m: float, downhill: Vec2, antitips: bool) -> float:
    """The tilt at which the simulated chair's uphill wheels carry nothing any more.

    It is at most 3 degrees above the expected one.

    Args:
        setup: The chair and the rate.
        height_m: Height of its centre of mass.
        downhill: Unit vector in the chair's x and y.
        antitips: Whether it has its anti-tips.
    """
    setup = setup.at_com_height(height_m)
    expected = _expected_tip_rad(setup, downhill, antitips)
    upper = find_uphill_feet(_chair_on_table(setup, downhill, antitips), downhill)
    with ChairTestRig(setup, iterations=_SOLVER_ITERATIONS) as rig:
        # 1. Hold the joints, and wait on level ground.
        _hold_joints(rig, downhill, antitips)
        table = _TiltTable(rig, downhill, upper)
        table.settle()

        # 2. Tilt fast, in stages: a chair that falls onto its anti-tips rocks there for a while.
        start_rad = max(expected - _SLOW_FROM_RAD, 0.0)
        for share in _STAGE_SHARES:
            table.tilt_to(share * start_rad)
            table.settle()

        # 3. Tilt slowly until it tips.
        return rad2deg(table.tip_angle_rad(start_rad + _SLOW_FROM_RAD + _GIVE_UP_RAD))


def _chair_on_table(setup: TrialSetup, downhill: Vec2, antitips: bool) -> StaticChair:
    spec = plant_spec(setup.chair)
    chair = make_static_chair(spec, _swivel_rad(spec, downhill))
    return chair if antitips else chair.without("antitip")


def _wheels_roll(spec: PlantSpec, downhill: Vec2) -> bool:
    """Whether its wheels are left to roll.

    A beam is turned by the grip of its casters, sideways, too. How much of the grip wheels give
    that are all held is not determined; of wheels that roll it is, by their loads.
    """
    return downhill[0] == 0.0 and any(pair.beam is not None for pair in spec.casters)


def _swivel_rad(spec: PlantSpec, downhill: Vec2) -> float:
    return 0.0 if _wheels_roll(spec, downhill) else find_worst_swivel_rad(spec, downhill)


def _hold_joints(rig: ChairTestRig, downhill: Vec2, antitips: bool) -> None:
    spec = rig.chair.spec
    rig.turn_swivels(_swivel_rad(spec, downhill))
    if _wheels_roll(spec, downhill):
        # The statics that this is held against have no friction in the beam's bearing.
        rig.lock("swivel")
        rig.free("beam")
    else:
        rig.lock("wheel", "caster", "swivel")
    for name, index in (("frame", -1), *rig.links().items()):
        rig.bullet.changeDynamics(rig.body, index, lateralFriction=_GRIP)
        if name.startswith("antitip") and not antitips:
            rig.bullet.setCollisionFilterGroupMask(rig.body, index, 0, 0)


class _TiltTable:
    """A table under a chair that tilts downhill."""

    def __init__(self, rig: ChairTestRig, downhill: Vec2, upper: frozenset[str]) -> None:
        self._rig = rig
        self._downhill = downhill
        self._upper = upper
        self._tilt_rad = 0.0

    def settle(self) -> None:
        """Wait until the chair is quiet, ten seconds at most."""
        for _ in range(round(_SETTLE_S / TICK_S)):
            self._simulate_tick(0.0)
            if np.abs(self._rig.chair.state().w_B_radps).max() < _QUIET_RADPS:
                return

    def tilt_to(self, tilt_rad: float) -> None:
        """Tilt to an angle, fast."""
        away_rad = tilt_rad - self._tilt_rad
        ticks = math.ceil(away_rad / (_FAST_TILT_RADPS * TICK_S))
        for _ in range(ticks):
            self._simulate_tick(away_rad / (ticks * TICK_S))

    def tip_angle_rad(self, most_rad: float) -> float:
        """Tilt slowly until the uphill wheels are off for a tick, or to an angle at most."""
        while self._tilt_rad < most_rad:
            if self._simulate_tick(_SLOW_TILT_RADPS):
                return self._tilt_rad
        return self._tilt_rad

    def _simulate_tick(self, rate_radps: float) -> bool:
        """Simulate a tick at a rate; returns whether no uphill foot touched the table in it."""
        rig = self._rig
        lifted = True
        rig.chair.command(NEUTRAL)
        for _ in range(rig.setup.substeps):
            self._tilt_rad += rate_radps / rig.setup.hz
            fall = GRAVITY_MPS2 * math.sin(self._tilt_rad)
            down = (
                fall * self._downhill[0],
                fall * self._downhill[1],
                -GRAVITY_MPS2 * math.cos(self._tilt_rad),
            )
            rig.bullet.setGravity(*down)
            rig.substep()
            # Contacts, not loads: before it tips, a chair may stand on the whole width of its lower
            # tyres. Then the solver is free to give the upper wheels no load.
            lifted = lifted and self._upper.isdisjoint(rig.loads_N())
        rig.chair.end_tick(None)
        return lifted
