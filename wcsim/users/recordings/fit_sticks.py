"""The hands of people whose sticks were recorded without a street: how slow and how still, and who is like them.

Nothing tells when such a person saw something, or what was wanted: reaction, gain and bias stay those of the base. A
stick moves from one place to the next: it is fast for a moment, then slow or still until the next movement. The lag of
a hand is told by long movements, its wander by the pauses between them. A sample every 0.02 s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from wcsim.core.reading import escaped
from wcsim.core.seeding import generator
from wcsim.errors import ConfigError
from wcsim.types import F64, Joystick
from wcsim.users.hand import STICK_FILTER_S, Hand, SwitchHand
from wcsim.users.profiles import UserProfile, profile, profile_names
from wcsim.users.recordings.fit_user import FittedNumber, UserFit
from wcsim.users.recordings.hand_series import stretches
from wcsim.users.recordings.recorded_user import read_recording

STICK_DT_S = 0.02
_BANDS_HZ = (0.4, 1.0, 3.0, 8.0)
_AT_REST, _HELD, _AT_GATE = 0.05, (0.1, 0.95), 0.98  # of the stick's travel
_FAST, _SLOW = (
    0.5,
    0.17,
)  # stick travel a second: a movement gets faster, and goes on until it is slow ...
_SMOOTH = 3  # ... over so many samples: a step of 0.01 alone then looks like 0.167 a second
_LEAST_MOVE = 0.3  # of the stick's travel: shorter movements are too coarse to be timed
_BEND = 5  # samples: a held stick is compared with its places so long before and after
_STEPS = 4  # of a sample, in which a hand moves
_PIECE_S, _SHORTEST_S = 20.0, 30.0
_RESTLESS_PER_S = (
    1.5  # movements: a stick that moves more often is hardly ever held, and hides its hand
)


def read_sticks(path: Path) -> F64:
    """All sticks (n, 2) of a table, or of a folder without its .odom.csv files, one after the other.

    Raises:
        ConfigError: There is no table, or one that `read_recording` refuses; or they last for less than 30 s.
    """
    files = (
        [each for each in sorted(path.glob("*.csv*")) if ".odom" not in each.suffixes]
        if path.is_dir()
        else [path]
    )
    parts = [part for each in map(read_recording, files) for part in each.episodes or (each,)]
    sticks = [part.at(np.arange(part.time_s[0], part.end_s, STICK_DT_S)) for part in parts]
    seconds = STICK_DT_S * sum(map(len, sticks))
    if seconds < _SHORTEST_S:
        raise ConfigError(
            f"{escaped(path)}: {seconds:.0f} s in .csv or .csv.gz files; expected 30 s or more"
        )
    return np.concatenate(sticks)


def stick_habits(stick: F64, noise_rate: float, step: float) -> dict[str, float]:
    """What a stick (n, 2) does; nan for a lag or a wander that was not seen.

    All are of the whole time, but movements a second of that away from rest. The speed is that which 5 % exceed, in
    stick travel a second. Below 1, 3 and 8 Hz are root mean squares of both axes from 0.4, 1 and 3 Hz on.

    Args:
        stick: At least 256 samples.
        noise_rate: Of the wander, 1/s: a stick tells its size, and hardly how fast it forgets itself.
        step: Smallest difference of the device, whose rounding is taken off the wander.
    """
    from scipy.signal import find_peaks, welch

    radius, speed, spans = np.hypot(stick[:, 0], stick[:, 1]), _speed(stick), _movements(stick)
    rest = radius < _AT_REST
    untied = speed - 1e-9 * np.arange(
        len(speed)
    )  # equal peaks, which stand on one movement, would count twice
    moves = len(find_peaks(np.r_[0.0, untied, 0.0], height=_FAST, prominence=_FAST)[0])
    hz, density = welch(stick, 1.0 / STICK_DT_S, axis=0)
    power = hz[1] * density.sum(axis=1)
    return {
        "rest_share": float(rest.mean()),
        "gate_share": float((radius >= _AT_GATE).mean()),
        "moves_per_s": moves / (STICK_DT_S * max(1, int((~rest).sum()))),
        "speed_per_s": float(np.quantile(speed, 0.95)),
        "lag_s": _lag_s(stick, spans),
        "noise": _wander(stick, spans, noise_rate, step),
    } | {
        f"below_{high:g}_hz": math.sqrt(power[(hz >= low) & (hz < high)].sum())
        for low, high in pairwise(_BANDS_HZ)
    }


def driven_stick(user: UserProfile, wishes: F64, step: float, number: int) -> F64:
    """The stick (n, 2) of a user's hand that is given wishes (n, 2), rounded to `step`; `number` is that of its noise.

    What a user sees, misses or corrects plays no part.
    """
    hand = SwitchHand(user) if user.discrete else Hand(user, generator(0, "stick", number))
    found = np.empty_like(wishes)
    for k, (x, y) in enumerate(wishes.tolist()):
        hand.want(Joystick(x, y))
        found[k] = hand.move(_STEPS, STICK_DT_S / _STEPS)[-1]
    return np.rint(found / step) * step


def fit_sticks(people: Mapping[str, F64], base: UserProfile) -> UserFit:
    """The hand of some people, or of one, by their sticks (n, 2); and habits of "people", "fitted" and the profiles.

    The numbers of several people are means, with the range of their mean; those of one are means over pieces of 20 s.
    What sticks do not tell is that of `base`. The hands of users are given the wishes behind each of these sticks: what
    follows from the task, as how long a stick rests, is the same for all. Each of three people or more also has habits
    of their own there, with the range in which those of the others let expect one more person's.
    """
    units = list(people.values())
    if len(units) == 1:
        units = np.array_split(units[0], round(len(units[0]) * STICK_DT_S / _PIECE_S))
    step = _step(units)
    own = [stick_habits(unit, base.noise_rate, step) for unit in units]
    rows = {"people": _means(own)}
    told = [
        f"the stick was told in steps of {step:.3g}, and nothing of what was wanted: reaction is that of --base"
    ]
    found = {name: item for name, item in rows["people"].items() if name in ("lag_s", "noise")}
    if rows["people"]["moves_per_s"].value > _RESTLESS_PER_S:
        told.append("the stick is hardly ever held: lag and noise are those of --base")
        found = {}
    numbers: dict[str, Any] = {name: round(item.value, 4) for name, item in found.items()}
    user = replace(base, spread=0.0, **numbers)
    for each in (replace(user, name="fitted"), *map(profile, profile_names())):
        sticks = [
            driven_stick(each, _wishes_of(unit), step, number) for number, unit in enumerate(units)
        ]
        rows[each.name] = _means([stick_habits(stick, base.noise_rate, step) for stick in sticks])
    for name, habits in zip(people if len(people) > 2 else (), own, strict=False):
        others = _means([each for each in own if each is not habits], one_more=1.0)
        rows[f"person {name}"] = {
            key: replace(item, value=habits[key])
            for key, item in others.items()
            if habits[key] >= 0.0
        }
    seconds = STICK_DT_S * sum(map(len, units))
    return UserFit(profile=user, estimates=found, seconds=seconds, warnings=(*told,), habits=rows)


def _step(sticks: Sequence[F64]) -> float:
    """The smallest difference of a stick that goes straight on: farther aside a round gate shifts it."""
    ahead = np.concatenate([stick[stick[:, 0] == 0.0, 1] for stick in sticks])
    return float(np.median(np.diff(np.unique(np.r_[0.0, 1e-3, ahead]))))


def _means(rows: Sequence[Mapping[str, float]], one_more: float = 0.0) -> dict[str, FittedNumber]:
    """Means of what is known at least twice, with the range of 95 % by Student's t: for the mean, or for one more."""
    from scipy.special import stdtrit

    found = {}
    for name in rows[0]:
        known = np.array([row[name] for row in rows if math.isfinite(row[name])])
        if (n := len(known)) > 1:
            mean = float(known.mean())
            half = float(stdtrit(n - 1, 0.975) * known.std(ddof=1)) * math.sqrt(1.0 / n + one_more)
            found[name] = FittedNumber(value=mean, low=max(0.0, mean - half), high=mean + half, n=n)
    return found


def _speed(stick: F64) -> F64:
    """(n,) in stick travel a second."""
    from scipy.ndimage import uniform_filter1d

    smooth = uniform_filter1d(stick, _SMOOTH, axis=0, mode="nearest")
    return np.asarray(np.hypot(*np.gradient(smooth, STICK_DT_S, axis=0).T), np.float64)


def _movements(stick: F64) -> list[tuple[int, int]]:
    """First sample and end of each movement."""
    speed = _speed(stick)
    return [
        (begin, end) for begin, end in stretches(speed > _SLOW) if speed[begin:end].max() > _FAST
    ]


def _wishes_of(stick: F64) -> F64:
    """The wishes (n, 2) behind a stick (n, 2): during a movement the place where it ends, else where the stick is."""
    wishes = stick.copy()
    for begin, end in _movements(stick):
        wishes[begin:end] = stick[end - 1]
    return wishes


def _lag_s(stick: F64, spans: Sequence[tuple[int, int]]) -> float:
    """The lag that the usual time from 10 % to 90 % of a long movement shows, without that of the electronics."""
    rises_s = []
    for begin, end in spans:
        way = stick[begin:end] - stick[begin]
        length = float(np.hypot(*way[-1]))
        if length >= _LEAST_MOVE:
            done = np.maximum.accumulate(way @ way[-1] / length**2)
            rises_s.append(STICK_DT_S * np.ptp(np.interp((0.1, 0.9), done, np.arange(len(done)))))
    lag_s = float(np.median(rises_s)) / math.log(9.0) if rises_s else math.nan
    return math.sqrt(max(lag_s**2 - STICK_FILTER_S**2, 0.0))


def _wander(stick: F64, spans: Sequence[tuple[int, int]], rate: float, step: float) -> float:
    """Standard deviation of the wander of a held stick, by how far it lies off the line between before and after.

    A slow push along a line is meant and not counted. For a wander that keeps a share k of itself in that time, the
    square of this bend is 2 (1 - k) (3 - k) times the variance; rounding to `step` adds half of its square.
    """
    radius = np.hypot(stick[:, 0], stick[:, 1])
    held = (radius > _HELD[0]) & (radius < _HELD[1])
    for begin, end in spans:
        held[begin:end] = False
    whole = np.convolve(held, np.ones(2 * _BEND + 1), "valid") > 2 * _BEND
    if not whole.any():
        return math.nan
    bends = (stick[2 * _BEND :] - 2.0 * stick[_BEND:-_BEND] + stick[: -2 * _BEND])[whole]
    keep = math.exp(-rate * _BEND * STICK_DT_S)
    return math.sqrt(
        max(float((bends**2).mean()) - 0.5 * step**2, 0.0) / (2.0 * (1.0 - keep) * (3.0 - keep))
    )
