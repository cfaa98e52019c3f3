"""Four switches in the place of a stick: whether a drive was driven with them, and how late and how long they are held.

Switches add no chance of their own, so the right delay and the right hold make every sample again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from wcsim.types import F64, Joystick
from wcsim.users.fitting.hand_series import HandSeries
from wcsim.users.hand import SWITCH_POSITIONS, SwitchHand
from wcsim.users.profiles import UserProfile

_SAME = 1e-4  # of the stick's travel
_LONGEST_TICKS = 1500  # of a drive are looked at: more of them say the same again
_REACTIONS_S, _HOLDS_S = np.arange(0.2, 1.3, 0.05), np.arange(0.1, 0.75, 0.05)
_FINE_S = 0.01
_AS_GOOD = 0.002  # share of the samples by which one value may be worse than the best and still be possible


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchLaw:
    """What of switches was found, each with the least and the most that fit as well."""

    reaction_s: tuple[float, float, float]
    hold_s: tuple[float, float, float]
    wrong_share: float  # of the samples that are not made again


def by_switches(series: Sequence[HandSeries]) -> bool:
    """Whether every sample is a position that four switches stand for."""
    positions = np.array(SWITCH_POSITIONS)
    sticks = np.concatenate([item.stick for item in series])
    away = np.abs(sticks[:, None, :] - positions[None]).max(axis=2).min(axis=1)
    return bool((away < _SAME).all())


def fit_switches(series: Sequence[HandSeries], base: UserProfile) -> SwitchLaw:
    """Delay and hold that make the most samples again; the others of `base` play no part."""
    user = replace(base, reaction_s=0.5, hold_s=0.3)
    for grid_s in (None, _FINE_S):
        for name, coarse in (("reaction_s", _REACTIONS_S), ("hold_s", _HOLDS_S)):
            now = user.reaction_s if name == "reaction_s" else user.hold_s
            values = coarse if grid_s is None else np.arange(max(grid_s, now - 0.05), now + 0.055, grid_s)
            wrong = np.array([_wrong(series, _with(user, name, float(value))) for value in values])
            user = _with(user, name, _middle(values, wrong)[0])
            if name == "reaction_s":
                reaction = _middle(values, wrong)
            else:
                hold = _middle(values, wrong)
    return SwitchLaw(reaction_s=reaction, hold_s=hold, wrong_share=_wrong(series, user))


def _with(user: UserProfile, name: str, value: float) -> UserProfile:
    return replace(user, reaction_s=value) if name == "reaction_s" else replace(user, hold_s=value)


def _middle(values: F64, wrong: F64) -> tuple[float, float, float]:
    """The middle of the values that fit best, and the least and the most that fit nearly as well."""
    best = values[wrong <= wrong.min()]
    fits = values[wrong <= wrong.min() + _AS_GOOD]
    half_s = 0.5 * float(values[1] - values[0])
    return float(best.mean()), max(0.0, float(fits.min()) - half_s), float(fits.max()) + half_s


def _wrong(series: Sequence[HandSeries], user: UserProfile) -> float:
    """The share of the samples that switches of this user would not have given."""
    wrong = total = 0
    for item in series:
        hand, made = SwitchHand(user), []
        for x, y in item.intents[:_LONGEST_TICKS].tolist():
            hand.want(Joystick(x, y))
            made.append(hand.move(item.steps, item.tick_s / item.steps))
        sticks = np.concatenate(made)
        at = item.at[item.at < len(sticks)]
        wrong += int((np.abs(sticks[at] - item.stick[: len(at)]).max(axis=1) > _SAME).sum())
        total += len(at)
    return wrong / max(1, total)
