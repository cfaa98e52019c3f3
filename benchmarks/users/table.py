"""The statistics of a profile over some routes, each beside the parameter that it should show."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.users.hand_fit import HandFit, fit_hand
from benchmarks.users.hand_habits import HandLog, Tremor, pauses, switch_holds, tremor
from wcsim.core.frames import deg2rad, wrap_angle
from wcsim.types import F64, ActorKind, UserView
from wcsim.users.hand import DRIVE_ABOVE, PULSE_S, STEER_ABOVE
from wcsim.users.perception import PERSON_SIGHT, PerceivedObjects
from wcsim.users.profiles import UserProfile
from wcsim.users.recordings.hand_series import find_mean_correction_interval_s

_SHAKES = 0.05  # a tremor below this is not averaged away before the fit
_SHORTEST_S = 15.0  # of a route whose hand is fitted
_SURELY_NEAR, _SURELY_AHEAD_RAD = 0.8, deg2rad(60.0)  # what is so near and so far ahead must have been looked at
_SAME_PLACE_M = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RouteLog:
    """One user on one route."""

    profile: UserProfile  # as drawn for this episode
    tick_s: float
    hand: HandLog
    speed_mps: F64  # (N,)
    v_max_mps: float
    met: int  # things and people that came near
    noticed: int  # of these


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistic:
    """What was seen, and what the profile says."""

    measured: float
    parameter: float
    unit: str
    routes: int  # that it was seen in
    at_most: bool = False  # the parameter is a bound, not what is expected


def statistics(logs: Sequence[RouteLog]) -> dict[str, Statistic]:
    """The statistics that apply to a profile, by the name of its parameter; what was never seen is left out.

    Args:
        logs: Routes of users of one profile.
    """
    rows = _of_switches(logs) if logs and logs[0].profile.discrete else _of_hands(logs)
    return rows | _of_noticing(logs) | _of_looks_away(logs)


def meet(view: UserView, seen: PerceivedObjects, profile: UserProfile, met: dict[str, bool]) -> None:
    """Add to `met` what has come near enough that the user must have noticed or missed it, and which it was."""
    aware = np.array([(thing.x_m, thing.y_m) for thing in seen.things]).reshape(-1, 2)
    here = view.p_W_m[:2]
    near = [(f"thing {int(n)}", x, y, profile.see_m, _SAME_PLACE_M) for x, y, _, n in view.obstacles_W_m.tolist()]
    for actor in view.actors:
        if actor.kind is ActorKind.PEDESTRIAN:
            x, y, _ = actor.p_W_m.tolist()
            near.append((actor.id, x, y, PERSON_SIGHT * profile.see_m, 0.5 * max(actor.size_lwh_m[:2])))
    for name, x, y, sight_m, size_m in near:
        away_m = math.hypot(x - here[0], y - here[1])
        aside = abs(wrap_angle(math.atan2(y - here[1], x - here[0]) - view.yaw_rad))
        if name not in met and away_m < _SURELY_NEAR * sight_m and aside < _SURELY_AHEAD_RAD:
            met[name] = bool((np.hypot(*(aware - (x, y)).T) < size_m).any())


def _of_hands(logs: Sequence[RouteLog]) -> dict[str, Statistic]:
    """What fits of the hand, spectra and corrections say."""
    long = [log for log in logs if len(log.speed_mps) * log.tick_s >= _SHORTEST_S]
    if not long:
        return {}
    users, shakes = [log.profile for log in long], [tremor(log.hand) for log in long]
    fits = [fit_hand(log.hand, _averaged_s(log.profile, shake)) for log, shake in zip(long, shakes, strict=True)]
    rows = _of_responses(fits, users)
    rows |= _of_tremors(shakes, users) if users[0].tremor > 0.0 else _of_wander(fits, users)
    if users[0].correct_every_s > 0.0:
        found = (
            (find_mean_correction_interval_s(log.hand.intents, log.tick_s), log.profile.correct_every_s) for log in long
        )
        _add(rows, "correct_every_s", "s", found)
    if users[0].gain == (1.0, 1.0):
        _add(rows, "speed_share", "", ((_usual_speed_share(log), log.profile.speed_share) for log in long))
    return rows


def _averaged_s(user: UserProfile, shake: Tremor) -> float:
    """Over which time a hand is averaged before the fit: one period of a tremor that is strong enough to matter."""
    return 1.0 / shake.hz if shake.amplitude > _SHAKES and user.tremor > 0.0 else 0.0


def _of_responses(fits: Sequence[HandFit], users: Sequence[UserProfile]) -> dict[str, Statistic]:
    """How late, how slowly, how far and how much beside the mark hands follow a wish."""
    rows: dict[str, Statistic] = {}
    both = list(zip(fits, users, strict=True))
    _add(rows, "reaction_s", "s", ((fit.delay_s, user.reaction_s) for fit, user in both))
    _add(rows, "lag_s", "s", ((fit.lag_s, user.lag_s) for fit, user in both))
    # A route on which the wish hardly moves says little of gain and bias: each counts for what it is certain of.
    certain = [[max(fit.gain_sd[axis], 1e-6) ** -2 for fit in fits] for axis in range(2)]
    for axis, name in enumerate("xy"):
        gains = ((fit.gain[axis], user.gain[axis]) for fit, user in both)
        _add(rows, f"gain_{name}", "", gains, certain[axis])
    for axis, name in enumerate("xy"):
        _add(rows, f"bias_{name}", "", ((fit.bias[axis], user.bias[axis]) for fit, user in both), certain[axis])
    return rows


def _of_tremors(shakes: Sequence[Tremor], users: Sequence[UserProfile]) -> dict[str, Statistic]:
    rows: dict[str, Statistic] = {}
    both = list(zip(shakes, users, strict=True))
    _add(rows, "tremor_hz", "Hz", ((shake.hz, user.tremor_hz) for shake, user in both))
    _add(rows, "tremor", "stick", ((shake.amplitude, user.tremor) for shake, user in both))
    return rows


def _of_wander(fits: Sequence[HandFit], users: Sequence[UserProfile]) -> dict[str, Statistic]:
    rows: dict[str, Statistic] = {}
    both = list(zip(fits, users, strict=True))
    _add(rows, "noise", "stick", ((fit.wander, user.noise) for fit, user in both))
    _add(rows, "noise_rate", "1/s", ((fit.wander_rate, user.noise_rate) for fit, user in both))
    return rows


def _usual_speed_share(log: RouteLog) -> float:
    return float(np.quantile(log.speed_mps, 0.9)) / log.v_max_mps


def _of_switches(logs: Sequence[RouteLog]) -> dict[str, Statistic]:
    """How fast and how often four switches are pressed."""
    rows: dict[str, Statistic] = {}
    _add(rows, "reaction_s", "s", ((_first_press_s(log.hand), log.profile.reaction_s) for log in logs))
    holds = [(log.profile, switch_holds(log.hand.flat, log.hand.dt_s)) for log in logs]
    steered = ((user, between_s) for user, (_, between_s) in holds if len(between_s))
    _add(rows, "hold_s", "s", ((float(between_s.min()), user.hold_s) for user, between_s in steered))
    rates = [len(np.flatnonzero((np.diff(log.hand.flat, axis=0) != 0.0).any(axis=1))) for log in logs]
    seconds = [len(log.speed_mps) * log.tick_s for log in logs]
    if sum(seconds) > 0.0:
        most = float(np.mean([2.0 / (log.profile.hold_s + PULSE_S[0]) for log in logs]))
        rows["switches_per_s"] = Statistic(
            measured=sum(rates) / sum(seconds), parameter=most, unit="1/s", routes=len(logs), at_most=True
        )
    pulses = np.concatenate([turns_s for _, (turns_s, _) in holds]) if holds else np.zeros(0)
    if len(pulses):
        rows["longest_pulse_s"] = Statistic(
            measured=float(pulses.max()), parameter=PULSE_S[1], unit="s", routes=len(logs), at_most=True
        )
    return rows


def _of_noticing(logs: Sequence[RouteLog]) -> dict[str, Statistic]:
    """What was noticed of what came near, counted over all routes together."""
    met = sum(log.met for log in logs)
    if not met:
        return {}
    share = sum(log.noticed for log in logs) / met
    expected = sum(log.met * log.profile.see_share for log in logs) / met
    used = sum(log.met > 0 for log in logs)
    return {"see_share": Statistic(measured=share, parameter=expected, unit="", routes=used)}


def _of_looks_away(logs: Sequence[RouteLog]) -> dict[str, Statistic]:
    """Looks elsewhere: their share of the time driven forward, and how long one takes, over all routes together."""
    rows: dict[str, Statistic] = {}
    if not logs or logs[0].profile.away_share <= 0.0:
        return rows
    found = [pauses(log.hand.intents) for log in logs]
    driven, ended = [pause.driven for pause in found], [pause.ended for pause in found]
    still = sum(pause.still for pause in found)
    if sum(driven):
        expected = float(np.average([log.profile.away_share for log in logs], weights=driven))
        used = sum(ticks > 0 for ticks in driven)
        rows["away_share"] = Statistic(measured=still / sum(driven), parameter=expected, unit="", routes=used)
    if sum(ended):
        # All their time over how many ended: one that the route's end cut off counts for what was seen.
        expected = float(np.average([log.profile.away_s for log in logs], weights=ended))
        used = sum(count > 0 for count in ended)
        seconds = logs[0].tick_s * still / sum(ended)
        rows["away_s"] = Statistic(measured=seconds, parameter=expected, unit="s", routes=used)
    return rows


def _add(
    rows: dict[str, Statistic],
    name: str,
    unit: str,
    measured_and_said: Iterable[tuple[float | None, float]],
    weights: Sequence[float] | None = None,
) -> None:
    """Add the means over the routes in which there was something to measure; nothing where there was no such route."""
    known = [
        (got, said, 1.0 if weights is None else weights[number])
        for number, (got, said) in enumerate(measured_and_said)
        if got is not None
    ]
    if known:
        got, said, weight = (np.array(values) for values in zip(*known, strict=True))
        measured, parameter = (float(np.average(values, weights=weight)) for values in (got, said))
        rows[name] = Statistic(measured=measured, parameter=parameter, unit=unit, routes=len(known))


def _first_press_s(hand: HandLog) -> float | None:
    """From the first wish for anything to the first switch that is pressed."""
    wants = (hand.intents[:, 1] > DRIVE_ABOVE) | (np.abs(hand.intents[:, 0]) > STEER_ABOVE)
    pressed = (hand.flat != 0.0).any(axis=1)
    if not wants.any() or not pressed.any():
        return None
    return hand.dt_s * float(int(np.argmax(pressed)) + 1 - int(np.argmax(wants)) * hand.sticks.shape[1])
