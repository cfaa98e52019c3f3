"""A plant as its parameter file declares it: the chair as statics sees it, and how it resists being turned."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from wcsim.chair_check.static_balance import Beam, Foot, Stand, SupportSpring, Vec2, Vec3, rigid_tip_rad
from wcsim.config.plant import CasterPart
from wcsim.core.frames import rad
from wcsim.physics.engine import GRAVITY_MPS2
from wcsim.physics.wheelchair.plant import FORK_COM_M, FORK_M, PlantSpec
from wcsim.physics.wheelchair.plant_body import BEAM_INERTIA_KGM2
from wcsim.types import F64

FORWARD_DOWN: Final[Vec2] = (1.0, 0.0)
REAR_DOWN: Final[Vec2] = (-1.0, 0.0)
LEFT_DOWN: Final[Vec2] = (0.0, 1.0)
_TURNS: Final = 72  # swivel angles that are tried for the worst
_ARM_INERTIA_KGM2: Final = 0.01  # small beside everything else
_SIDES: Final = (("l", 1.0), ("r", -1.0))

Part = tuple[float, Vec3, Vec3]  # mass in kg, centre in B, moments of inertia about it along B's axes


def stand(spec: PlantSpec, swivel_rad: float = 0.0) -> Stand:
    """The chair with every caster's fork turned to an angle (0 is trailing), arms at rest."""
    feet = [*_wheels(spec), *_casters(spec, swivel_rad), *_antitips(spec)]
    return Stand(mass_kg=spec.whole_kg, com_m=_com_m(spec, swivel_rad), feet=tuple(feet))


def _com_m(spec: PlantSpec, swivel_rad: float = 0.0) -> Vec3:
    """Centre of mass of chair and user in B; forks and casters move it a little when they turn."""
    x, y, z = spec.mass.com_x_m, 0.0, spec.mass.com_z_m
    turned_x, turned_y = 1.0 - math.cos(swivel_rad), -math.sin(swivel_rad)
    for pair in spec.casters:
        moment_kgm = 2.0 * pair.trail_m * (pair.mass_kg + 0.5 * pair.fork_mass_kg)
        x += moment_kgm * turned_x / spec.whole_kg
        y += moment_kgm * turned_y / spec.whole_kg
    return x, y, z


def worst_swivel_rad(spec: PlantSpec, downhill: Vec2) -> float:
    """The swivel angle at which the tip line lies nearest to the centre of mass, anti-tips left out."""
    angles = [2.0 * math.pi * k / _TURNS for k in range(_TURNS)]
    return min(angles, key=lambda angle: rigid_tip_rad(stand(spec, angle).without("antitip"), downhill))


def inertia_kgm2(spec: PlantSpec) -> F64:
    """Moments of inertia of the whole chair about its centre of mass, along B's axes, (3,), casters trailing."""
    about = np.array(_com_m(spec))
    total = np.zeros(3)
    for mass_kg, place, own in _parts(spec):
        arm = np.array(place) - about
        total += np.array(own) + mass_kg * (arm @ arm - arm**2)
    return total


def _wheels(spec: PlantSpec) -> Iterator[Foot]:
    wheel = spec.wheel
    for side, sign in _SIDES:
        yield Foot(
            name=f"wheel_{side}",
            centre_m=(0.0, 0.5 * sign * wheel.track_m, wheel.radius_m),
            radius_m=wheel.radius_m,
            axis=(0.0, 1.0, 0.0),
            half_width_m=0.5 * wheel.width_m,
            friction=wheel.friction,
        )


def _casters(spec: PlantSpec, swivel_rad: float) -> Iterator[Foot]:
    cos, sin = math.cos(swivel_rad), math.sin(swivel_rad)
    for number, pair in enumerate(spec.casters):
        for side, sign in _SIDES:
            hub = (pair.swivel_x_m - pair.trail_m * cos, 0.5 * sign * pair.track_m - pair.trail_m * sin)
            yield Foot(
                name=f"caster_{number}_{side}",
                centre_m=(*hub, pair.radius_m),
                radius_m=pair.radius_m,
                axis=(-sin, cos, 0.0),
                half_width_m=0.5 * pair.width_m,
                friction=pair.friction,
                spring=_spring(pair),
                beam=_beam(pair),
            )


def _spring(pair: CasterPart) -> SupportSpring | None:
    if pair.arm is None:
        return None
    return SupportSpring(
        stiffness_N_per_m=pair.arm.stiffness_Npm,
        preload_N=pair.arm.preload_N,
        least_m=-pair.arm.down_m,
        most_m=pair.arm.up_m,
        unsprung_kg=pair.mass_kg + pair.fork_mass_kg + pair.arm.mass_kg,
    )


def _beam(pair: CasterPart) -> Beam | None:
    if pair.beam is None:
        return None
    swivel_z_m = pair.radius_m + FORK_M
    parts = (
        (2.0 * pair.mass_kg, pair.radius_m),
        (2.0 * pair.fork_mass_kg, swivel_z_m - FORK_COM_M),
        (pair.beam.mass_kg, swivel_z_m),
    )
    mass_kg = sum(part for part, _ in parts)
    return Beam(
        pivot_z_m=pair.beam.pivot_z_m,
        stop_rad=rad(pair.beam.stop_deg),
        weight_N=mass_kg * GRAVITY_MPS2,
        com_z_m=sum(part * z_m for part, z_m in parts) / mass_kg,
    )


def _antitips(spec: PlantSpec) -> Iterator[Foot]:
    for number, pair in enumerate(spec.antitips):
        for side, sign in _SIDES:
            x, y, z = pair.p_m
            name = f"antitip_{number}_{side}"
            yield Foot(name=name, centre_m=(x, sign * y, z), radius_m=pair.radius_m, friction=pair.friction)


def _parts(spec: PlantSpec) -> Iterator[Part]:
    """Everything that has a mass, one side of each pair after the other."""
    yield spec.frame_mass_kg, spec.frame_com_m, spec.frame_inertia_kgm2
    for _, sign in _SIDES:
        wheel = spec.wheel
        at = (0.0, 0.5 * sign * wheel.track_m, wheel.radius_m)
        across, along, _ = _disc(wheel.mass_kg, wheel.radius_m, wheel.width_m)
        yield wheel.mass_kg, at, (across, along + spec.motor.rotor_inertia_kgm2, across)
        for pair in spec.casters:
            y = 0.5 * sign * pair.track_m
            swivel_z = pair.radius_m + FORK_M
            hub = (pair.swivel_x_m - pair.trail_m, y, pair.radius_m)
            yield pair.mass_kg, hub, _disc(pair.mass_kg, pair.radius_m, pair.width_m)
            fork = (pair.swivel_x_m - 0.5 * pair.trail_m, y, swivel_z - FORK_COM_M)
            yield pair.fork_mass_kg, fork, (pair.fork_inertia_kgm2,) * 3
            if pair.arm is not None:
                yield pair.arm.mass_kg, (pair.swivel_x_m, y, swivel_z), (_ARM_INERTIA_KGM2,) * 3
            if pair.beam is not None:  # half of a rod as long as the pair's track
                long = 0.5 * pair.beam.mass_kg * pair.track_m**2 / 12.0
                at = (pair.swivel_x_m, 0.0, swivel_z)
                yield 0.5 * pair.beam.mass_kg, at, (long, min(0.5 * BEAM_INERTIA_KGM2, long), long)
        for antitip in spec.antitips:
            x, y, z = antitip.p_m
            yield antitip.mass_kg, (x, sign * y, z), (antitip.inertia_kgm2,) * 3


def _disc(mass_kg: float, radius_m: float, width_m: float) -> Vec3:
    across = mass_kg * (3.0 * radius_m**2 + width_m**2) / 12.0
    return across, 0.5 * mass_kg * radius_m**2, across
