"""The hands of people whose sticks were recorded without a street: how slow, how still, how alike.

Such a table does not show when a person saw something, or what the intent was: reaction, gain and
bias stay those of the base. A stick moves from one place to the next: it is fast for a moment, then
slow or still until the next movement. Long movements show the lag of a hand, the pauses between
them its wander. There is a sample every 0.02 s.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.core.reading import escape
from wcsim.core.seeding import make_rng
from wcsim.errors import ConfigError
from wcsim.types import F64, Joystick
from wcsim.users.hand import STICK_FILTER_S, StickHandModel, SwitchHandModel
from wcsim.users.profiles import UserProfile, find_builtin_profile, list_profile_names
from wcsim.users.recordings.fit_user import FittedParameter, UserFitResult
from wcsim.users.recordings.hand_series import find_true_spans
from wcsim.users.recordings.recorded_user import read_stick_recording

STICK_DT_S: Final = 0.02
_BANDS_HZ: Final = (0.4, 1.0, 3.0, 8.0)
# Of the stick's travel.
_AT_REST: Final = 0.05
_HELD: Final = (0.1, 0.95)
_AT_GATE: Final = 0.98
_LEAST_MOVE: Final = 0.3  # shorter movements are too coarse to be timed
# Stick travel a second: a movement gets faster than the first, and goes on until the second.
_FAST: Final = 0.5
_SLOW: Final = 0.17
# Samples of a mean: a step of 0.01 alone then looks like 0.167 a second.
_SMOOTH: Final = 3
_BEND: Final = 5  # samples: a held stick is compared with its places so long before and after
_STEPS: Final = 4  # of a sample, in which a hand moves
_PIECE_S: Final = 20.0
_SHORTEST_S: Final = 30.0
# A stick with more movements a second is hardly ever held, and hides its hand.
_RESTLESS_PER_S: Final = 1.5


def read_recorded_sticks(path: Path) -> F64:
    """All sticks (n, 2) of a table, or of a folder, one after the other.

    A folder's .odom.csv files are left out.

    Raises:
        ConfigError: There is no table, or one that `read_stick_recording` refuses; or they last for
            less than 30 s.
    """
    files = [path]
    if path.is_dir():
        files = [each for each in sorted(path.glob("*.csv*")) if ".odom" not in each.suffixes]
    parts = [part for each in map(read_stick_recording, files) for part in each.episodes or (each,)]
    sticks = [part.at(np.arange(part.time_s[0], part.end_s, STICK_DT_S)) for part in parts]
    seconds = STICK_DT_S * sum(map(len, sticks))
    if seconds < _SHORTEST_S:
        raise ConfigError(
            f"{escape(path)}: {seconds:.0f} s in .csv or .csv.gz files; expected 30 s or more"
        )
    return np.concatenate(sticks)


def fit_user_to_sticks(people: Mapping[str, F64], base: UserProfile) -> UserFitResult:
    """The hand of some people, or of one, by their sticks (n, 2); and the habits of all.

    Habits are those of "people", "fitted" and the profiles. The numbers of several people are
    means, with the range of their mean; those of one are means over pieces of 20 s. The rest is
    that of `base`. The hands of users get the intents behind each of these sticks: what follows
    from the task, as how long a stick rests, is the same for all. Each of three people or more also
    has habits of their own, with the range in which the others let expect one more person's.
    """
    # 1. Measure the people.
    units = list(people.values())
    if len(units) == 1:
        units = np.array_split(units[0], round(len(units[0]) * STICK_DT_S / _PIECE_S))
    # The device's step is seen where sticks go straight on: a round gate shifts one aside.
    ahead = np.concatenate([unit[unit[:, 0] == 0.0, 1] for unit in units])
    step = float(np.median(np.diff(np.unique(np.r_[0.0, 1e-3, ahead]))))
    own = [measure_stick_habits(unit, base.noise_rate, step) for unit in units]
    rows = {"people": _means(own)}

    # 2. Fit the profile. A restless stick shows no hand.
    warnings = [
        f"the stick was told in steps of {step:.3g}, and nothing of what was wanted: "
        "reaction is that of --base"
    ]
    found = {name: item for name, item in rows["people"].items() if name in ("lag_s", "noise")}
    if rows["people"]["moves_per_s"].value > _RESTLESS_PER_S:
        warnings.append("the stick is hardly ever held: lag and noise are those of --base")
        found = {}
    numbers: dict[str, Any] = {name: round(item.value, 4) for name, item in found.items()}
    user = replace(base, spread=0.0, **numbers)

    # 3. Measure the same task with other hands: the fitted one and those of the profiles.
    intents = [_intents_of(unit) for unit in units]
    for each in (replace(user, name="fitted"), *map(find_builtin_profile, list_profile_names())):
        sticks = [
            simulate_hand_stick(each, part, step, number) for number, part in enumerate(intents)
        ]
        rows[each.name] = _means(
            [measure_stick_habits(stick, base.noise_rate, step) for stick in sticks]
        )

    # 4. Compare each person with the others.
    for name, habits in zip(people if len(people) > 2 else (), own, strict=False):
        others = _means([each for each in own if each is not habits], one_more=1.0)
        rows[f"person {name}"] = {
            key: replace(item, value=habits[key])
            for key, item in others.items()
            if habits[key] >= 0.0
        }
    seconds = STICK_DT_S * sum(map(len, units))
    return UserFitResult(
        profile=user, estimates=found, seconds=seconds, warnings=(*warnings,), habits=rows
    )


def measure_stick_habits(stick: F64, noise_rate: float, step: float) -> dict[str, float]:
    """What a stick (n, 2) does; nan for a lag or a wander that was not seen.

    All are of the whole time, but movements a second of that away from rest. The speed is that
    which 5 % exceed, in stick travel a second. Below 1, 3 and 8 Hz are root mean squares of both
    axes from 0.4, 1 and 3 Hz on.

    Args:
        stick: At least 256 samples.
        noise_rate: Of the wander, 1/s: a stick shows its size, and hardly how fast it forgets
            itself.
        step: Smallest difference of the device, whose rounding is taken off the wander.
    """
    from scipy.signal import find_peaks, welch

    radius, speed, spans = np.hypot(stick[:, 0], stick[:, 1]), _speed(stick), _movements(stick)
    rest = radius < _AT_REST
    # Equal peaks, which stand on one movement, would count twice.
    untied = speed - 1e-9 * np.arange(len(speed))
    moves = len(find_peaks(np.r_[0.0, untied, 0.0], height=_FAST, prominence=_FAST)[0])
    hz, density = welch(stick, 1.0 / STICK_DT_S, axis=0)
    power = hz[1] * density.sum(axis=1)
    habits = {
        "rest_share": float(rest.mean()),
        "gate_share": float((radius >= _AT_GATE).mean()),
        "moves_per_s": moves / (STICK_DT_S * max(1, int((~rest).sum()))),
        "speed_per_s": float(np.quantile(speed, 0.95)),
        "lag_s": _lag_s(stick, spans),
        "noise": _wander(stick, spans, noise_rate, step),
    }
    for low, high in pairwise(_BANDS_HZ):
        habits[f"below_{high:g}_hz"] = math.sqrt(power[(hz >= low) & (hz < high)].sum())
    return habits


def simulate_hand_stick(user: UserProfile, intents: F64, step: float, number: int) -> F64:
    """The stick (n, 2) of a user's hand for intents (n, 2), rounded to `step`.

    `number` is that of its noise. What a user sees, misses or corrects plays no part.
    """
    hand = (
        SwitchHandModel(user)
        if user.discrete
        else StickHandModel(user, make_rng(0, "stick", number))
    )
    found = np.empty_like(intents)
    for k, (x, y) in enumerate(intents.tolist()):
        hand.send_intent(Joystick(x, y))
        found[k] = hand.move(_STEPS, STICK_DT_S / _STEPS)[-1]
    return np.rint(found / step) * step


def _means(
    rows: Sequence[Mapping[str, float]], one_more: float = 0.0
) -> dict[str, FittedParameter]:
    """Means of what is known at least twice, with the range of 95 % by Student's t.

    The range is that of the mean, or, with `one_more` 1, that of one more value.
    """
    from scipy.special import stdtrit

    found = {}
    for name in rows[0]:
        known = np.array([row[name] for row in rows if math.isfinite(row[name])])
        n = len(known)
        if n > 1:
            mean = float(known.mean())
            half = float(stdtrit(n - 1, 0.975) * known.std(ddof=1)) * math.sqrt(1.0 / n + one_more)
            found[name] = FittedParameter(
                value=mean, low=max(0.0, mean - half), high=mean + half, n=n
            )
    return found


def _speed(stick: F64) -> F64:
    """(n,) in stick travel a second."""
    from scipy.ndimage import uniform_filter1d

    smooth = uniform_filter1d(stick, _SMOOTH, axis=0, mode="nearest")
    return np.asarray(np.hypot(*np.gradient(smooth, STICK_DT_S, axis=0).T), np.float64)


def _movements(stick: F64) -> list[tuple[int, int]]:
    """First sample and end of each movement."""
    speed = _speed(stick)
    spans = find_true_spans(speed > _SLOW)
    return [(start, stop) for start, stop in spans if speed[start:stop].max() > _FAST]


def _intents_of(stick: F64) -> F64:
    """The intents (n, 2) behind a stick (n, 2): in a movement its end, else where the stick is."""
    intents = stick.copy()
    for start, stop in _movements(stick):
        intents[start:stop] = stick[stop - 1]
    return intents


def _lag_s(stick: F64, spans: Sequence[tuple[int, int]]) -> float:
    """The lag by the usual time from 10 % to 90 % of a long movement, without the low-pass."""
    rises_s = []
    for start, stop in spans:
        way = stick[start:stop] - stick[start]
        length = float(np.hypot(*way[-1]))
        if length >= _LEAST_MOVE:
            done = np.maximum.accumulate(way @ way[-1] / length**2)
            rises_s.append(STICK_DT_S * np.ptp(np.interp((0.1, 0.9), done, np.arange(len(done)))))
    lag_s = float(np.median(rises_s)) / math.log(9.0) if rises_s else math.nan
    return math.sqrt(max(lag_s**2 - STICK_FILTER_S**2, 0.0))


def _wander(stick: F64, spans: Sequence[tuple[int, int]], rate: float, step: float) -> float:
    """Standard deviation of the wander of a held stick.

    It is measured by how far the stick lies off the line between before and after: a slow push
    along a line is meant and not counted. For a wander that has a share k of itself left in that
    time, the square of this bend is 2 (1 - k) (3 - k) times the variance; rounding to `step` adds
    half of its square.
    """
    radius = np.hypot(stick[:, 0], stick[:, 1])
    held = (radius > _HELD[0]) & (radius < _HELD[1])
    for start, stop in spans:
        held[start:stop] = False
    whole = np.convolve(held, np.ones(2 * _BEND + 1), "valid") > 2 * _BEND
    if not whole.any():
        return math.nan
    bends = (stick[2 * _BEND :] - 2.0 * stick[_BEND:-_BEND] + stick[: -2 * _BEND])[whole]
    left = math.exp(-rate * _BEND * STICK_DT_S)
    square = max(float((bends**2).mean()) - 0.5 * step**2, 0.0)
    return math.sqrt(square / (2.0 * (1.0 - left) * (3.0 - left)))
