"""Four switches in the place of a stick: whether a drive was driven with them, and how late and how long they are held.

Switches add no chance of their own, so the right delay and the right hold make every sample again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from wcsim.types import F64, Joystick
from wcsim.users.fitting.hand_series import HandSeries
from wcsim.users.fitting.stick_positions import at_switches
from wcsim.users.hand import DRIVE_ABOVE, STEER_ABOVE, SwitchHand
from wcsim.users.profiles import UserProfile

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


def fit_switches(series: Sequence[HandSeries], base: UserProfile) -> SwitchLaw:
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
