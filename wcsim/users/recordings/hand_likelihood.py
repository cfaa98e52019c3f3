"""The likelihood of a hand: how probable its samples are, one after the other, for a delay, a lag, gains and noise.

Each sample is judged by those before it and by what was wanted until then. So the fit stays right in the loop, where an
intent answers to the noise of before.

Least of a sum over stretches of time, found by their slopes, and how certain it is by how much they disagree.

What the likelihood of a hand is made of: the wish on its way to the stick, and how new each sample of it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wcsim.core.jit import exact_kernel
from wcsim.types import F64, Bool
from wcsim.users.hand import TREMOR_WANDER, TREMOR_WANDER_S
from wcsim.users.recordings.hand_series import MOVES, HandSeries

# the noise of a hand (6,)
STEP_S, NOISE, RATE, TREMOR, TURN_RAD, FADING = range(6)
# a hand's line (4,)
GAIN_X, GAIN_Y, BIAS_X, BIAS_Y = range(4)
_SEEN = 1e-6  # variance of what a sample adds of its own
_FORWARD = 0.5  # the tremor forward, as a share of that to the side


@exact_kernel
def _wish_on_its_way(
    intents: F64, steps: int, dt_s: float, delay_s: float, lag_s: float, filter_s: float
) -> F64:
    """The hand (N * steps, 2) without noise: intents (N, 2), one a tick, after delay, lag and the joystick's low-pass.

    A wish counts in part around the step in which it arrives, so that the result changes smoothly with the delay.
    """
    ticks = len(intents)
    out = np.zeros((ticks * steps, 2))
    share = 1.0 - math.exp(-dt_s / max(lag_s, 1e-9))
    filtered = 1.0 if filter_s <= 0.0 else 1.0 - math.exp(-dt_s / filter_s)
    state, stick = np.zeros(2), np.zeros(2)
    for k in range(ticks * steps):
        at = ((k + 1.5) * dt_s - delay_s) / (
            steps * dt_s
        )  # a hand heeds what comes within a step in all of it
        index = math.floor(at)
        part = min(1.0, (at - index) * steps)
        for axis in range(2):
            now = intents[min(index, ticks - 1), axis] if index >= 0 else 0.0
            before = intents[min(index - 1, ticks - 1), axis] if index >= 1 else 0.0
            wish = part * now + (1.0 - part) * before
            state[axis] += share * (wish - state[axis])
            stick[axis] += filtered * (state[axis] - stick[axis])
            out[k, axis] = stick[axis]
    return out


@exact_kernel
def _surprises(
    hand: F64, wish: F64, free: Bool, noise: F64, line: F64, counted: Bool, clear: Bool
) -> F64:
    """How unlikely each sample (n,) of a hand is after those before it: minus the logarithm of its density.

    The noise is an Ornstein-Uhlenbeck process on each axis, and a tremor whose phase wanders; both are followed by a
    Kalman filter. A sample at the gate is not known: it changes nothing, and the first one after it counts for nothing.

    Args:
        hand: (n, 2) the samples.
        wish: (n, 2) what `_wish_on_its_way` makes of the intents.
        free: (n,) which samples the gate did not stop.
        noise: (6,) seconds between samples, standard deviation and rate of the wander, amplitude and turn of the tremor
            from sample to sample, and how much of its phase is left.
        line: (4,) gains and biases.
        counted: (n,) which samples count.
        clear: (n,) is filled with those that could be told beforehand to stay clear of the gate.
    """
    n = len(hand)
    out = np.zeros(n)
    keep = math.exp(-noise[RATE] * noise[STEP_S])
    cos, sin = noise[FADING] * math.cos(noise[TURN_RAD]), noise[FADING] * math.sin(noise[TURN_RAD])
    x, p, told, spread = np.zeros((2, 3)), np.zeros((2, 3, 3)), np.zeros(2), np.zeros(2)
    wander = noise[NOISE] ** 2
    for axis in range(2):
        p[axis, 0, 0] = wander
        p[axis, 1, 1] = p[axis, 2, 2] = (
            0.5 * (noise[TREMOR] * (1.0 if axis == 0 else _FORWARD)) ** 2
        )
    for k in range(n):
        for axis in range(2):
            a, b, c = x[axis, 0], x[axis, 1], x[axis, 2]
            x[axis, 0], x[axis, 1], x[axis, 2] = keep * a, cos * b - sin * c, sin * b + cos * c
            _grow(p[axis], keep, cos, sin)
            shake = (
                0.5
                * (noise[TREMOR] * (1.0 if axis == 0 else _FORWARD)) ** 2
                * (1.0 - noise[FADING] ** 2)
            )
            p[axis, 0, 0] += wander * (1.0 - keep * keep)
            p[axis, 1, 1] += shake
            p[axis, 2, 2] += shake
            told[axis] = line[axis] * wish[k, axis] + line[2 + axis] + x[axis, 0] + x[axis, 1]
            spread[axis] = p[axis, 0, 0] + 2.0 * p[axis, 0, 1] + p[axis, 1, 1] + _SEEN
        reach = math.hypot(told[0], told[1]) + 3.0 * math.sqrt(max(spread[0], spread[1]))
        clear[k] = reach < 1.0 and k > 0 and free[k - 1]
        if not free[k]:
            continue
        for axis in range(2):
            new = hand[k, axis] - told[axis]
            if counted[k]:
                out[k] += 0.5 * (math.log(math.tau * spread[axis]) + new * new / spread[axis])
            _learn(x[axis], p[axis], new, spread[axis])
    return out


@exact_kernel
def _grow(p: F64, keep: float, cos: float, sin: float) -> None:
    """The covariance (3, 3) of wander and tremor a sample later, without what is new."""
    p01, p02 = p[0, 1], p[0, 2]
    p[0, 0] *= keep * keep
    p[0, 1] = p[1, 0] = keep * (cos * p01 - sin * p02)
    p[0, 2] = p[2, 0] = keep * (sin * p01 + cos * p02)
    p11, p12, p22 = p[1, 1], p[1, 2], p[2, 2]
    p[1, 1] = cos * cos * p11 - 2.0 * cos * sin * p12 + sin * sin * p22
    p[2, 2] = sin * sin * p11 + 2.0 * cos * sin * p12 + cos * cos * p22
    p[1, 2] = p[2, 1] = cos * sin * (p11 - p22) + (cos * cos - sin * sin) * p12


@exact_kernel
def _learn(x: F64, p: F64, new: float, spread: float) -> None:
    """What a sample says of wander and tremor."""
    seen = p[:, 0] + p[:, 1]
    for i in range(3):
        x[i] += seen[i] / spread * new
    for i in range(3):
        for j in range(3):
            p[i, j] -= seen[i] * seen[j] / spread


_ROUNDS, _HALVINGS, _DONE = 15, 6, 5e-3
_FARTHEST = 25.0  # steps of the derivatives, in one round: these say nothing of what is far off

Summands = Callable[[F64], F64]
"""The summands (B,) at a place (p,): minus the logarithm of a likelihood, stretch by stretch."""


def least(summands: Summands, start: F64, steps: F64) -> F64:
    """The place (p,) where the sum is least, from a `start` near it; `steps` (p,) are those of the derivatives.

    The sum's bend is that of its slopes' spread (Berndt, Hall, Hall and Hausman), which a likelihood has at its top.
    """
    here, value = start.copy(), float(summands(start).sum())
    for _ in range(_ROUNDS):
        slopes = _slopes(summands, here, steps)
        move = -np.linalg.solve(_upright(slopes.T @ slopes), slopes.sum(axis=0))
        move *= min(1.0, _FARTHEST / float(np.abs(move / steps).max()))
        gained = 0.0
        for _ in range(_HALVINGS):
            there = float(summands(here + move).sum())
            if there < value:
                gained = value - there
                here, value = here + move, there
                break
            move *= 0.4
        if gained < _DONE:
            break
    return here


def _certainty(
    summands: Summands, here: F64, steps: F64, together: np.typing.NDArray[np.intp]
) -> F64:
    """The covariance (p, p) of the least place, by White's sandwich.

    Args:
        summands: As above.
        here: The least place.
        steps: Of the derivatives.
        together: (B,) numbers of longer stretches, which alone are like strangers to each other.
    """
    slopes = _slopes(summands, here, steps)
    inverse = np.linalg.inv(_upright(_bend(summands, here, steps)))
    count = int(together.max()) + 1
    longer = np.stack([np.bincount(together, column, count) for column in slopes.T], axis=1)
    centred = longer - longer.mean(axis=0)
    return np.asarray(
        inverse @ (centred.T @ centred) @ inverse * count / max(1, count - 1), np.float64
    )


def _slopes(summands: Summands, here: F64, steps: F64) -> F64:
    """(B, p)."""
    sides = [
        (summands(here + step) - summands(here - step)) / (2.0 * step.sum())
        for step in np.diag(steps)
    ]
    return np.stack(sides, axis=1)


def _bend(summands: Summands, here: F64, steps: F64) -> F64:
    """(p, p) second derivatives of the sum."""
    jumps, middle = np.diag(steps), float(summands(here).sum())
    ahead = np.array([float(summands(here + jump).sum()) for jump in jumps])
    back = np.array([float(summands(here - jump).sum()) for jump in jumps])
    bend = np.diag((ahead - 2.0 * middle + back) / steps**2)
    for i in range(len(steps)):
        for k in range(i):
            both = float(summands(here + jumps[i] + jumps[k]).sum())
            neither = float(summands(here - jumps[i] - jumps[k]).sum())
            alone = ahead[i] + ahead[k] + back[i] + back[k] - 2.0 * middle
            bend[i, k] = bend[k, i] = (both + neither - alone) / (2.0 * steps[i] * steps[k])
    return np.asarray(bend, np.float64)


def _upright(bend: F64) -> F64:
    """The same, bent upwards in every direction."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(bend)), 1e-12))
    values, vectors = np.linalg.eigh(bend / np.outer(scale, scale))
    lifted = vectors * np.maximum(np.abs(values), 1e-4) @ vectors.T
    return np.asarray(lifted * np.outer(scale, scale), np.float64)


BLOCK_S = 10.0  # stretches that are taken for strangers to each other
_STRETCH_S = 1.0  # whose slopes say how the likelihood bends
_DELAYS_S = np.arange(0.05, 1.31, 0.05)
_LAGS_S = (0.06, 0.12, 0.25, 0.45)
_LEAST_NOISE, _GUESSED_RATE = 0.02, 3.0  # to begin with
_MEAN_SWING = 0.3125  # square of a tremor of amplitude 1, mean over time and both axes
_TREMOR_BAND_HZ, _BAND_OF_RATE = (2.5, 12.0), 0.45
_SURE = 12.0  # so much more probable, as a logarithm, must the hand be with a tremor than without
_LEAST_TREMOR = 0.01  # of the stick's travel: less than this is none
_LEAST_COUNTED = 0.05  # of the samples
_KEPT = 12
NAMES = (
    "reaction_s",
    "lag_s",
    "gain_x",
    "gain_y",
    "bias_x",
    "bias_y",
    "noise",
    "noise_rate",
    "tremor",
    "tremor_hz",
)
LOGS = frozenset({"lag_s", "noise", "noise_rate", "tremor"})  # whose logarithm is fitted
_STEPS = (0.01, 0.05, 0.02, 0.02, 0.01, 0.01, 0.05, 0.08, 0.05, 0.01)
_LOW = (0.0, 5e-3, -5.0, -5.0, -2.0, -2.0, 1e-4, 0.05, 1e-4, 0.5)
_HIGH = (2.0, 3.0, 5.0, 5.0, 2.0, 2.0, 2.0, 60.0, 2.0, 40.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class HandLaw:
    """The fitted numbers of a hand and how certain they are: standard deviations by name, none for what is not told."""

    values: dict[str, float]
    sd: dict[str, float]  # of the logarithm of lag, noise, noise_rate, tremor
    tremor_most: float  # what a tremor that was not found is below; 0 with one
    counted_share: float  # of the samples of a stick that moves, those that said something


def fit_law(series: Sequence[HandSeries]) -> HandLaw:
    """The most probable law of a hand.

    Args:
        series: Episodes of one person, at least one, sampled alike.
    """
    guess = _guess(series)
    blocks = _Likelihood(series, guess)
    calm = least(blocks, _likeliest(blocks, guess[:8]), np.array(_STEPS[:8]))
    shaken = least(blocks, _likeliest(blocks, guess), np.array(_STEPS))
    gained = float(blocks(calm).sum() - blocks(shaken).sum())
    here = shaken if gained > _SURE and shaken[8] > math.log(_LEAST_TREMOR) else calm
    for _ in range(2):  # which samples stay clear of the gate is told by the law itself
        blocks = _Likelihood(series, here)
        here = least(blocks, here, np.array(_STEPS[: len(here)]))
    spread = _certainty(blocks, here, np.array(_STEPS[: len(here)]), blocks.together)
    values = _values(here, series[0].filter_s)
    sd = dict(zip(NAMES, np.sqrt(np.maximum(np.diag(spread), 0.0)).tolist(), strict=False))
    sd["reaction_s"] = math.hypot(
        sd["reaction_s"], series[0].tick_s / series[0].steps / math.sqrt(12.0)
    )
    most = 0.0 if len(here) == len(NAMES) else _most_tremor(series, here, guess)
    return HandLaw(
        values={**dict.fromkeys(NAMES, 0.0), **values},
        sd=sd,
        tremor_most=most,
        counted_share=_counted_share(series, blocks.counted),
    )


def _counted_share(series: Sequence[HandSeries], counted: Sequence[Bool]) -> float:
    """Who only ever pushes to the gate tells no more than who never moves."""
    moves = np.concatenate(
        [np.hypot(item.stick[:, 0], item.stick[:, 1]) > MOVES for item in series]
    )
    return float((np.concatenate(counted) & moves).sum() / max(1, int(moves.sum())))


class _Likelihood:
    """Minus the logarithm of the likelihood, second by second, at a place (8,) or with a tremor (10,)."""

    def __init__(self, series: Sequence[HandSeries], reference: F64) -> None:
        """Samples count that stay clear of the gate by the `reference`."""
        self._series = series
        self._wishes: dict[tuple[float, float], list[F64]] = {}
        ends = [item.time_s for item in series]
        blocks = [np.floor(part / _STRETCH_S).astype(np.intp) for part in ends]
        known = np.unique(np.concatenate(blocks))
        self.together = np.unique(np.floor(known * _STRETCH_S / BLOCK_S), return_inverse=True)[1]
        self._blocks = [np.searchsorted(known, part) for part in blocks]
        self._count = len(known)
        self.counted: list[Bool] = [np.ones(len(part), np.bool_) for part in ends]
        self._parts(reference)
        share = float(np.mean(np.concatenate(self._clear)))
        self.counted = [
            clear & item.free if share > _LEAST_COUNTED else item.free
            for clear, item in zip(self._clear, series, strict=True)
        ]

    def __call__(self, place: F64) -> F64:
        sums = np.zeros(self._count)
        for block, part in zip(self._blocks, self._parts(place), strict=True):
            sums += np.bincount(block, part, self._count)
        return sums

    def _parts(self, place: F64) -> list[F64]:
        low, high = (
            np.array([_fitted(name, side[k]) for k, name in enumerate(NAMES)])
            for side in (_LOW, _HIGH)
        )
        inside = np.clip(place, low[: len(place)], high[: len(place)])
        beyond = float((((place - inside) / np.array(_STEPS[: len(place)])) ** 2).sum())
        law = dict(
            zip(
                NAMES,
                (_plain(name, value) for name, value in zip(NAMES, inside, strict=False)),
                strict=False,
            )
        )
        self._clear, found = [], []
        wishes = self._on_their_way(law["reaction_s"], law["lag_s"])
        for item, counted, wish in zip(self._series, self.counted, wishes, strict=True):
            clear = np.zeros(len(item.at), np.bool_)
            line = np.array([law[name] for name in ("gain_x", "gain_y", "bias_x", "bias_y")])
            noise = _noise(law, item.apart_s)
            part = _surprises(item.hand, wish, item.free, noise, line, counted, clear)
            found.append(part + beyond / len(part))
            self._clear.append(clear)
        return found

    def _on_their_way(self, delay_s: float, lag_s: float) -> list[F64]:
        """The wishes of each episode at its samples; the last few are kept, as most derivatives change neither."""
        if (delay_s, lag_s) not in self._wishes:
            while len(self._wishes) >= _KEPT:
                self._wishes.pop(next(iter(self._wishes)))
            self._wishes[delay_s, lag_s] = [_wished(item, delay_s, lag_s) for item in self._series]
        return self._wishes[delay_s, lag_s]


def _wished(item: HandSeries, delay_s: float, lag_s: float) -> F64:
    """What the hand would do at the samples (n, 2) without noise, gain and bias."""
    dt_s = item.tick_s / item.steps
    return _wish_on_its_way(item.intents, item.steps, dt_s, delay_s, lag_s, item.filter_s)[item.at]


def _noise(law: dict[str, float], apart_s: float) -> F64:
    """What `_surprises` takes of the noise."""
    hz = law.get("tremor_hz", 4.0)
    fades_per_s = (
        0.5 * (math.tau * hz * TREMOR_WANDER) ** 2 * TREMOR_WANDER_S
    )  # half of what its phase diffuses
    turn_rad = math.tau * hz * apart_s
    return np.array(
        [
            apart_s,
            law["noise"],
            law["noise_rate"],
            law.get("tremor", 0.0),
            turn_rad,
            math.exp(-fades_per_s * apart_s),
        ]
    )


def _fitted(name: str, value: float) -> float:
    return math.log(value) if name in LOGS else value


def _plain(name: str, value: float) -> float:
    return math.exp(value) if name in LOGS else float(value)


def _values(place: F64, filter_s: float) -> dict[str, float]:
    """The numbers by name; what the joystick's low-pass took off the noise is given back."""
    law = {name: _plain(name, float(value)) for name, value in zip(NAMES, place, strict=False)}
    law["noise"] *= math.sqrt(1.0 + law["noise_rate"] * filter_s)
    if "tremor" in law:
        law["tremor"] *= math.hypot(1.0, math.tau * law["tremor_hz"] * filter_s)
    return law


def _likeliest(summands: Summands, guess: F64) -> F64:
    """The likeliest of a guess and of a faithful hand with each delay and lag of the lattice.

    A tremor moves the chair, and what is wanted answers to it: a line through both is no place to begin then.
    """
    starts = [guess]
    for lag_s in _LAGS_S:
        for delay_s in _DELAYS_S.tolist():
            starts.append(np.r_[delay_s, math.log(lag_s), 1.0, 1.0, 0.0, 0.0, guess[6:]])
    sums = [float(summands(start).sum()) for start in starts]
    return starts[int(np.argmin(sums))]


def _guess(series: Sequence[HandSeries]) -> F64:
    """Where to begin (10,): the best line over a lattice of delays and lags, the strongest swing for a tremor."""
    best, found = math.inf, (0.4, 0.15, np.ones(2), np.zeros(2))
    keep = math.exp(-_GUESSED_RATE * series[0].apart_s)
    use = np.concatenate([item.free[1:] & item.free[:-1] for item in series])
    y = np.concatenate([item.hand[1:] - keep * item.hand[:-1] for item in series])[use]
    for lag_s in _LAGS_S:
        for delay_s in _DELAYS_S.tolist():
            wishes = [_wished(item, delay_s, lag_s) for item in series]
            x = np.concatenate([wish[1:] - keep * wish[:-1] for wish in wishes])[use]
            dx, dy = x - x.mean(axis=0), y - y.mean(axis=0)
            gain = (dx * dy).sum(axis=0) / np.maximum((dx * dx).sum(axis=0), 1e-9)
            error = float(((dy - gain * dx) ** 2).mean())
            if error < best:
                best, found = (
                    error,
                    (delay_s, lag_s, gain, (y.mean(axis=0) - gain * x.mean(axis=0)) / (1.0 - keep)),
                )
    delay_s, lag_s, gain, bias = found
    amplitude, hz = _swing(series)
    turn = math.tau * hz * series[0].apart_s
    shaken = _MEAN_SWING * amplitude**2 * (1.0 + keep * keep - 2.0 * keep * math.cos(turn))
    noise = math.sqrt(max(best - shaken, 0.0) / (1.0 - keep * keep) + _LEAST_NOISE**2)
    start = (delay_s, lag_s, *gain.tolist(), *bias.tolist(), noise, _GUESSED_RATE, amplitude, hz)
    bounded = np.clip(start, np.array(_LOW) + 1e-3, _HIGH)
    return np.array(
        [_fitted(name, float(value)) for name, value in zip(NAMES, bounded, strict=True)]
    )


def _swing(series: Sequence[HandSeries]) -> tuple[float, float]:
    """Amplitude and frequency of the strongest swing to the side between 2.5 and 12 Hz."""
    from scipy.signal import welch

    longest = max(series, key=lambda item: len(item.hand))
    apart_s, x = longest.apart_s, longest.hand[:, 0]
    size = min(len(x), round(12.0 / apart_s))
    hz, density = welch(x, 1.0 / apart_s, np.hanning(size), size)
    power = density / (size * apart_s)
    band = np.flatnonzero(
        (hz >= _TREMOR_BAND_HZ[0]) & (hz <= min(_TREMOR_BAND_HZ[1], _BAND_OF_RATE / apart_s))
    )
    usual = np.median(power[band])
    peak = int(band[(power[band] * hz[band] ** 2).argmax()])
    near = slice(max(1, peak - 2), peak + 3)
    variance = max(float((power[near] - usual).sum()), 1e-6)
    return math.sqrt(2.0 * variance), float((hz[near] * power[near]).sum() / power[near].sum())


def _most_tremor(series: Sequence[HandSeries], calm: F64, guess: F64) -> float:
    """How large a tremor at the likeliest frequency may be before the hand gets improbable."""
    blocks = _Likelihood(series, calm)
    least_sum = float(blocks(calm).sum())
    for amplitude in (0.002, 0.005, 0.01, 0.02, 0.05, 0.1):
        if float(blocks(np.r_[calm, math.log(amplitude), guess[9]]).sum()) > least_sum + 2.0:
            return amplitude
    return 0.2
