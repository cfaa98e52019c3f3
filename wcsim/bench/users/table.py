"""The statistics of a profile over some routes, each beside the parameter that it should show."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wcsim.bench.users.estimates import HandFit, HandLog, correction_s, fit_hand, pauses, switch_holds, tremor
from wcsim.core.frames import rad, wrap
from wcsim.types import F64, ActorKind, UserView
from wcsim.users.hand import DRIVE_ABOVE, PULSE_S, STEER_ABOVE
from wcsim.users.perception import PERSON_SIGHT, Seen
from wcsim.users.profiles import UserProfile

SHAKES = 0.05  # a tremor below this is not averaged away before the fit
SHORTEST_S = 15.0  # of a route whose hand is fitted
SURELY_NEAR, SURELY_AHEAD_RAD = 0.8, rad(60.0)  # what is so near and so far ahead must have been looked at
SAME_PLACE_M = 1e-6


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
    rows.update(_of_eyes(logs))
    return rows


def meet(view: UserView, seen: Seen, profile: UserProfile, met: dict[str, bool]) -> None:
    """Add to `met` what has come near enough that the user must have noticed or missed it, and which it was."""
    aware = np.array([(thing.x_m, thing.y_m) for thing in seen.things]).reshape(-1, 2)
    here = view.p_W_m[:2]
    near = [(f"thing {int(n)}", x, y, profile.see_m, SAME_PLACE_M) for x, y, _, n in view.obstacles_W_m.tolist()]
    for actor in view.actors:
        if actor.kind is ActorKind.PEDESTRIAN:
            x, y, _ = actor.p_W_m.tolist()
            near.append((actor.id, x, y, PERSON_SIGHT * profile.see_m, 0.5 * max(actor.size_lwh_m[:2])))
    for name, x, y, sight_m, size_m in near:
        away_m = math.hypot(x - here[0], y - here[1])
        aside = abs(wrap(math.atan2(y - here[1], x - here[0]) - view.yaw_rad))
        if name not in met and away_m < SURELY_NEAR * sight_m and aside < SURELY_AHEAD_RAD:
            met[name] = bool((np.hypot(*(aware - (x, y)).T) < size_m).any())


def _of_hands(logs: Sequence[RouteLog]) -> dict[str, Statistic]:
    """What fits of the hand, spectra and corrections say."""
    long = [log for log in logs if len(log.speed_mps) * log.tick_s >= SHORTEST_S]
    shakes = [tremor(log.hand) for log in long]
    fits = [
        fit_hand(log.hand, 1.0 / shake.hz if shake.amplitude > SHAKES and log.profile.tremor > 0.0 else 0.0)
        for log, shake in zip(long, shakes, strict=True)
    ]
    users = [log.profile for log in long]
    rows: dict[str, Statistic] = {}

    def add(name: str, unit: str, got: Callable[[HandFit], float], parameter: Callable[[UserProfile], float]) -> None:
        _add(rows, name, unit, [got(fit) for fit in fits], [parameter(user) for user in users])

    add("reaction_s", "s", lambda fit: fit.delay_s, lambda user: user.reaction_s)
    add("lag_s", "s", lambda fit: fit.lag_s, lambda user: user.lag_s)
    add("gain_x", "", lambda fit: fit.gain[0], lambda user: user.gain[0])
    add("gain_y", "", lambda fit: fit.gain[1], lambda user: user.gain[1])
    add("bias_x", "", lambda fit: fit.bias[0], lambda user: user.bias[0])
    add("bias_y", "", lambda fit: fit.bias[1], lambda user: user.bias[1])
    if users and users[0].tremor > 0.0:
        _add(rows, "tremor_hz", "Hz", [shake.hz for shake in shakes], [user.tremor_hz for user in users])
        _add(rows, "tremor", "stick", [shake.amplitude for shake in shakes], [user.tremor for user in users])
    else:
        add("noise", "stick", lambda fit: fit.wander, lambda user: user.noise)
        add("noise_rate", "1/s", lambda fit: fit.wander_rate, lambda user: user.noise_rate)
    if users and users[0].correct_every_s > 0.0:
        found = [(correction_s(log.hand.intents, log.tick_s), log.profile.correct_every_s) for log in long]
        known = [(got, parameter) for got, parameter in found if got is not None]
        _add(rows, "correct_every_s", "s", [got for got, _ in known], [parameter for _, parameter in known])
    if users and users[0].gain == (1.0, 1.0):
        speeds = [float(np.quantile(log.speed_mps, 0.9)) / log.v_max_mps for log in long]
        _add(rows, "speed_share", "", speeds, [user.speed_share for user in users])
    return rows


def _of_switches(logs: Sequence[RouteLog]) -> dict[str, Statistic]:
    """How fast and how often four switches are pressed."""
    rows: dict[str, Statistic] = {}
    delays = [(delay_s, log.profile.reaction_s) for log in logs if (delay_s := _first_press_s(log.hand)) is not None]
    _add(rows, "reaction_s", "s", [got for got, _ in delays], [parameter for _, parameter in delays])
    holds = [(log.profile, switch_holds(log.hand.flat, log.hand.dt_s)) for log in logs]
    steered = [(user, turns_s, between_s) for user, (turns_s, between_s) in holds if len(between_s)]
    least = [float(between_s.min()) for _, _, between_s in steered]
    _add(rows, "hold_s", "s", least, [user.hold_s for user, _, _ in steered])
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


def _of_eyes(logs: Sequence[RouteLog]) -> dict[str, Statistic]:
    """What was noticed, and looks elsewhere; counted over all routes together."""
    rows: dict[str, Statistic] = {}
    met = sum(log.met for log in logs)
    if met:
        share = sum(log.noticed for log in logs) / met
        expected = sum(log.met * log.profile.see_share for log in logs) / met
        used = sum(log.met > 0 for log in logs)
        rows["see_share"] = Statistic(measured=share, parameter=expected, unit="", routes=used)
    if logs and logs[0].profile.away_share > 0.0:
        found = [pauses(log.hand.intents, log.tick_s) for log in logs]
        weights = [len(log.speed_mps) for log in logs]
        measured = float(np.average([pause.share for pause in found], weights=weights))
        expected = float(np.average([log.profile.away_share for log in logs], weights=weights))
        rows["away_share"] = Statistic(measured=measured, parameter=expected, unit="", routes=len(logs))
        lengths = [(pause.mean_s, log.profile.away_s) for pause, log in zip(found, logs, strict=True)]
        known = [(got, parameter) for got, parameter in lengths if got is not None]
        _add(rows, "away_s", "s", [got for got, _ in known], [parameter for _, parameter in known])
    return rows


def _add(rows: dict[str, Statistic], name: str, unit: str, got: list[float], parameters: list[float]) -> None:
    if got:
        measured, parameter = float(np.mean(got)), float(np.mean(parameters))
        rows[name] = Statistic(measured=measured, parameter=parameter, unit=unit, routes=len(got))


def _first_press_s(hand: HandLog) -> float | None:
    """From the first wish for anything to the first switch that is pressed."""
    wants = (hand.intents[:, 1] > DRIVE_ABOVE) | (np.abs(hand.intents[:, 0]) > STEER_ABOVE)
    pressed = (hand.flat != 0.0).any(axis=1)
    if not wants.any() or not pressed.any():
        return None
    return hand.dt_s * float(int(np.argmax(pressed)) + 1 - int(np.argmax(wants)) * hand.sticks.shape[1])
