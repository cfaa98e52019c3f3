"""A user fitted to recorded drives: each number that they show, how certain it is, and which not.

A hand is fitted by its likelihood (`hand_likelihood`). Desired speed, looks elsewhere and
corrections have intervals by drawing stretches anew. Four switches add no chance of their own, so
the right delay and the right hold reproduce every sample.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from wcsim.config import ChairConfig, RunConfig, parse_json
from wcsim.core import seeding
from wcsim.core.reading import escape
from wcsim.errors import ConfigError
from wcsim.log.drive import DriveRecording
from wcsim.types import F64, Bool, Joystick
from wcsim.users.hand import DRIVE_ABOVE, STEER_ABOVE, SwitchHandModel
from wcsim.users.perception import LONGEST_AWAY, UNCUT_AWAY
from wcsim.users.profiles import PAIRS, PROFILE_LIMITS, UserProfile
from wcsim.users.recordings.hand_likelihood import BLOCK_S, LOGS, HandFitResult, fit_hand_model
from wcsim.users.recordings.hand_series import (
    SAME_STICK,
    SHORTEST_S,
    HandTimeSeries,
    find_mean_correction_interval_s,
    find_true_spans,
    hand_series_from_drives,
    mask_switch_positions,
    require_analogue_stick,
)

_RESAMPLED: Final = 400
_SD: Final = 1.96  # of an interval of 95 %
_WIDEST: Final = 0.15  # half an interval against its value: a wider one is uncertain
# Half intervals that do not matter, however small the value is.
_FLOORS: Final = {
    "bias_x": 0.02,
    "bias_y": 0.05,
    "tremor": 0.01,
    "noise": 0.003,
    "away_share": 0.05,
}
_SHORT_S: Final = 180.0  # a drive that shows little
_FEWEST_BLOCKS: Final = 6
_LEAST_COUNTED: Final = 0.1  # of a moving stick's samples; users of the profiles have 0.25 or more
_FAST_TREMOR_S: Final = 0.06  # a stick with longer gaps shows no fast tremor
_MORE: Final = {
    "gain_x": "drive more turns to both sides",
    "bias_x": "drive more turns to both sides",
    "gain_y": "start and stop more often",
    "bias_y": "start and stop more often, below full speed",
    "tremor": "drive longer",
}

_USUAL_SPEED: Final = 0.9  # quantile
_SMOOTH_S: Final = 1.0
_LOOK_S: Final = 0.5  # an intent that stands still for less may do so by chance
_RARE_SHARE: Final = 0.05  # of looks elsewhere that are none
_SINGLE_TICKS: Final = 2.0  # corrections as near to each other are no single ones

_FEW_TICKS: Final = 300
_MORE_TICKS: Final = 900  # further ticks of a drive add nothing
# As near as that both must be to reproduce anything.
_COARSE_REACTION_S: Final = 0.01
_COARSE_HOLD_S: Final = 0.004
_REACTIONS_S: Final = np.arange(0.2, 1.3, 0.05)
_HOLDS_S: Final = np.arange(0.1, 0.6, _COARSE_HOLD_S)
# A press is seen at the first sample after it.
_BEFORE_S: Final = np.arange(-0.035, 0.001, _COARSE_REACTION_S)
_STARTS: Final = 3
_HALVINGS: Final = 2
_FINE_S: Final = 0.004
# By this share of the samples a value may be worse than the best and still be possible.
_AS_GOOD: Final = 0.002


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedParameter:
    """A number of a user, and its interval of 95 %."""

    value: float
    low: float
    high: float
    n: int = 0  # people or pieces that it is the mean of, where these are counted


@dataclass(frozen=True, slots=True, kw_only=True)
class UserFitResult:
    """What drives show of their user."""

    profile: UserProfile
    estimates: dict[str, FittedParameter]  # gain and bias as gain_x, gain_y, bias_x, bias_y
    seconds: float  # driven
    warnings: tuple[str, ...]
    # Of sticks, by their owners.
    habits: Mapping[str, Mapping[str, FittedParameter]] = field(default_factory=dict)


def fit_user_to_drives(
    drives: Sequence[DriveRecording], base: UserProfile, true_intents: bool = True
) -> UserFitResult:
    """Fit the user model to drives of one person.

    Args:
        drives: With an intent in every tick.
        base: The profile of the numbers that the drives do not show.
        true_intents: Whether the intents are the driver's; else they were made by the user model,
            which never looks away.

    Raises:
        ConfigError: There is no intent, no episode of some seconds, or no stick (see
            `require_analogue_stick`); or the drives differ in their ticks, or in how their chairs
            take a stick.
    """
    # 1. Check the drives.
    if not all(drive.knows_intents for drive in drives):
        raise ConfigError("a drive has ticks without an intent; expected an intent in every tick")
    _require_alike(drives)
    for drive in drives:
        require_analogue_stick(drive.name, drive.ticks)
    series = hand_series_from_drives(drives)
    if not series:
        raise ConfigError(
            f"no episode of {SHORTEST_S:g} s or more was recorded; "
            "expected minutes of driving: drive longer"
        )

    # 2. Fit the hand or the switches, then attention, then the speed, which needs the hand.
    switched = _has_switches(series)
    if switched:
        found = _fit_switches(series, base)
    else:
        found = _hand_numbers(fit_hand_model(series))
        found |= _fit_looks(series) if true_intents else {}
    found["speed_share"] = _fit_speed(drives, series, found, true_intents)

    # 3. Put the numbers into a profile.
    seconds = sum(len(item.intents) * item.tick_s for item in series)
    return UserFitResult(
        profile=replace(base, discrete=switched, spread=0.0, **_profile_numbers(found, switched)),
        estimates=found,
        seconds=seconds,
        warnings=_warnings(found, seconds, series, true_intents),
    )


def is_certain_estimate(name: str, estimate: FittedParameter) -> bool:
    """Whether half the interval is less than 15 % of the value, or too small to matter."""
    half = 0.5 * (estimate.high - estimate.low)
    return half <= max(_WIDEST * abs(estimate.value), _FLOORS.get(name, 0.0))


def _has_switches(series: Sequence[HandTimeSeries]) -> bool:
    """Whether every sample is a position that four switches stand for."""
    return bool(mask_switch_positions(np.concatenate([item.stick for item in series])).all())


def _require_alike(drives: Sequence[DriveRecording]) -> None:
    """Raise ConfigError for drives whose ticks or sticks differ: their times do not add up."""
    measures = []
    for drive in drives:
        chair = _chair_of(drive)
        measures.append(
            {
                "world.tick_s": drive.header.tick_s,
                "chair.deadband": chair.deadband,
                "chair.shape_exponent": chair.shape_exponent,
            }
        )
    for drive, other in zip(drives[1:], measures[1:], strict=True):
        for name, value in other.items():
            if value != measures[0][name]:
                raise ConfigError(
                    f"{escape(drive.name)}: was driven with {name} {value:g}, "
                    f"{escape(drives[0].name)} with {measures[0][name]:g}; "
                    f"expected the same {name}: fit them separately"
                )


def _chair_of(drive: DriveRecording) -> ChairConfig:
    return parse_json(RunConfig, drive.header.config, "the configuration in the drive").chair


# --- hand ---


def _hand_numbers(hand: HandFitResult) -> dict[str, FittedParameter]:
    """The numbers of a hand with their intervals.

    There are none where nearly all of the driving lay at the gate: the rest does not show the hand.
    """
    if hand.counted_share < _LEAST_COUNTED:
        return {}
    found = {}
    for name, sd in hand.sd.items():
        value, half = hand.values[name], _SD * sd
        low, high = value - half, value + half
        if name in LOGS:
            low, high = value * math.exp(-half), value * math.exp(half)
        found[name] = FittedParameter(value=value, low=low, high=high)
    if "tremor" not in found:
        found["tremor"] = FittedParameter(value=0.0, low=0.0, high=hand.tremor_most)
    return found


def _has_hand(found: Mapping[str, FittedParameter]) -> bool:
    return "reaction_s" in found  # of a stick and of switches


# --- attention and speed ---


def _fit_looks(series: Sequence[HandTimeSeries]) -> dict[str, FittedParameter]:
    """Looks elsewhere, or single corrections, by how intents stand still."""
    tick_s = series[0].tick_s
    gaps = [find_mean_correction_interval_s(item.intents, tick_s) for item in series]
    known = [gap for gap in gaps if gap is not None]
    changes = np.concatenate(
        [(np.diff(item.intents, axis=0) != 0.0).any(axis=1) for item in series]
    )
    if known and float(changes.mean()) < 1.0 / _SINGLE_TICKS:
        # Between two corrections an intent stands still as in a look elsewhere, and the two cannot
        # be told apart.

        def period_s(parts: F64) -> float:
            return find_mean_correction_interval_s(parts, tick_s) or float(np.mean(known))

        return {"correct_every_s": _resampled([item.intents for item in series], series, period_s)}
    rows = [_look_rows(item) for item in series]
    away = _resampled(rows, series, lambda t: float(t[:, 0].sum() / max(1.0, t[:, 1].sum())))
    if away.value < _RARE_SHARE:
        return {"away_share": replace(away, value=0.0, low=0.0)}
    lasting = _resampled(
        rows, series, lambda t: _mean_look(tick_s * float(t[:, 0].sum() / max(1.0, t[:, 2].sum())))
    )
    return {"away_share": away, "away_s": lasting}


def _look_rows(item: HandTimeSeries) -> F64:
    """(N - 1, 3) of each tick: in a look elsewhere, driven forward, the last one of a look."""
    intents = item.intents
    driven: Bool = intents[1:, 1] > 0.0
    still: Bool = (np.diff(intents[:, 1]) == 0.0) & (np.diff(np.abs(intents[:, 0])) <= 0.0) & driven
    rows = np.zeros((len(still), 3))
    rows[:, 1] = driven
    for start, stop in find_true_spans(still):
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
        if lasts_s < seen_s:
            low_s = mean_s
        else:
            high_s = mean_s
    return 0.5 * (low_s + high_s)


def _fit_speed(
    drives: Sequence[DriveRecording],
    series: Sequence[HandTimeSeries],
    found: Mapping[str, FittedParameter],
    true_intents: bool,
) -> FittedParameter:
    """The usual speed as a share of the chair's: the most that the stick usually commands.

    Without true intents it is the stick without this hand's gain and bias, averaged over a second.

    Args:
        drives: Of one chair.
        series: Their episodes.
        found: The hand, as far as it was fitted.
        true_intents: Whether the intents are the driver's.
    """
    chair = _chair_of(drives[0])
    gain = found["gain_y"].value if "gain_y" in found else 1.0
    bias = found["bias_y"].value if "bias_y" in found else 0.0
    rows = []
    for item in series:
        pushed = item.intents[:, 1]
        if not true_intents:
            width = min(len(item.stick), max(1, round(_SMOOTH_S / item.apart_s)))
            smooth = np.convolve(item.stick[:, 1], np.full(width, 1.0 / width), mode="valid")
            pushed = (smooth - bias) / max(gain, 0.05)
        rows.append(pushed[:, None])

    def share(parts: F64) -> float:
        pushed = float(np.quantile(parts[:, 0], _USUAL_SPEED))
        # A user that misses the size of corrections pushes for more and for less than it likes.
        if "correct_every_s" in found:
            likely = parts[parts[:, 0] > 0.5 * pushed, 0]
            pushed = float(np.median(likely)) if pushed > 0.0 else 0.0
        out = max(0.0, pushed - chair.deadband) / (1.0 - chair.deadband)
        return float(min(1.0, max(0.05, out**chair.shape_exponent)))

    return _resampled(rows, series, share)


def _resampled(
    rows: Sequence[F64], series: Sequence[HandTimeSeries], value: Callable[[F64], float]
) -> FittedParameter:
    """A number of the rows (n, k) of all episodes; its interval by drawing stretches anew."""
    rng = seeding.make_rng(0, "stretches resampled")
    parts: list[F64] = []
    for table, item in zip(rows, series, strict=True):
        seconds = len(item.intents) * item.tick_s
        parts += np.array_split(table, max(1, round(seconds / BLOCK_S)))
    drawn = []
    for _ in range(_RESAMPLED):
        chosen = rng.integers(len(parts), size=len(parts)).tolist()
        drawn.append(value(np.concatenate([parts[k] for k in chosen])))
    found, half = value(np.concatenate(list(rows))), _SD * float(np.std(drawn))
    return FittedParameter(value=found, low=max(0.0, found - half), high=found + half)


# --- switches ---


def _fit_switches(
    series: Sequence[HandTimeSeries], base: UserProfile
) -> dict[str, FittedParameter]:
    """Delay and hold that reproduce the most samples; the others of `base` play no part.

    Both are searched together, on a lattice that gets finer around the best: a wrong hold makes a
    wrong delay look right.
    """
    # 1. Search coarsely. The first switch of an episode gives the delay to a sample.
    first_s = _first_press_s(series)
    reactions_s = _REACTIONS_S if first_s is None else np.maximum(first_s + _BEFORE_S, 0.0)
    found = _best(series, base, reactions_s, _HOLDS_S, _FEW_TICKS)[:_STARTS]

    # 2. Refine the best ones. The delay stays within bounds.
    for number, (reaction_s, hold_s) in enumerate(found):
        for halving in range(_HALVINGS):
            steps = 0.5**halving * np.arange(-2.0, 2.5)
            late_s = reaction_s + 0.5 * _COARSE_REACTION_S * steps
            late_s = np.clip(late_s, reactions_s[0], reactions_s[-1])
            holds_s = np.maximum(hold_s + 0.5 * _COARSE_HOLD_S * steps, 0.01)
            reaction_s, hold_s = _best(series, base, late_s, holds_s, _MORE_TICKS)[0]
        found[number] = (reaction_s, hold_s)

    def wrong(reaction_s: float, hold_s: float) -> float:
        user = replace(base, reaction_s=reaction_s, hold_s=hold_s)
        return _wrong_share(series, user, _MORE_TICKS)

    # 3. Choose the best, and see how far around it the fit is nearly as good.
    reaction_s, hold_s = min(found, key=lambda pair: wrong(*pair))
    around_s = _FINE_S * np.arange(-8.0, 8.5)
    late = np.array([wrong(reaction_s + by_s, hold_s) for by_s in around_s])
    held = np.array([wrong(reaction_s, hold_s + by_s) for by_s in around_s])
    return {
        "reaction_s": _interval(reaction_s + around_s, late),
        "hold_s": _interval(hold_s + around_s, held),
    }


def _first_press_s(series: Sequence[HandTimeSeries]) -> float | None:
    """The shortest time from an episode's first intent to its first switch.

    None where no episode started at rest.
    """
    found = []
    for item in series:
        forward, sideways = item.intents[:, 1], np.abs(item.intents[:, 0])
        intends = np.asarray((forward > DRIVE_ABOVE) | (sideways > STEER_ABOVE), np.bool_)
        pressed = np.asarray((np.abs(item.stick) > SAME_STICK).any(axis=1), np.bool_)
        if intends.any() and pressed.any() and not pressed[0]:
            pressed_s = float(item.time_s[int(np.argmax(pressed))]) - item.start_s
            found.append(pressed_s - int(np.argmax(intends)) * item.tick_s)
    return min(found) if found else None


def _best(
    series: Sequence[HandTimeSeries], base: UserProfile, reactions_s: F64, holds_s: F64, ticks: int
) -> list[tuple[float, float]]:
    """The pairs of delay and hold of a lattice, those first that reproduce the most samples."""
    pairs = [(float(late_s), float(hold_s)) for late_s in reactions_s for hold_s in holds_s]
    wrong = [
        _wrong_share(series, replace(base, reaction_s=late_s, hold_s=hold_s), ticks)
        for late_s, hold_s in pairs
    ]
    return [pairs[k] for k in np.argsort(wrong, kind="stable").tolist()]


def _wrong_share(series: Sequence[HandTimeSeries], user: UserProfile, ticks: int) -> float:
    """The share of the samples of so many ticks that this user's switches do not reproduce."""
    wrong = total = 0
    for item in series:
        hand, moved = SwitchHandModel(user), []
        for x, y in item.intents[:ticks].tolist():
            hand.send_intent(Joystick(x, y))
            moved.append(hand.move(item.steps, item.tick_s / item.steps))
        sticks = np.concatenate(moved)
        at = item.at[item.at < len(sticks)]
        wrong += int((np.abs(sticks[at] - item.stick[: len(at)]).max(axis=1) > SAME_STICK).sum())
        total += len(at)
        ticks -= len(item.intents)
        if ticks <= 0:
            break
    return wrong / max(1, total)


def _interval(values: F64, wrong: F64) -> FittedParameter:
    """The middle of the best values, and the least and the most that fit nearly as well."""
    best = values[wrong <= wrong.min()]
    fits = values[wrong <= wrong.min() + _AS_GOOD]
    half_s = 0.5 * float(values[1] - values[0])
    low, high = max(0.0, float(fits.min()) - half_s), float(fits.max()) + half_s
    return FittedParameter(value=float(best.mean()), low=low, high=high)


# --- the result ---


def _profile_numbers(found: Mapping[str, FittedParameter], switched: bool) -> dict[str, Any]:
    """The numbers of a profile, within its bounds and rounded to what they show."""

    def bounded(key: str, name: str) -> float:
        low, high = PROFILE_LIMITS[key]
        return float(f"{min(high, max(low, found[name].value)):.4g}")

    plain = {name: bounded(name, name) for name in found if name.partition("_")[0] not in PAIRS}
    if switched:
        return {**plain, "noise": 0.0, "tremor": 0.0, "gain": (1.0, 1.0), "bias": (0.0, 0.0)}
    if not _has_hand(found):
        return plain
    pairs = {key: (bounded(key, f"{key}_x"), bounded(key, f"{key}_y")) for key in PAIRS}
    return {"correct_every_s": 0.0, **plain, **pairs}


def _warnings(
    found: Mapping[str, FittedParameter],
    seconds: float,
    series: Sequence[HandTimeSeries],
    true_intents: bool,
) -> tuple[str, ...]:
    lines = []
    if seconds < _SHORT_S:
        lines.append(
            f"only {seconds:.0f} s were driven: expected {_SHORT_S:.0f} s or more, "
            "and ten minutes for most numbers"
        )
    if not _has_hand(found):
        lines.append(
            "the stick was at the end of its travel for more than "
            f"{1.0 - _LEAST_COUNTED:.0%} of the time: delay, lag, gain, bias, noise and tremor "
            "are those of --base; drive with half of the stick too"
        )
    if seconds < _FEWEST_BLOCKS * BLOCK_S:
        lines.append(
            f"intervals come from only {seconds / BLOCK_S:.0f} stretches of {BLOCK_S:.0f} s: "
            "too few to trust"
        )
    if series[0].apart_s > _FAST_TREMOR_S:
        fastest_hz = 0.5 / series[0].apart_s
        lines.append(
            f"the stick was recorded every {series[0].apart_s:g} s: "
            f"a tremor above {fastest_hz:g} Hz looks slower"
        )
    for name, item in found.items():
        if not is_certain_estimate(name, item):
            more = _MORE.get(name, "drive longer")
            lines.append(
                f"{name} is uncertain by more than 15 %: {item.value:.3g}, "
                f"between {item.low:.3g} and {item.high:.3g}; {more}"
            )
    if not true_intents:
        lines.append(
            "intents come from the user model, which never looks away: "
            "time spent looking away counts as noise"
        )
    return tuple(lines)
