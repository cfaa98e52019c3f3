"""The mass rig: weight, where it rests, what it takes to turn the chair, and what brakes it when nothing should."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Final

import numpy as np

from wcsim.chair_check.declared import inertia_kgm2, stand
from wcsim.chair_check.rig import FORWARD, NEUTRAL, Rig
from wcsim.chair_check.row import Setup, Trial
from wcsim.chair_check.static_balance import loads_N
from wcsim.physics.bullet import pybullet
from wcsim.physics.engine import GRAVITY_MPS2
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec
from wcsim.types import F64

_FLOAT_M: Final = 20.0  # above the ground
_TORQUE_NM: Final = 20.0
_PUSH_S: Final = 0.5
_COAST_S: Final = 2.0
_RAMP_NPS: Final = 200.0
_SLIP_MPS: Final = 0.02
_AXES: Final = np.eye(3)
_FILE: Final = "parameter file"
_COAST_MPS: Final = 1.0
_AXIS_NAMES: Final = ("roll", "pitch", "yaw")


def mass_trials(setup: Setup) -> Iterator[Trial]:
    """The rows of one plant."""
    spec = plant_spec(setup.chair)
    yield from _loads(spec)
    yield from _inertias(spec)
    yield from _losses(spec)


def _loads(spec: PlantSpec) -> Iterator[Trial]:
    yield Trial(
        name="mass",
        unit="kg",
        bound="file",
        low=0.995 * spec.whole_kg,
        high=1.005 * spec.whole_kg,
        method="normal loads of all wheels at rest, divided by 9.81 m/s2",
        source=_FILE,
        measure=_mass_kg,
    )
    loads = loads_N(stand(spec))
    share = sum(load for name, load in loads.items() if name.startswith("wheel")) / sum(loads.values())
    yield Trial(
        name="drive_wheel_share",
        unit="",
        bound="file",
        low=share - 0.02,
        high=share + 0.02,
        method="share of the weight that rests on the drive wheels",
        source="statics of masses, springs and contact points",
        measure=_drive_wheel_share,
    )


def _inertias(spec: PlantSpec) -> Iterator[Trial]:
    for axis, inertia in enumerate(inertia_kgm2(spec)):
        yield Trial(
            name=f"inertia_{_AXIS_NAMES[axis]}",
            unit="kg m2",
            bound="file",
            low=0.98 * float(inertia),
            high=1.02 * float(inertia),
            method="floating with joints held: 20 Nm for 0.5 s, divided by the resulting rate",
            source=_FILE + ": inertia of all parts, parallel axes",
            measure=partial(_turning_inertia_kgm2, axis=axis),
        )


def _losses(spec: PlantSpec) -> Iterator[Trial]:
    yield Trial(
        name="turning_loss",
        unit="1/s",
        bound="file",
        low=-0.001,
        high=0.001,
        method="share of its yaw rate that it loses in one second while floating",
        source="no damping is declared",
        measure=_turning_loss_per_s,
    )
    yield Trial(
        name="coasting_loss",
        unit="m/s2",
        bound="file",
        low=-0.01,
        high=0.01,
        method="slowing down on level ground from 1 m/s with the motors off, mean of 2 s",
        source="no rolling resistance is declared",
        measure=_coasting_mps2,
        speed_mps=_COAST_MPS,
    )
    chair = stand(spec)
    loads = loads_N(chair)
    friction = {foot.name: foot.friction for foot in chair.feet}
    grip = sum(load * friction[name] for name, load in loads.items()) / (spec.whole_kg * GRAVITY_MPS2)
    yield Trial(
        name="grip",
        unit="",
        bound="file",
        low=0.95 * grip,
        high=1.05 * grip,
        method="pull along the ground at which it slides with locked wheels, divided by its weight",
        source=_FILE + ": friction of each wheel, weighted with its load",
        measure=_grip,
    )


def _weighed_loads_N(setup: Setup) -> dict[str, float]:
    """Mean normal load of each wheel over half a second, after two seconds of rest."""
    with Rig(setup) as rig:
        rig.drive(NEUTRAL, 2.0)
        steps = setup.hz // 2
        sums: dict[str, float] = {}
        for _ in range(steps):
            rig.substep()
            for name, load in rig.loads_N().items():
                sums[name] = sums.get(name, 0.0) + load / steps
        rig.chair.end_tick(None)
    return sums


def _mass_kg(setup: Setup) -> float:
    """Mass of chair and user: what the scales under all wheels show."""
    return sum(_weighed_loads_N(setup).values()) / GRAVITY_MPS2


def _drive_wheel_share(setup: Setup) -> float:
    """Share of the weight that rests on the drive wheels."""
    loads = _weighed_loads_N(setup)
    return sum(load for name, load in loads.items() if name.startswith("wheel")) / sum(loads.values())


def _turning_inertia_kgm2(setup: Setup, axis: int) -> float:
    """Moment of inertia about an axis (0 roll, 1 pitch, 2 yaw): a known torque for half a second, then the rate."""
    with Rig(setup) as rig:
        _float(rig)
        _turn(rig, _AXES[axis])
        return _TORQUE_NM * _PUSH_S / float(_rate(rig)[axis])


def _turning_loss_per_s(setup: Setup) -> float:
    """Share of its yaw rate that a chair afloat loses in a second: nothing but damping could take it."""
    with Rig(setup) as rig:
        _float(rig)
        _turn(rig, _AXES[2])
        before = float(_rate(rig)[2])
        for _ in range(2 * setup.hz):
            rig.engine.step()
        return 0.5 * (1.0 - float(_rate(rig)[2]) / before)


def _coasting_mps2(setup: Setup) -> float:
    """How fast it slows down on level ground with its motors off, from its top speed."""
    with Rig(setup) as rig:
        before = rig.drive(FORWARD, 4.0).speed_mps[-1]
        wheels = [index for name, index in rig.links().items() if name.startswith("wheel")]
        for _ in range(round(_COAST_S * setup.hz)):
            rig.chair.before_step()
            pybullet.setJointMotorControlArray(
                rig.body, wheels, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(wheels), physicsClientId=rig.client
            )
            rig.engine.step()
            rig.chair.after_step()
        after = float(rig.chair.state().v_B_mps[0])
    return (float(before) - after) / _COAST_S


def _grip(setup: Setup) -> float:
    """Pull on the chair along the ground, wheels held, at which it begins to slide, as a share of its weight.

    It is pulled towards its casters: pulled away from them, wheels that are held hop before they slide.
    """
    with Rig(setup) as rig:
        rig.drive(NEUTRAL, 2.0)
        rig.lock("wheel", "caster", "swivel")
        spec = rig.chair.spec
        way = -1.0 if all(pair.swivel_x_m < 0.0 for pair in spec.casters) else 1.0
        pull_N = 0.0
        while pull_N < 3.0 * spec.whole_kg * GRAVITY_MPS2:
            pull_N += _RAMP_NPS / setup.hz
            place = rig.chair.state().p_WB_m + np.array([spec.mass.com_x_m, 0.0, 0.0])
            rig.chair.before_step()
            pybullet.applyExternalForce(
                rig.body,
                -1,
                (way * pull_N, 0.0, 0.0),
                place.tolist(),
                pybullet.WORLD_FRAME,
                physicsClientId=rig.client,
            )
            rig.engine.step()
            rig.chair.after_step()
            if way * float(rig.chair.state().v_B_mps[0]) > _SLIP_MPS:
                break
        return pull_N / (spec.whole_kg * GRAVITY_MPS2)


def _float(rig: Rig) -> None:
    """Lift the chair off the ground, without gravity, every joint held."""
    place, turn = pybullet.getBasePositionAndOrientation(rig.body, physicsClientId=rig.client)
    up = (place[0], place[1], place[2] + _FLOAT_M)
    pybullet.resetBasePositionAndOrientation(rig.body, up, turn, physicsClientId=rig.client)
    pybullet.setGravity(0.0, 0.0, 0.0, physicsClientId=rig.client)
    rig.lock()


def _turn(rig: Rig, axis: F64) -> None:
    """Give the chair a torque about an axis of the world for a while, as a pair of forces."""
    lever = np.roll(axis, 1)
    force = _TORQUE_NM * np.cross(axis, lever) / 2.0
    for _ in range(round(_PUSH_S * rig.setup.hz)):
        middle = np.array(pybullet.getBasePositionAndOrientation(rig.body, physicsClientId=rig.client)[0])
        for sign in (1.0, -1.0):
            pybullet.applyExternalForce(
                rig.body,
                -1,
                (sign * force).tolist(),
                (middle + sign * lever).tolist(),
                pybullet.WORLD_FRAME,
                physicsClientId=rig.client,
            )
        rig.engine.step()


def _rate(rig: Rig) -> F64:
    return np.array(pybullet.getBaseVelocity(rig.body, physicsClientId=rig.client)[1])
