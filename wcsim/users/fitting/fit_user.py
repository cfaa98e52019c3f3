"""A whole user fitted to recorded drives: every number that they tell, how sure it is, and which they cannot tell.

Four switches in the place of a stick: whether a drive was driven with them, and how late and how long they are held.

Switches add no chance of their own, so the right delay and the right hold make every sample again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wcsim.config import RunConfig, parse_json
from wcsim.core.reading import shown
from wcsim.errors import ConfigError
from wcsim.types import F64, Joystick
from wcsim.users.fitting.habit_fit import FittedNumber, looks, usual_speed
from wcsim.users.fitting.hand_likelihood import BLOCK_S, HandLaw, fit_law
from wcsim.users.fitting.hand_series import SHORTEST_S, HandSeries, hand_series
from wcsim.users.fitting.stick_positions import at_switches, check_stick
from wcsim.users.hand import DRIVE_ABOVE, STEER_ABOVE, SwitchHand
from wcsim.users.profiles import PROFILE_LIMITS, UserProfile
from wcsim.users.recording.drive_types import DriveRecording

_SAME = 1e-4  # of the stick's travel
_FEW_TICKS, _MORE_TICKS = 300, 900  # of a drive are looked at: more of them say the same again
_COARSE_S = 0.01, 0.004  # as near as that both must be to make anything again
_REACTIONS_S, _HOLDS_S = np.arange(0.2, 1.3, 0.05), np.arange(0.1, 0.6, _COARSE_S[1])
_BEFORE_S = np.arange(-0.035, 0.001, _COARSE_S[0])  # a press is seen at the first sample after it
_STARTS, _HALVINGS, _FINE_S = 3, 2, 0.004
_AS_GOOD = 0.002  # share of the samples by which one value may be worse than the best and still be possible


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchLaw:
    """What of switches was found, each with the least and the most that fit as well."""

    reaction_s: tuple[float, float, float]
    hold_s: tuple[float, float, float]
    wrong_share: float  # of the samples that are not made again


def by_switches(series: Sequence[HandSeries]) -> bool:
    """Whether every sample is a position that four switches stand for."""
    return bool(at_switches(np.concatenate([item.stick for item in series])).all())


def _fit_switches(series: Sequence[HandSeries], base: UserProfile) -> SwitchLaw:
    """Delay and hold that make the most samples again; the others of `base` play no part.

    The first switch of an episode says the delay to a sample. Around it both are looked for together, on a lattice that
    gets finer around the best: a wrong hold makes a wrong delay look right.
    """
    first_s = _first_press_s(series)
    reactions_s = _REACTIONS_S if first_s is None else np.maximum(first_s + _BEFORE_S, 0.0)
    starts = _best(series, base, reactions_s, _HOLDS_S, _FEW_TICKS)[:_STARTS]
    refined = [_refined(series, base, start, (reactions_s[0], reactions_s[-1])) for start in starts]
    found = min(
        refined, key=lambda pair: _wrong(series, replace(base, reaction_s=pair[0], hold_s=pair[1]), _MORE_TICKS)
    )
    user = replace(base, reaction_s=found[0], hold_s=found[1])
    around_s = _FINE_S * np.arange(-8.0, 8.5)
    late = np.array([_wrong(series, replace(user, reaction_s=found[0] + by_s), _MORE_TICKS) for by_s in around_s])
    held = np.array([_wrong(series, replace(user, hold_s=found[1] + by_s), _MORE_TICKS) for by_s in around_s])
    return SwitchLaw(
        reaction_s=_interval(found[0] + around_s, late),
        hold_s=_interval(found[1] + around_s, held),
        wrong_share=float(min(late.min(), held.min())),
    )


def _first_press_s(series: Sequence[HandSeries]) -> float | None:
    """The shortest time from the first wish of an episode to the first switch; None where none began at rest."""
    found = []
    for item in series:
        wants = np.asarray((item.intents[:, 1] > DRIVE_ABOVE) | (np.abs(item.intents[:, 0]) > STEER_ABOVE), np.bool_)
        pressed = np.asarray((np.abs(item.stick) > _SAME).any(axis=1), np.bool_)
        if wants.any() and pressed.any() and not pressed[0]:
            pressed_s = float(item.time_s[int(np.argmax(pressed))]) - item.begun_s
            found.append(pressed_s - int(np.argmax(wants)) * item.tick_s)
    return min(found) if found else None


def _refined(
    series: Sequence[HandSeries], base: UserProfile, start: tuple[float, float], bounds_s: tuple[float, float]
) -> tuple[float, float]:
    """The best delay and hold near to these, on lattices that get finer; the delay keeps within bounds."""
    found = start
    for step in range(_HALVINGS):
        steps = 0.5**step * np.arange(-2.0, 2.5)
        reactions_s = np.clip(found[0] + 0.5 * _COARSE_S[0] * steps, *bounds_s)
        holds_s = np.maximum(found[1] + 0.5 * _COARSE_S[1] * steps, 0.01)
        found = _best(series, base, reactions_s, holds_s, _MORE_TICKS)[0]
    return found


def _best(
    series: Sequence[HandSeries], base: UserProfile, reactions_s: F64, holds_s: F64, ticks: int
) -> list[tuple[float, float]]:
    """The pairs of delay and hold of a lattice, those first that make the most samples again."""
    pairs = [(float(late_s), float(hold_s)) for late_s in reactions_s for hold_s in holds_s]
    wrong = [_wrong(series, replace(base, reaction_s=late_s, hold_s=hold_s), ticks) for late_s, hold_s in pairs]
    return [pairs[k] for k in np.argsort(wrong, kind="stable").tolist()]


def _interval(values: F64, wrong: F64) -> tuple[float, float, float]:
    """The middle of the values that fit best, and the least and the most that fit nearly as well."""
    best = values[wrong <= wrong.min()]
    fits = values[wrong <= wrong.min() + _AS_GOOD]
    half_s = 0.5 * float(values[1] - values[0])
    return float(best.mean()), max(0.0, float(fits.min()) - half_s), float(fits.max()) + half_s


def _wrong(series: Sequence[HandSeries], user: UserProfile, ticks: int) -> float:
    """The share of the samples of so many ticks that switches of this user would not have given."""
    wrong = total = 0
    for item in series:
        hand, made = SwitchHand(user), []
        for x, y in item.intents[:ticks].tolist():
            hand.want(Joystick(x, y))
            made.append(hand.move(item.steps, item.tick_s / item.steps))
        sticks = np.concatenate(made)
        at = item.at[item.at < len(sticks)]
        wrong += int((np.abs(sticks[at] - item.stick[: len(at)]).max(axis=1) > _SAME).sum())
        total += len(at)
        ticks -= len(item.intents)
        if ticks <= 0:
            break
    return wrong / max(1, total)


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
        ConfigError: There is no intent, no episode of some seconds, or no stick (see `check_stick`); or the drives
            are of different ticks, or of chairs that take a stick otherwise.
    """
    if not all(drive.knows_intents for drive in drives):
        raise ConfigError("a drive has ticks without an intent; expected an intent in every tick")
    _require_alike(drives)
    for drive in drives:
        check_stick(drive.name, drive.ticks)
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
    law = _fit_switches(series, base)
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
