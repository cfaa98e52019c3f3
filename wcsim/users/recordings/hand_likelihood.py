"""The likelihood of a hand: how probable its samples are for a delay, a lag, gains and noise.

Each sample is judged by those before it and by the intents until then. So the fit stays right in
the loop, where an intent answers to the noise before it. The negative logarithm is a sum over
stretches of time. It is minimized by their gradients, and their spread gives the certainty.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F64, Bool
from wcsim.users.hand import TREMOR_FORWARD, TREMOR_WANDER, TREMOR_WANDER_S
from wcsim.users.recordings.hand_series import MOVES, HandTimeSeries

BLOCK_S: Final = 10.0  # stretches that are taken as independent of each other
_STRETCH_S: Final = 1.0  # stretches of the sum
LOGS: Final = frozenset({"lag_s", "noise", "noise_rate", "tremor"})  # fitted by their logarithm
_NAMES: Final = (
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
_CALM: Final = 8  # the first parameters, which a hand without a tremor has
_LINE: Final = ("gain_x", "gain_y", "bias_x", "bias_y")
_STEPS: Final = (0.01, 0.05, 0.02, 0.02, 0.01, 0.01, 0.05, 0.08, 0.05, 0.01)
_LOW: Final = (0.0, 5e-3, -5.0, -5.0, -2.0, -2.0, 1e-4, 0.05, 1e-4, 0.5)
_HIGH: Final = (2.0, 3.0, 5.0, 5.0, 2.0, 2.0, 2.0, 60.0, 2.0, 40.0)

# By so much, as a logarithm, the hand must be more probable with a tremor than without.
_SURE: Final = 12.0
_LEAST_TREMOR: Final = 0.01  # of the stick's travel: less than this is none
_TREMORS: Final = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
_IMPROBABLE: Final = 2.0
_LEAST_COUNTED: Final = 0.05  # of the samples
_MOST_CACHED: Final = 12

# Where the search starts.
_DELAYS_S: Final = np.arange(0.05, 1.31, 0.05)
_LAGS_S: Final = (0.06, 0.12, 0.25, 0.45)
_LEAST_NOISE: Final = 0.02
_GUESSED_RATE: Final = 3.0
_MEAN_SWING: Final = 0.3125  # square of a tremor of amplitude 1, mean over time and both axes
_TREMOR_BAND_HZ: Final = (2.5, 12.0)
_BAND_OF_RATE: Final = 0.45

_ROUNDS: Final = 15
_HALVINGS: Final = 6
_SHORTER: Final = 0.4
_DONE: Final = 5e-3
# A round moves at most so many steps of the derivatives: these show nothing of what is far off.
_FARTHEST: Final = 25.0

# Indices into the noise of a hand (6,).
_STEP_S, _NOISE, _RATE, _TREMOR, _TURN_RAD, _FADING = range(6)
_SEEN: Final = 1e-6  # variance that a sample adds of its own

_LossTerms = Callable[[F64], F64]
"""The terms (B,) of a loss at parameters (p,): minus the log-likelihood, stretch by stretch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HandFitResult:
    """The fitted numbers of a hand, and their standard deviations by name, none where unknown."""

    values: dict[str, float]
    sd: dict[str, float]  # of the logarithm of lag, noise, noise_rate, tremor
    tremor_most: float  # a tremor that was not found is below this; 0 with one
    counted_share: float  # of the samples of a stick that moves, those that counted


def fit_hand_model(series: Sequence[HandTimeSeries]) -> HandFitResult:
    """The most probable hand.

    Args:
        series: Episodes of one person, at least one, sampled alike.
    """
    # 1. Fit with and without a tremor, and choose. A tremor needs clear evidence.
    steps = np.array(_STEPS)
    guess = _guess(series)
    loss = _Loss(series, guess)
    calm = _minimize(loss, _best_start(loss, guess[:_CALM]), steps[:_CALM])
    shaken = _minimize(loss, _best_start(loss, guess), steps)
    gained = float(loss(calm).sum() - loss(shaken).sum())
    found = shaken if gained > _SURE and shaken[_CALM] > math.log(_LEAST_TREMOR) else calm

    # 2. Fit again: which samples stay clear of the gate depends on the numbers themselves.
    steps = steps[: len(found)]
    for _ in range(2):
        loss = _Loss(series, found)
        found = _minimize(loss, found, steps)

    # 3. Give the numbers by name. The joystick's low-pass took something off the noise.
    values = dict.fromkeys(_NAMES, 0.0) | _natural_values(found)
    filter_s = series[0].filter_s
    values["noise"] *= math.sqrt(1.0 + values["noise_rate"] * filter_s)
    values["tremor"] *= math.hypot(1.0, math.tau * values["tremor_hz"] * filter_s)
    variances = np.diag(_covariance(loss, found, steps, loss.together))
    sd = dict(zip(_NAMES, np.sqrt(np.maximum(variances, 0.0)).tolist(), strict=False))
    step_s = series[0].tick_s / series[0].steps
    sd["reaction_s"] = math.hypot(sd["reaction_s"], step_s / math.sqrt(12.0))
    has_tremor = len(found) == len(_NAMES)
    # A user that only ever pushes to the gate shows no more than one that never moves.
    moves = np.concatenate(
        [np.hypot(item.stick[:, 0], item.stick[:, 1]) > MOVES for item in series]
    )
    counted = (np.concatenate(loss.counted) & moves).sum()
    return HandFitResult(
        values=values,
        sd=sd,
        tremor_most=0.0 if has_tremor else _most_tremor(series, found, guess),
        counted_share=float(counted / max(1, int(moves.sum()))),
    )


def _most_tremor(series: Sequence[HandTimeSeries], calm: F64, guess: F64) -> float:
    """How large a tremor at the likeliest frequency may be before the hand gets improbable."""
    loss = _Loss(series, calm)
    least = float(loss(calm).sum())
    for amplitude in _TREMORS:
        shaken = np.r_[calm, math.log(amplitude), guess[9]]
        if float(loss(shaken).sum()) > least + _IMPROBABLE:
            return amplitude
    return 0.2


# --- where the search starts ---


def _guess(series: Sequence[HandTimeSeries]) -> F64:
    """Where to start (10,): the best line of a lattice of delays and lags, the strongest swing."""
    apart_s = series[0].apart_s
    decay = math.exp(-_GUESSED_RATE * apart_s)
    use = np.concatenate([item.free[1:] & item.free[:-1] for item in series])
    y = np.concatenate([item.hand[1:] - decay * item.hand[:-1] for item in series])[use]
    error = math.inf
    line = (0.4, 0.15, 1.0, 1.0, 0.0, 0.0)
    for lag_s in _LAGS_S:
        for delay_s in _DELAYS_S.tolist():
            hands = [_noiseless_hand(item, delay_s, lag_s) for item in series]
            x = np.concatenate([hand[1:] - decay * hand[:-1] for hand in hands])[use]
            dx, dy = x - x.mean(axis=0), y - y.mean(axis=0)
            gain = (dx * dy).sum(axis=0) / np.maximum((dx * dx).sum(axis=0), 1e-9)
            off = float(((dy - gain * dx) ** 2).mean())
            if off < error:
                error = off
                bias = (y.mean(axis=0) - gain * x.mean(axis=0)) / (1.0 - decay)
                line = (delay_s, lag_s, *gain.tolist(), *bias.tolist())
    amplitude, hz = _swing(series)
    turn_rad = math.tau * hz * apart_s
    shaken = _MEAN_SWING * amplitude**2
    shaken *= 1.0 + decay * decay - 2.0 * decay * math.cos(turn_rad)
    noise = math.sqrt(max(error - shaken, 0.0) / (1.0 - decay * decay) + _LEAST_NOISE**2)
    start = (*line, noise, _GUESSED_RATE, amplitude, hz)
    return _fitted_values(np.clip(start, np.array(_LOW) + 1e-3, _HIGH))


def _swing(series: Sequence[HandTimeSeries]) -> tuple[float, float]:
    """Amplitude and frequency of the strongest swing to the side between 2.5 and 12 Hz."""
    from scipy.signal import welch

    longest = max(series, key=lambda item: len(item.hand))
    apart_s, x = longest.apart_s, longest.hand[:, 0]
    size = min(len(x), round(12.0 / apart_s))
    hz, density = welch(x, 1.0 / apart_s, np.hanning(size), size)
    power = density / (size * apart_s)
    highest_hz = min(_TREMOR_BAND_HZ[1], _BAND_OF_RATE / apart_s)
    band = np.flatnonzero((hz >= _TREMOR_BAND_HZ[0]) & (hz <= highest_hz))
    usual = np.median(power[band])
    peak = int(band[(power[band] * hz[band] ** 2).argmax()])
    near = slice(max(1, peak - 2), peak + 3)
    variance = max(float((power[near] - usual).sum()), 1e-6)
    return math.sqrt(2.0 * variance), float((hz[near] * power[near]).sum() / power[near].sum())


def _best_start(loss: _LossTerms, guess: F64) -> F64:
    """The likeliest of a guess and of a faithful hand with each delay and lag of the lattice.

    A tremor moves the chair, and the intent answers to it: then a line through both is no place to
    start from.
    """
    starts = [guess]
    for lag_s in _LAGS_S:
        for delay_s in _DELAYS_S.tolist():
            starts.append(np.r_[delay_s, math.log(lag_s), 1.0, 1.0, 0.0, 0.0, guess[6:]])
    sums = [float(loss(start).sum()) for start in starts]
    return starts[int(np.argmin(sums))]


# --- the loss ---


class _Loss:
    """Minus the log-likelihood, second by second, of a hand (8,) or one with a tremor (10,)."""

    def __init__(self, series: Sequence[HandTimeSeries], reference: F64) -> None:
        """Samples count that stay clear of the gate by the hand `reference`."""
        self._series = series
        self._cached: dict[tuple[float, float], list[F64]] = {}
        times_s = [item.time_s for item in series]
        stretches = [np.floor(part / _STRETCH_S).astype(np.intp) for part in times_s]
        known = np.unique(np.concatenate(stretches))
        # Of each stretch, the number of the longer block that it is in.
        self.together = np.unique(np.floor(known * _STRETCH_S / BLOCK_S), return_inverse=True)[1]
        self._stretches = [np.searchsorted(known, part) for part in stretches]
        self._count = len(known)
        self.counted: list[Bool] = [np.ones(len(part), np.bool_) for part in times_s]
        _, clear = self._judge(reference)
        share = float(np.mean(np.concatenate(clear)))
        self.counted = [
            part & item.free if share > _LEAST_COUNTED else item.free
            for part, item in zip(clear, series, strict=True)
        ]

    def __call__(self, params: F64) -> F64:
        sums = np.zeros(self._count)
        for stretch, part in zip(self._stretches, self._judge(params)[0], strict=True):
            sums += np.bincount(stretch, part, self._count)
        return sums

    def _judge(self, params: F64) -> tuple[list[F64], list[Bool]]:
        """For each episode the loss of its samples, and which of them stay clear of the gate."""
        low = _fitted_values(np.array(_LOW))[: len(params)]
        high = _fitted_values(np.array(_HIGH))[: len(params)]
        inside = np.clip(params, low, high)
        beyond = float((((params - inside) / np.array(_STEPS[: len(params)])) ** 2).sum())
        values = _natural_values(inside)
        line = np.array([values[name] for name in _LINE])
        hz = values.get("tremor_hz", 4.0)
        # Half of what its phase diffuses.
        fades_per_s = 0.5 * (math.tau * hz * TREMOR_WANDER) ** 2 * TREMOR_WANDER_S
        losses, clears = [], []
        hands = self._noiseless_hands(values["reaction_s"], values["lag_s"])
        for item, counted, hand in zip(self._series, self.counted, hands, strict=True):
            clear = np.zeros(len(item.at), np.bool_)
            noise = np.array(
                [
                    item.apart_s,
                    values["noise"],
                    values["noise_rate"],
                    values.get("tremor", 0.0),
                    math.tau * hz * item.apart_s,
                    math.exp(-fades_per_s * item.apart_s),
                ]
            )
            part = _negative_log_density(item.hand, hand, item.free, noise, line, counted, clear)
            losses.append(part + beyond / len(part))
            clears.append(clear)
        return losses, clears

    def _noiseless_hands(self, delay_s: float, lag_s: float) -> list[F64]:
        """As `_noiseless_hand` by episode; cached, as most derivatives change neither number."""
        if (delay_s, lag_s) not in self._cached:
            while len(self._cached) >= _MOST_CACHED:
                self._cached.pop(next(iter(self._cached)))
            hands = [_noiseless_hand(item, delay_s, lag_s) for item in self._series]
            self._cached[delay_s, lag_s] = hands
        return self._cached[delay_s, lag_s]


def _noiseless_hand(item: HandTimeSeries, delay_s: float, lag_s: float) -> F64:
    """The hand at the samples (n, 2) without noise, gain and bias."""
    dt_s = item.tick_s / item.steps
    return _delayed_intents(item.intents, item.steps, dt_s, delay_s, lag_s, item.filter_s)[item.at]


def _fitted_values(values: F64) -> F64:
    """The parameters (p,) that are fitted for the numbers of a hand: some are logarithms."""
    pairs = zip(_NAMES, values.tolist(), strict=False)
    return np.array([math.log(value) if name in LOGS else value for name, value in pairs])


def _natural_values(params: F64) -> dict[str, float]:
    """The numbers of a hand by name; the opposite of `_fitted_values`."""
    pairs = zip(_NAMES, params.tolist(), strict=False)
    return {name: math.exp(value) if name in LOGS else value for name, value in pairs}


@compile_exact_kernel
def _delayed_intents(
    intents: F64, steps: int, dt_s: float, delay_s: float, lag_s: float, filter_s: float
) -> F64:
    """The hand (N * steps, 2) without noise: intents (N, 2) after delay, lag and low-pass.

    An intent counts in part around the step in which it arrives, so that the result changes
    smoothly with the delay.
    """
    ticks = len(intents)
    out = np.zeros((ticks * steps, 2))
    share = 1.0 - math.exp(-dt_s / max(lag_s, 1e-9))
    filtered = 1.0 if filter_s <= 0.0 else 1.0 - math.exp(-dt_s / filter_s)
    state, stick = np.zeros(2), np.zeros(2)
    for k in range(ticks * steps):
        # A hand heeds what arrives within a step in all of it.
        at = ((k + 1.5) * dt_s - delay_s) / (steps * dt_s)
        index = math.floor(at)
        part = min(1.0, (at - index) * steps)
        for axis in range(2):
            now = intents[min(index, ticks - 1), axis] if index >= 0 else 0.0
            before = intents[min(index - 1, ticks - 1), axis] if index >= 1 else 0.0
            intent = part * now + (1.0 - part) * before
            state[axis] += share * (intent - state[axis])
            stick[axis] += filtered * (state[axis] - stick[axis])
            out[k, axis] = stick[axis]
    return out


@compile_exact_kernel
def _negative_log_density(
    hand: F64, intent: F64, free: Bool, noise: F64, line: F64, counted: Bool, clear: Bool
) -> F64:
    """How unlikely each sample (n,) of a hand is after those before it.

    The noise is an Ornstein-Uhlenbeck process on each axis, and a tremor whose phase wanders; both
    are followed by a Kalman filter. A sample at the gate is not known: it changes nothing, and the
    first one after it counts for nothing.

    Args:
        hand: (n, 2) the samples.
        intent: (n, 2) the result of `_delayed_intents` for the intents.
        free: (n,) which samples the gate did not stop.
        noise: (6,) seconds between samples, standard deviation and rate of the wander, amplitude
            and turn of the tremor from sample to sample, and how much of its phase is left.
        line: (4,) gains x, y and biases x, y.
        counted: (n,) which samples count.
        clear: (n,) is filled with those that were predicted to stay clear of the gate.
    """
    n = len(hand)
    out = np.zeros(n)
    decay = math.exp(-noise[_RATE] * noise[_STEP_S])
    cos = noise[_FADING] * math.cos(noise[_TURN_RAD])
    sin = noise[_FADING] * math.sin(noise[_TURN_RAD])
    x, p, mean, variance = np.zeros((2, 3)), np.zeros((2, 3, 3)), np.zeros(2), np.zeros(2)
    wander, swing = noise[_NOISE] ** 2, np.zeros(2)
    for axis in range(2):
        swing[axis] = 0.5 * (noise[_TREMOR] * (1.0 if axis == 0 else TREMOR_FORWARD)) ** 2
        p[axis, 0, 0] = wander
        p[axis, 1, 1] = p[axis, 2, 2] = swing[axis]
    for k in range(n):
        for axis in range(2):
            a, b, c = x[axis, 0], x[axis, 1], x[axis, 2]
            x[axis, 0], x[axis, 1], x[axis, 2] = decay * a, cos * b - sin * c, sin * b + cos * c
            _predict_covariance(p[axis], decay, cos, sin)
            shake = swing[axis] * (1.0 - noise[_FADING] ** 2)
            p[axis, 0, 0] += wander * (1.0 - decay * decay)
            p[axis, 1, 1] += shake
            p[axis, 2, 2] += shake
            mean[axis] = line[axis] * intent[k, axis] + line[2 + axis] + x[axis, 0] + x[axis, 1]
            variance[axis] = p[axis, 0, 0] + 2.0 * p[axis, 0, 1] + p[axis, 1, 1] + _SEEN
        reach = math.hypot(mean[0], mean[1]) + 3.0 * math.sqrt(max(variance[0], variance[1]))
        clear[k] = reach < 1.0 and k > 0 and free[k - 1]
        if not free[k]:
            continue
        for axis in range(2):
            new = hand[k, axis] - mean[axis]
            if counted[k]:
                out[k] += 0.5 * (math.log(math.tau * variance[axis]) + new * new / variance[axis])
            _update_state(x[axis], p[axis], new, variance[axis])
    return out


@compile_exact_kernel
def _predict_covariance(p: F64, decay: float, cos: float, sin: float) -> None:
    """Carry the covariance (3, 3) of wander and tremor on by a sample, without what is new."""
    p01, p02 = p[0, 1], p[0, 2]
    p[0, 0] *= decay * decay
    p[0, 1] = p[1, 0] = decay * (cos * p01 - sin * p02)
    p[0, 2] = p[2, 0] = decay * (sin * p01 + cos * p02)
    p11, p12, p22 = p[1, 1], p[1, 2], p[2, 2]
    p[1, 1] = cos * cos * p11 - 2.0 * cos * sin * p12 + sin * sin * p22
    p[2, 2] = sin * sin * p11 + 2.0 * cos * sin * p12 + cos * cos * p22
    p[1, 2] = p[2, 1] = cos * sin * (p11 - p22) + (cos * cos - sin * sin) * p12


@compile_exact_kernel
def _update_state(x: F64, p: F64, new: float, variance: float) -> None:
    """Take a sample into the state (3,) of wander and tremor and its covariance (3, 3)."""
    seen = p[:, 0] + p[:, 1]
    for i in range(3):
        x[i] += seen[i] / variance * new
    for i in range(3):
        for j in range(3):
            p[i, j] -= seen[i] * seen[j] / variance


# --- the minimum ---


def _minimize(loss: _LossTerms, start: F64, steps: F64) -> F64:
    """The parameters (p,) where the sum of the loss is least, from a `start` near it.

    `steps` (p,) are those of the derivatives. The Hessian of the sum is that of its gradients'
    spread (Berndt, Hall, Hall and Hausman), which a likelihood has at its top.
    """
    here, value = start.copy(), float(loss(start).sum())
    for _ in range(_ROUNDS):
        gradients = _gradients(loss, here, steps)
        hessian = _positive_definite(gradients.T @ gradients)
        move = -np.linalg.solve(hessian, gradients.sum(axis=0))
        move *= min(1.0, _FARTHEST / float(np.abs(move / steps).max()))
        gained = 0.0
        for _ in range(_HALVINGS):
            there = float(loss(here + move).sum())
            if there < value:
                gained = value - there
                here, value = here + move, there
                break
            move *= _SHORTER
        if gained < _DONE:
            break
    return here


def _covariance(
    loss: _LossTerms, here: F64, steps: F64, together: np.typing.NDArray[np.intp]
) -> F64:
    """The covariance (p, p) of the parameters at the minimum, by White's sandwich.

    Args:
        loss: As for `_minimize`.
        here: The minimum.
        steps: Of the derivatives.
        together: (B,) numbers of longer stretches, which alone are independent of each other.
    """
    gradients = _gradients(loss, here, steps)
    inverse = np.linalg.inv(_positive_definite(_hessian(loss, here, steps)))
    count = int(together.max()) + 1
    longer = np.stack([np.bincount(together, column, count) for column in gradients.T], axis=1)
    centred = longer - longer.mean(axis=0)
    return np.asarray(
        inverse @ (centred.T @ centred) @ inverse * count / max(1, count - 1), np.float64
    )


def _gradients(loss: _LossTerms, here: F64, steps: F64) -> F64:
    """(B, p) the gradient of each term."""
    sides = [
        (loss(here + step) - loss(here - step)) / (2.0 * step.sum()) for step in np.diag(steps)
    ]
    return np.stack(sides, axis=1)


def _hessian(loss: _LossTerms, here: F64, steps: F64) -> F64:
    """(p, p) second derivatives of the sum."""
    jumps, middle = np.diag(steps), float(loss(here).sum())
    ahead = np.array([float(loss(here + jump).sum()) for jump in jumps])
    back = np.array([float(loss(here - jump).sum()) for jump in jumps])
    hessian = np.diag((ahead - 2.0 * middle + back) / steps**2)
    for i in range(len(steps)):
        for k in range(i):
            both = float(loss(here + jumps[i] + jumps[k]).sum())
            neither = float(loss(here - jumps[i] - jumps[k]).sum())
            alone = ahead[i] + ahead[k] + back[i] + back[k] - 2.0 * middle
            hessian[i, k] = hessian[k, i] = (both + neither - alone) / (2.0 * steps[i] * steps[k])
    return np.asarray(hessian, np.float64)


def _positive_definite(hessian: F64) -> F64:
    """The matrix with all of its eigenvalues turned positive."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(hessian)), 1e-12))
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    lifted = vectors * np.maximum(np.abs(values), 1e-4) @ vectors.T
    return np.asarray(lifted * np.outer(scale, scale), np.float64)
