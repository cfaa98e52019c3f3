"""Whether a plant can be built and stand: refused before anything moves, with the value, its unit and its bounds."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations
from typing import Final

from wcsim.config.plant import CasterPart, PlantFile
from wcsim.errors import ConfigError
from wcsim.physics.engine import GRAVITY_MPS2

_LEAST_FRAME_KG: Final = 30.0
_MOST_PUSH: Final = 0.8  # of the weight, by the springs of all casters
MARGIN_M: Final = 0.01  # by which the centre of mass must lie inside the wheels' support


def check_plant(file: PlantFile, frame_mass_kg: float, frame_com_z_m: float, name: str) -> None:
    """Raise ConfigError with everything about a plant that cannot be.

    Args:
        file: The parameters, each within its own bounds.
        frame_mass_kg: What is left for frame and user.
        frame_com_z_m: Height of their centre of mass.
        name: What the plant is called in the message.
    """
    faults = [*_masses(file, frame_mass_kg, frame_com_z_m), *_support(file), *_springs(file), *_beams(file)]
    faults += [*_above_ground(file), *_apart(file)]
    if faults:
        raise ConfigError(f"plant {name!r}: " + "; ".join(faults))


def _masses(file: PlantFile, frame_mass_kg: float, frame_com_z_m: float) -> Iterator[str]:
    if frame_mass_kg < _LEAST_FRAME_KG:
        yield (
            f"wheels, casters, arms, beams and anti-tips leave {frame_mass_kg:.1f} kg for frame and user; expected at "
            f"least {_LEAST_FRAME_KG:g} kg: raise mass.chair_kg ({file.mass.chair_kg:g} kg)"
        )
    elif frame_com_z_m <= 0.0:
        yield f"mass.com_z_m {file.mass.com_z_m:g} m puts the frame's centre of mass below the ground; expected higher"


def _support(file: PlantFile) -> Iterator[str]:
    """Front to back, casters turned the worst way; drive wheels left and right carry it sideways."""
    front_m = max([0.0, *(pair.swivel_x_m - pair.trail_m for pair in file.casters)])
    rear_m = min([0.0, *(pair.swivel_x_m + pair.trail_m for pair in file.casters)])
    low, high = rear_m + MARGIN_M, front_m - MARGIN_M
    if not low <= file.mass.com_x_m <= high:
        yield (
            f"mass.com_x_m is {file.mass.com_x_m:g} m: it tips at rest; expected {low:.3f} to {high:.3f} m, between "
            "the wheels with the casters turned the worst way"
        )


def _springs(file: PlantFile) -> Iterator[str]:
    """Sprung casters must neither lift the drive wheels off the ground nor lean on their stops."""
    sprung = [(number, pair, pair.arm) for number, pair in enumerate(file.casters) if pair.arm is not None]
    push_N = sum(2.0 * arm.preload_N for _, _, arm in sprung)
    weight_N = (file.mass.chair_kg + file.mass.user_kg) * GRAVITY_MPS2
    if push_N > _MOST_PUSH * weight_N:
        yield (
            f"the arms' preload_N push with {push_N:.0f} N together; expected at most {_MOST_PUSH:.0%} of the weight, "
            f"{_MOST_PUSH * weight_N:.0f} N, or the drive wheels hang in the air"
        )
    if len(sprung) < len(file.casters):  # the rigid ones hold it level
        return
    moment_Nm, stiffness_Nm = weight_N * file.mass.com_x_m, 0.0
    for _, pair, arm in sprung:
        x_m = pair.swivel_x_m - pair.trail_m
        unsprung_N = (pair.mass_kg + pair.fork_mass_kg + arm.mass_kg) * GRAVITY_MPS2
        moment_Nm -= 2.0 * x_m * (arm.preload_N + unsprung_N)
        stiffness_Nm += 2.0 * arm.stiffness_Npm * x_m * x_m
    for number, pair, arm in sprung:
        up_m = moment_Nm / stiffness_Nm * (pair.swivel_x_m - pair.trail_m)
        if not -arm.down_m < up_m < arm.up_m:
            yield (
                f"casters.{number}.arm stands {1000 * up_m:.0f} mm up at rest; expected between "
                f"{-1000 * arm.down_m:.0f} and {1000 * arm.up_m:.0f} mm: change preload_N or stiffness_Npm"
            )


def _beams(file: PlantFile) -> Iterator[str]:
    """A pair hangs on arms or on a beam, not on both."""
    for number, pair in enumerate(file.casters):
        if pair.arm is not None and pair.beam is not None:
            yield f"casters.{number} has an arm and a beam; expected one of them"


def _above_ground(file: PlantFile) -> Iterator[str]:
    for number, item in enumerate(file.antitips):
        bottom_m = item.p_m[2] - item.radius_m
        if bottom_m < 0.0:
            yield f"antitips.{number}.p_m: its bottom lies at {bottom_m:.3f} m; expected 0 m or more above the ground"
    for number, box in enumerate(file.frame.boxes):
        bottom_m = box.centre_m[2] - 0.5 * box.size_m[2]
        if bottom_m <= 0.0:
            yield f"frame.boxes.{number}: its bottom lies at {bottom_m:.3f} m; expected above the ground"
    top_m = max(box.centre_m[2] + 0.5 * box.size_m[2] for box in file.frame.boxes)
    if top_m > file.frame.height_m:
        yield f"frame.height_m is {file.frame.height_m:g} m; expected at least the highest box, {top_m:.3f} m"


def _apart(file: PlantFile) -> Iterator[str]:
    """Wheels must not meet, however the casters turn."""
    wheel = file.wheel
    if wheel.width_m >= wheel.track_m:
        yield f"wheel.width_m is {wheel.width_m:g} m; expected less than wheel.track_m, {wheel.track_m:g} m"
    inner_m = 0.5 * (wheel.track_m - wheel.width_m)
    for number, pair in enumerate(file.casters):
        sweep_m = _sweep_m(pair)
        if pair.track_m < 2.0 * sweep_m:
            yield f"casters.{number}.track_m is {pair.track_m:g} m; expected {2 * sweep_m:.3f} m or more, or both meet"
        gap_m = abs(pair.swivel_x_m) - sweep_m - wheel.radius_m
        if gap_m < 0.0 and 0.5 * pair.track_m + sweep_m > inner_m:
            yield (
                f"casters.{number}.swivel_x_m is {pair.swivel_x_m:g} m: the turning caster meets the drive wheel; "
                f"expected {wheel.radius_m + sweep_m:.3f} m or more from the axle"
            )
    for (i, one), (k, other) in combinations(enumerate(file.casters), 2):
        least_m = _sweep_m(one) + _sweep_m(other)
        apart_m = math.hypot(one.swivel_x_m - other.swivel_x_m, 0.5 * (one.track_m - other.track_m))
        if apart_m < least_m:
            yield f"casters.{i} and casters.{k} are {apart_m:.3f} m apart; expected {least_m:.3f} m, or they meet"


def _sweep_m(pair: CasterPart) -> float:
    """Radius of the circle that a turning caster needs."""
    return math.hypot(pair.trail_m + pair.radius_m, 0.5 * pair.width_m)
