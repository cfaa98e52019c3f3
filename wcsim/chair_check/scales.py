"""On the scales: weight, where it rests, what it takes to turn the chair, and what brakes it when nothing should."""

from __future__ import annotations

from typing import Final

import numpy as np

from wcsim.chair_check.row import Setup
from wcsim.chair_check.yard import FORWARD, NEUTRAL, Yard
from wcsim.physics.bullet import pybullet
from wcsim.physics.engine import GRAVITY_MPS2
from wcsim.types import F64

_FLOAT_M: Final = 20.0  # above the ground
_TORQUE_NM: Final = 20.0
_PUSH_S: Final = 0.5
_COAST_S: Final = 2.0
_RAMP_NPS: Final = 200.0
_SLIP_MPS: Final = 0.02
_AXES: Final = np.eye(3)


def _weighed_loads_N(setup: Setup) -> dict[str, float]:
    """Mean normal load of each wheel over half a second, after two seconds of rest."""
    with Yard(setup) as yard:
        yard.drive(NEUTRAL, 2.0)
        steps = setup.hz // 2
        sums: dict[str, float] = {}
        for _ in range(steps):
            yard.substep()
            for name, load in yard.loads_N().items():
                sums[name] = sums.get(name, 0.0) + load / steps
        yard.chair.end_tick(None)
    return sums


def mass_kg(setup: Setup) -> float:
    """Mass of chair and user: what the scales under all wheels show."""
    return sum(_weighed_loads_N(setup).values()) / GRAVITY_MPS2


def drive_wheel_share(setup: Setup) -> float:
    """Share of the weight that rests on the drive wheels."""
    loads = _weighed_loads_N(setup)
    return sum(load for name, load in loads.items() if name.startswith("wheel")) / sum(loads.values())


def turning_inertia_kgm2(setup: Setup, axis: int) -> float:
    """Moment of inertia about an axis (0 roll, 1 pitch, 2 yaw): a known torque for half a second, then the rate."""
    with Yard(setup) as yard:
        _float(yard)
        _turn(yard, _AXES[axis])
        return _TORQUE_NM * _PUSH_S / float(_rate(yard)[axis])


def turning_loss_per_s(setup: Setup) -> float:
    """Share of its yaw rate that a chair afloat loses in a second: nothing but damping could take it."""
    with Yard(setup) as yard:
        _float(yard)
        _turn(yard, _AXES[2])
        before = float(_rate(yard)[2])
        for _ in range(2 * setup.hz):
            yard.engine.step()
        return 0.5 * (1.0 - float(_rate(yard)[2]) / before)


def coasting_mps2(setup: Setup) -> float:
    """How fast it slows down on level ground with its motors off, from its top speed."""
    with Yard(setup) as yard:
        before = yard.drive(FORWARD, 4.0).speed_mps[-1]
        wheels = [index for name, index in yard.links().items() if name.startswith("wheel")]
        for _ in range(round(_COAST_S * setup.hz)):
            yard.chair.before_step()
            pybullet.setJointMotorControlArray(
                yard.body, wheels, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(wheels), physicsClientId=yard.client
            )
            yard.engine.step()
            yard.chair.after_step()
        after = float(yard.chair.state().v_B_mps[0])
    return (float(before) - after) / _COAST_S


def grip(setup: Setup) -> float:
    """Pull on the chair along the ground, wheels held, at which it begins to slide, as a share of its weight.

    It is pulled towards its casters: pulled away from them, wheels that are held hop before they slide.
    """
    with Yard(setup) as yard:
        yard.drive(NEUTRAL, 2.0)
        yard.lock("wheel", "caster", "swivel")
        spec = yard.chair.spec
        way = -1.0 if all(pair.swivel_x_m < 0.0 for pair in spec.casters) else 1.0
        pull_N = 0.0
        while pull_N < 3.0 * spec.whole_kg * GRAVITY_MPS2:
            pull_N += _RAMP_NPS / setup.hz
            place = yard.chair.state().p_WB_m + np.array([spec.mass.com_x_m, 0.0, 0.0])
            yard.chair.before_step()
            pybullet.applyExternalForce(
                yard.body,
                -1,
                (way * pull_N, 0.0, 0.0),
                place.tolist(),
                pybullet.WORLD_FRAME,
                physicsClientId=yard.client,
            )
            yard.engine.step()
            yard.chair.after_step()
            if way * float(yard.chair.state().v_B_mps[0]) > _SLIP_MPS:
                break
        return pull_N / (spec.whole_kg * GRAVITY_MPS2)


def _float(yard: Yard) -> None:
    """Lift the chair off the ground, without gravity, every joint held."""
    place, turn = pybullet.getBasePositionAndOrientation(yard.body, physicsClientId=yard.client)
    up = (place[0], place[1], place[2] + _FLOAT_M)
    pybullet.resetBasePositionAndOrientation(yard.body, up, turn, physicsClientId=yard.client)
    pybullet.setGravity(0.0, 0.0, 0.0, physicsClientId=yard.client)
    yard.lock()


def _turn(yard: Yard, axis: F64) -> None:
    """Give the chair a torque about an axis of the world for a while, as a pair of forces."""
    lever = np.roll(axis, 1)
    force = _TORQUE_NM * np.cross(axis, lever) / 2.0
    for _ in range(round(_PUSH_S * yard.setup.hz)):
        middle = np.array(pybullet.getBasePositionAndOrientation(yard.body, physicsClientId=yard.client)[0])
        for sign in (1.0, -1.0):
            pybullet.applyExternalForce(
                yard.body,
                -1,
                (sign * force).tolist(),
                (middle + sign * lever).tolist(),
                pybullet.WORLD_FRAME,
                physicsClientId=yard.client,
            )
        yard.engine.step()


def _rate(yard: Yard) -> F64:
    return np.array(pybullet.getBaseVelocity(yard.body, physicsClientId=yard.client)[1])
