"""A whole user fitted to recorded drives: every number that they tell, how sure it is, and which they cannot tell.

The speed somebody likes, and how often they look elsewhere or correct, have intervals by drawing stretches anew.

Four switches in the place of a stick: whether a drive was driven with them, and how late and how long they are held.

Switches add no chance of their own, so the right delay and the right hold make every sample again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from wcsim.config import RunConfig, parse_json
from wcsim.core import seeding
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError
from wcsim.log.drive import DriveRecording
from wcsim.types import F64, Bool, Joystick
from wcsim.users.hand import DRIVE_ABOVE, STEER_ABOVE, SwitchHand
from wcsim.users.perception import LONGEST_AWAY, UNCUT_AWAY
from wcsim.users.profiles import PAIRS, PROFILE_LIMITS, UserProfile
from wcsim.users.recordings.hand_likelihood import BLOCK_S, LOGS, HandLaw, fit_law
from wcsim.users.recordings.hand_series import (
    SHORTEST_S,
    HandSeries,
    at_switches,
    check_stick,
    correction_s,
    hand_series,
    stretches,
)

_RESAMPLED = 400
_USUAL_SPEED = 0.9  # quantile
_SMOOTH_S = 1.0
_LOOK_S = 0.5  # an intent that stands still for less may do so by chance
_RARE_SHARE = 0.05  # of looks elsewhere that are none
_ON_ITS_WAY = 2.0  # ticks: corrections as near to each other are no single ones
_SAME = 1e-4  # of the stick's travel
_FEW_TICKS, _MORE_TICKS = 300, 900  # of a drive are looked at: more of them say the same again
_COARSE_S = 0.01, 0.004  # as near as that both must be to make anything again
_REACTIONS_S, _HOLDS_S = np.arange(0.2, 1.3, 0.05), np.arange(0.1, 0.6, _COARSE_S[1])
_BEFORE_S = np.arange(-0.035, 0.001, _COARSE_S[0])  # a press is seen at the first sample after it
_STARTS, _HALVINGS, _FINE_S = 3, 2, 0.004
_AS_GOOD = 0.002  # share of the samples by which one value may be worse than the best and still be possible
WIDEST = 0.15  # half an interval against its value: wider is not told well
_FLOORS = {"bias_x": 0.02, "bias_y": 0.05, "tremor": 0.01, "noise": 0.003, "away_share": 0.05}
_SHORT_S = 180.0  # a drive that says little
_SD = 1.96  # of an interval of 95 %
_FEWEST_BLOCKS = 6
_LEAST_COUNTED = 0.1  # of the samples of a moving stick; users of the profiles have 0.25 and more
_MORE = {
    "gain_x": "drive more turns to both sides",
    "bias_x": "drive more turns to both sides",
    "gain_y": "start and stop more often",
    "bias_y": "start and stop more often, below full speed",
    "tremor": "drive longer",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedNumber:
    """A number of a user, and its interval of 95 %."""

    value: float
    low: float
    high: float
    n: int = 0  # people or pieces that it is the mean of, where these are counted


def _usual_speed(
    drives: Sequence[DriveRecording],
    series: Sequence[HandSeries],
    found: Mapping[str, FittedNumber],
    wanted: bool,
) -> FittedNumber:
    """The usual speed as a share of the chair's: what the stick, without this hand's gain and bias, asks for at most.

    Args:
        drives: Of one chair.
        series: Their episodes.
        found: The hand, as far as it was fitted.
        wanted: Whether the intents are what was wanted; else the stick is asked, averaged over a second.
    """
    chair = parse_json(RunConfig, drives[0].header.config, "the configuration in the drive").chair
    gain = found["gain_y"].value if "gain_y" in found else 1.0
    bias = found["bias_y"].value if "bias_y" in found else 0.0
    rows = [
        item.intents[:, 1] if wanted else (_smooth(item) - bias) / max(gain, 0.05)
        for item in series
    ]

    def share(parts: F64) -> float:
        pushed = float(np.quantile(parts[:, 0], _USUAL_SPEED))
        if (
            "correct_every_s" in found
        ):  # who misses the size of corrections asks for more and less than is liked
            pushed = (
                float(np.median(parts[parts[:, 0] > 0.5 * pushed, 0], axis=0))
                if pushed > 0.0
                else 0.0
            )
        out = max(0.0, pushed - chair.deadband) / (1.0 - chair.deadband)
        return float(min(1.0, max(0.05, out**chair.shape_exponent)))

    return _resampled([part[:, None] for part in rows], series, share)


def _look_shares(series: Sequence[HandSeries]) -> dict[str, FittedNumber]:
    """Looks elsewhere, or single corrections, by how intents stand still."""
    tick_s = series[0].tick_s
    gaps = [correction_s(item.intents, tick_s) for item in series]
    known = [gap for gap in gaps if gap is not None]
    changes = np.concatenate(
        [(np.diff(item.intents, axis=0) != 0.0).any(axis=1) for item in series]
    )
    if known and float(changes.mean()) < 1.0 / _ON_ITS_WAY:
        # between two corrections an intent stands still as in a look elsewhere, which cannot be told then

        def every(parts: F64) -> float:
            return correction_s(parts, tick_s) or float(np.mean(known))

        return {"correct_every_s": _resampled([item.intents for item in series], series, every)}
    rows = [_looked(item) for item in series]
    away = _resampled(rows, series, lambda t: float(t[:, 0].sum() / max(1.0, t[:, 1].sum())))
    if away.value < _RARE_SHARE:
        return {"away_share": replace(away, value=0.0, low=0.0)}
    lasting = _resampled(
        rows, series, lambda t: _mean_look(tick_s * float(t[:, 0].sum() / max(1.0, t[:, 2].sum())))
    )
    return {"away_share": away, "away_s": lasting}


def _looked(item: HandSeries) -> F64:
    """(N - 1, 3) of each tick: in a look elsewhere, driven forward, the last one of a look."""
    intents = item.intents
    driven: Bool = intents[1:, 1] > 0.0
    still: Bool = (np.diff(intents[:, 1]) == 0.0) & (np.diff(np.abs(intents[:, 0])) <= 0.0) & driven
    rows = np.zeros((len(still), 3))
    rows[:, 1] = driven
    for start, stop in stretches(still):
        if (stop - start) * item.tick_s >= _LOOK_S - 1e-9:
            rows[start:stop, 0] = 1.0
            rows[stop - 1, 2] = 1.0
    return rows


def _mean_look(seen_s: float) -> float:
    """The mean of all looks, when those of half a second or more last `seen_s` on average."""
    low_s, high_s = 0.1, 30.0
    for _ in range(40):
        mean_s = 0.5 * (low_s + high_s)
        rate_s, most_s = UNCUT_AWAY * mean_s, max(_LOOK_S, LONGEST_AWAY * mean_s)
        lasts_s = _LOOK_S + rate_s * (1.0 - math.exp(-(most_s - _LOOK_S) / rate_s))
        low_s, high_s = (mean_s, high_s) if lasts_s < seen_s else (low_s, mean_s)
    return 0.5 * (low_s + high_s)


def _smooth(item: HandSeries) -> F64:
    width = min(len(item.stick), max(1, round(_SMOOTH_S / item.apart_s)))
    return np.asarray(
        np.convolve(item.stick[:, 1], np.full(width, 1.0 / width), mode="valid"), np.float64
    )


def _resampled(
    rows: Sequence[F64], series: Sequence[HandSeries], value: Callable[[F64], float]
) -> FittedNumber:
    """A number of the rows (n, k) of all episodes, and its interval by drawing stretches of 10 s anew."""
    rng = seeding.generator(0, "stretches resampled")
    parts: list[F64] = []
    for table, item in zip(rows, series, strict=True):
        seconds = len(item.intents) * item.tick_s
        parts += np.array_split(table, max(1, round(seconds / BLOCK_S)))
    drawn = [
        value(
            np.concatenate([parts[k] for k in rng.integers(len(parts), size=len(parts)).tolist()])
        )
        for _ in range(_RESAMPLED)
    ]
    found, half = value(np.concatenate(list(rows))), _SD * float(np.std(drawn))
    return FittedNumber(value=found, low=max(0.0, found - half), high=found + half)


def _by_switches(series: Sequence[HandSeries]) -> bool:
    """Whether every sample is a position that four switches stand for."""
    return bool(at_switches(np.concatenate([item.stick for item in series])).all())


def _of_switches(series: Sequence[HandSeries], base: UserProfile) -> dict[str, FittedNumber]:
    """Delay and hold that make the most samples again; the others of `base` play no part.

    The first switch of an episode says the delay to a sample. Around it both are looked for together, on a lattice that
    gets finer around the best: a wrong hold makes a wrong delay look right.
    """
    first_s = _first_press_s(series)
    reactions_s = _REACTIONS_S if first_s is None else np.maximum(first_s + _BEFORE_S, 0.0)
    starts = _best(series, base, reactions_s, _HOLDS_S, _FEW_TICKS)[:_STARTS]
    refined = [_refined(series, base, start, (reactions_s[0], reactions_s[-1])) for start in starts]
    found = min(
        refined,
        key=lambda pair: _wrong(
            series, replace(base, reaction_s=pair[0], hold_s=pair[1]), _MORE_TICKS
        ),
    )
    user = replace(base, reaction_s=found[0], hold_s=found[1])
    around_s = _FINE_S * np.arange(-8.0, 8.5)
    late = np.array(
        [
            _wrong(series, replace(user, reaction_s=found[0] + by_s), _MORE_TICKS)
            for by_s in around_s
        ]
    )
    held = np.array(
        [_wrong(series, replace(user, hold_s=found[1] + by_s), _MORE_TICKS) for by_s in around_s]
    )
    return {
        "reaction_s": _interval(found[0] + around_s, late),
        "hold_s": _interval(found[1] + around_s, held),
    }


def _first_press_s(series: Sequence[HandSeries]) -> float | None:
    """The shortest time from the first wish of an episode to the first switch; None where none began at rest."""
    found = []
    for item in series:
        wants = np.asarray(
            (item.intents[:, 1] > DRIVE_ABOVE) | (np.abs(item.intents[:, 0]) > STEER_ABOVE),
            np.bool_,
        )
        pressed = np.asarray((np.abs(item.stick) > _SAME).any(axis=1), np.bool_)
        if wants.any() and pressed.any() and not pressed[0]:
            pressed_s = float(item.time_s[int(np.argmax(pressed))]) - item.begun_s
            found.append(pressed_s - int(np.argmax(wants)) * item.tick_s)
    return min(found) if found else None


def _refined(
    series: Sequence[HandSeries],
    base: UserProfile,
    start: tuple[float, float],
    bounds_s: tuple[float, float],
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
    wrong = [
        _wrong(series, replace(base, reaction_s=late_s, hold_s=hold_s), ticks)
        for late_s, hold_s in pairs
    ]
    return [pairs[k] for k in np.argsort(wrong, kind="stable").tolist()]


def _interval(values: F64, wrong: F64) -> FittedNumber:
    """The middle of the values that fit best, and the least and the most that fit nearly as well."""
    best = values[wrong <= wrong.min()]
    fits = values[wrong <= wrong.min() + _AS_GOOD]
    half_s = 0.5 * float(values[1] - values[0])
    low, high = max(0.0, float(fits.min()) - half_s), float(fits.max()) + half_s
    return FittedNumber(value=float(best.mean()), low=low, high=high)


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


def is_told(name: str, estimate: FittedNumber) -> bool:
    """Whether half the interval is less than 15 % of the value, or than what does not matter."""
    return 0.5 * (estimate.high - estimate.low) <= max(
        WIDEST * abs(estimate.value), _FLOORS.get(name, 0.0)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class UserFit:
    """What drives say of their user."""

    profile: UserProfile
    estimates: dict[str, FittedNumber]  # gain and bias as gain_x, gain_y, bias_x, bias_y
    seconds: float  # driven
    warnings: tuple[str, ...]
    habits: Mapping[str, Mapping[str, FittedNumber]] = field(
        default_factory=dict
    )  # of sticks, by whose they are


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
    switched = _by_switches(series)
    found = _of_switches(series, base) if switched else _of_hand(fit_law(series))
    found |= _look_shares(series) if wanted and not switched else {}
    found |= {"speed_share": _usual_speed(drives, series, found, wanted)}
    profile = replace(base, discrete=switched, spread=0.0, **_numbers(found, switched))
    return UserFit(
        profile=profile,
        estimates=found,
        seconds=seconds,
        warnings=_warnings(found, seconds, series, wanted),
    )


def _require_alike(drives: Sequence[DriveRecording]) -> None:
    """Raise ConfigError for drives whose ticks or sticks do not mean the same: their times and speeds do not add up."""
    told = [_measures(drive) for drive in drives]
    for drive, got in zip(drives[1:], told[1:], strict=True):
        for name in got:
            if got[name] != told[0][name]:
                raise ConfigError(
                    f"{escaped(drive.name)}: was driven with {name} {got[name]:g}, {escaped(drives[0].name)} with "
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
        value, half = law.values[name], _SD * sd
        low, high = value - half, value + half
        if name in LOGS:
            low, high = value * math.exp(-half), value * math.exp(half)
        found[name] = FittedNumber(value=value, low=low, high=high)
    if "tremor" not in found:
        found["tremor"] = FittedNumber(value=0.0, low=0.0, high=law.tremor_most)
    return found


def _numbers(found: dict[str, FittedNumber], switched: bool) -> dict[str, Any]:
    """The numbers of a profile, within its bounds and rounded to what they tell."""
    plain = {
        name: _bounded(name, estimate.value)
        for name, estimate in found.items()
        if name.partition("_")[0] not in PAIRS
    }
    if switched:
        return {**plain, "noise": 0.0, "tremor": 0.0, "gain": (1.0, 1.0), "bias": (0.0, 0.0)}
    if not _tells_hand(found):
        return plain
    pairs: dict[str, Any] = {
        name: tuple(_bounded(name, found[f"{name}_{axis}"].value) for axis in "xy")
        for name in PAIRS
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
        told.append(
            f"intervals come from only {seconds / BLOCK_S:.0f} stretches of {BLOCK_S:.0f} s: too few to trust"
        )
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
        told.append(
            "intents come from the user model, which never looks away: time spent looking away counts as noise"
        )
    return tuple(told)
