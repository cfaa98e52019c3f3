"""A whole user fitted to recorded drives: every number that they tell, how sure it is, and which they cannot tell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from wcsim.config import RunConfig, parse_json
from wcsim.core.reading import shown
from wcsim.errors import ConfigError
from wcsim.users.fitting.habit_fit import FittedNumber, looks, usual_speed
from wcsim.users.fitting.hand_likelihood import BLOCK_S, HandLaw, fit_law
from wcsim.users.fitting.hand_series import SHORTEST_S, HandSeries, hand_series
from wcsim.users.fitting.stick_positions import require_stick
from wcsim.users.fitting.switch_fit import by_switches, fit_switches
from wcsim.users.profiles import PROFILE_LIMITS, UserProfile
from wcsim.users.recording.drive_types import DriveRecording

WIDEST = 0.15  # half an interval against its value: wider is not told well
_FLOORS = {"bias_x": 0.02, "bias_y": 0.05, "tremor": 0.01, "noise": 0.003, "away_share": 0.05}
_SHORT_S = 180.0  # a drive that says little
_SD = 1.96  # of an interval of 95 %
_FEWEST_BLOCKS = 6
_LEAST_COUNTED = 0.1  # of the samples of a moving stick; users of the profiles have 0.25 and more
_PAIRS = ("gain", "bias")
_LOGS = ("lag_s", "noise", "noise_rate", "tremor")
_MORE = {
    "gain_x": "drive more turns to both sides",
    "bias_x": "drive more turns to both sides",
    "gain_y": "start and stop more often",
    "bias_y": "start and stop more often, below full speed",
    "tremor": "drive longer",
}


def is_told(name: str, estimate: FittedNumber) -> bool:
    """Whether half the interval is less than 15 % of the value, or than what does not matter."""
    return 0.5 * (estimate.high - estimate.low) <= max(WIDEST * abs(estimate.value), _FLOORS.get(name, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class UserFit:
    """What drives say of their user."""

    profile: UserProfile
    estimates: dict[str, FittedNumber]  # gain and bias as gain_x, gain_y, bias_x, bias_y
    seconds: float  # driven
    warnings: tuple[str, ...]


def fit_user(drives: Sequence[DriveRecording], base: UserProfile, wanted: bool = True) -> UserFit:
    """Fit the user model to drives of one person.

    Args:
        drives: With an intent in every tick.
        base: Whose numbers stand for what the drives do not tell.
        wanted: Whether the intents are what was wanted; else they were made by the user model, which never looks away.

    Raises:
        ConfigError: There is no intent, no episode of some seconds, or no stick (see `require_stick`); or the drives
            are of different ticks, or of chairs that take a stick otherwise.
    """
    if not all(drive.knows_intents for drive in drives):
        raise ConfigError("a drive has ticks without an intent; expected an intent in every tick")
    _require_alike(drives)
    for drive in drives:
        require_stick(drive.name, drive.ticks)
    series = hand_series(drives)
    if not series:
        raise ConfigError(
            f"no episode of {SHORTEST_S:g} s or more was recorded; expected minutes of driving: drive longer"
        )
    seconds = sum(len(item.intents) * item.tick_s for item in series)
    switched = by_switches(series)
    found = _of_switches(series, base) if switched else _of_hand(fit_law(series))
    found |= looks(series) if wanted and not switched else {}
    found |= {"speed_share": usual_speed(drives, series, found, wanted)}
    profile = replace(base, discrete=switched, spread=0.0, **_numbers(found, switched))
    return UserFit(
        profile=profile, estimates=found, seconds=seconds, warnings=_warnings(found, seconds, series, wanted)
    )


def _require_alike(drives: Sequence[DriveRecording]) -> None:
    """Raise ConfigError for drives whose ticks or sticks do not mean the same: their times and speeds do not add up."""
    told = [_measures(drive) for drive in drives]
    for drive, got in zip(drives[1:], told[1:], strict=True):
        for name in got:
            if got[name] != told[0][name]:
                raise ConfigError(
                    f"{shown(drive.name)}: was driven with {name} {got[name]:g}, {shown(drives[0].name)} with "
                    f"{told[0][name]:g}; expected the same {name}: fit them separately"
                )


def _measures(drive: DriveRecording) -> dict[str, float]:
    """What a drive's ticks and sticks are measured by, under the names of its settings."""
    chair = parse_json(RunConfig, drive.header.config, "the configuration in the drive").chair
    law = {"chair.deadband": chair.deadband, "chair.shape_exponent": chair.shape_exponent}
    return {"world.tick_s": drive.header.tick_s, **law}


def _of_hand(law: HandLaw) -> dict[str, FittedNumber]:
    """Nothing where nearly all of the driving lay at the gate: a law of what is left is none of the hand."""
    found: dict[str, FittedNumber] = {}
    if law.counted_share < _LEAST_COUNTED:
        return found
    for name, sd in law.sd.items():
        value = law.values[name]
        if name in _LOGS:
            found[name] = FittedNumber(value=value, low=value * math.exp(-_SD * sd), high=value * math.exp(_SD * sd))
        else:
            found[name] = FittedNumber(value=value, low=value - _SD * sd, high=value + _SD * sd)
    if "tremor" not in found:
        found["tremor"] = FittedNumber(value=0.0, low=0.0, high=law.tremor_most)
    return found


def _of_switches(series: Sequence[HandSeries], base: UserProfile) -> dict[str, FittedNumber]:
    law = fit_switches(series, base)
    both = {"reaction_s": law.reaction_s, "hold_s": law.hold_s}
    return {name: FittedNumber(value=value, low=low, high=high) for name, (value, low, high) in both.items()}


def _numbers(found: dict[str, FittedNumber], switched: bool) -> dict[str, Any]:
    """The numbers of a profile, within its bounds and rounded to what they tell."""
    plain = {
        name: _bounded(name, estimate.value) for name, estimate in found.items() if name.partition("_")[0] not in _PAIRS
    }
    if switched:
        return {**plain, "noise": 0.0, "tremor": 0.0, "gain": (1.0, 1.0), "bias": (0.0, 0.0)}
    if not _tells_hand(found):
        return plain
    pairs: dict[str, Any] = {
        name: tuple(_bounded(name, found[f"{name}_{axis}"].value) for axis in "xy") for name in _PAIRS
    }
    return {"correct_every_s": 0.0, **plain, **pairs}


def _tells_hand(found: dict[str, FittedNumber]) -> bool:
    return "reaction_s" in found  # of a stick and of switches


def _bounded(name: str, value: float) -> float:
    low, high = PROFILE_LIMITS[name]
    return float(f"{min(high, max(low, value)):.4g}")


def _warnings(
    found: dict[str, FittedNumber], seconds: float, series: Sequence[HandSeries], wanted: bool
) -> tuple[str, ...]:
    told = []
    if seconds < _SHORT_S:
        told.append(
            f"only {seconds:.0f} s were driven: expected {_SHORT_S:.0f} s or more, and ten minutes for most numbers"
        )
    if not _tells_hand(found):
        told.append(
            f"the stick was at the end of its travel for more than {1.0 - _LEAST_COUNTED:.0%} of the time: delay, lag, "
            "gain, bias, noise and tremor are those of --base; drive with half of the stick too"
        )
    if seconds < _FEWEST_BLOCKS * BLOCK_S:
        told.append(f"intervals come from only {seconds / BLOCK_S:.0f} stretches of {BLOCK_S:.0f} s: too few to trust")
    if series[0].apart_s > 0.06:
        fastest_hz = 0.5 / series[0].apart_s
        told.append(
            f"the stick was recorded every {series[0].apart_s:g} s: a tremor above {fastest_hz:g} Hz looks slower"
        )
    for name, item in found.items():
        if not is_told(name, item):
            more = _MORE.get(name, "drive longer")
            told.append(
                f"{name} is uncertain by more than 15 %: {item.value:.3g}, between {item.low:.3g} and "
                f"{item.high:.3g}; {more}"
            )
    if not wanted:
        told.append("intents come from the user model, which never looks away: time spent looking away counts as noise")
    return tuple(told)
