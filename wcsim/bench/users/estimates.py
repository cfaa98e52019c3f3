"""What a user's hand and eyes did, estimated from what they left behind: sticks, intents, what was noticed.

Nothing here knows how the user model works inside: delays and gains come from fitting the stick to the intent, tremor
from a spectrum, looks elsewhere from intents that do not move. Each estimate stands beside the profile's parameter in
`wcsim bench users`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from wcsim.core.jit import exact_kernel
from wcsim.types import F64, Bool

STICK_FILTER_S = 0.02  # the joystick's electronics, which every stick has passed
_THIN = 6  # of the substeps one in so many is fitted
_LAGS_S = np.arange(0.04, 0.56, 0.02)
_LONGEST_DELAY_S = 1.0
_TREMOR_BAND_HZ = (2.5, 8.0)
_TREMOR_HALF_WIDTH_HZ = 1.2
_SEGMENT_S = 6.0
_WANDER_LATER_S = 0.25
_AT_GATE, _GATE_SHARE, _CLEAR_OF_GATE = 0.99, 0.05, 0.6  # of the stick's travel, of the samples, of a wish


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandLog:
    """A hand over N ticks of S substeps."""

    dt_s: float  # of a substep
    intents: F64  # (N, 2) wish at the beginning of each tick
    sticks: F64  # (N, S, 2)

    @property
    def flat(self) -> F64:
        """The stick (N * S, 2)."""
        return self.sticks.reshape(-1, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class HandFit:
    """The delayed, lagging, scaled and shifted intent that comes nearest to the stick."""

    delay_s: float
    lag_s: float
    gain: tuple[float, float]
    bias: tuple[float, float]
    wander: float  # standard deviation of what is left, mean of both axes
    wander_rate: float  # how fast that forgets itself, 1/s


@dataclass(frozen=True, slots=True, kw_only=True)
class Tremor:
    """The strongest oscillation of the stick to the sides."""

    hz: float
    amplitude: float  # before the electronics


@dataclass(frozen=True, slots=True, kw_only=True)
class Pauses:
    """Stretches in which nobody corrected an intent though the chair was driven."""

    share: float
    mean_s: float | None


def tremor(log: HandLog) -> Tremor:
    """Peak of the averaged spectrum between 2.5 and 8 Hz, and the amplitude of the power around it."""
    x = log.flat[:, 0]
    size = min(len(x), round(_SEGMENT_S / log.dt_s))
    window = np.hanning(size)
    starts = range(0, len(x) - size + 1, max(1, size // 2))
    pieces = np.array([x[start : start + size] for start in starts])
    spectra = np.abs(np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * window)) ** 2
    power = 2.0 * spectra.mean(axis=0) / (size * float((window**2).sum()))  # its sum over a band is the variance
    hz = np.fft.rfftfreq(size, log.dt_s)
    band = np.flatnonzero((hz >= _TREMOR_BAND_HZ[0]) & (hz <= _TREMOR_BAND_HZ[1]))
    peak_hz = float(hz[band[power[band].argmax()]])
    near = np.abs(hz - peak_hz) <= _TREMOR_HALF_WIDTH_HZ
    variance = float(power[near].sum())
    taken_off = math.hypot(1.0, math.tau * peak_hz * STICK_FILTER_S)
    middle_hz = float((hz * power)[near].sum()) / max(variance, 1e-12)
    return Tremor(hz=middle_hz, amplitude=math.sqrt(2.0 * variance) * taken_off)


def fit_hand(log: HandLog, smooth_s: float = 0.0) -> HandFit:
    """Fit delay, lag, gain and bias.

    What is left is taken for noise with a memory (AR(1)); the fit is done on what is new of it in each step, because in
    the loop an intent answers to the noise of before.

    Args:
        log: At least some seconds in which the intent moves.
        smooth_s: Both sides are averaged over this time first: the period of a tremor takes it out.
    """
    dt_s = _THIN * log.dt_s
    held = np.repeat(log.intents, log.sticks.shape[1], axis=0)
    width = max(1, round(smooth_s / dt_s))
    stick = _averaged(log.flat[::_THIN], width)
    filtered = _lagged(held, log.dt_s, STICK_FILTER_S)
    inputs = [_averaged(_lagged(filtered, log.dt_s, float(lag_s))[::_THIN], width) for lag_s in _LAGS_S]
    inside = [_inside(signal, stick) for signal in inputs]
    keep = 0.0
    for _ in range(2):
        pairs = zip(inputs, inside, strict=True)
        errors = np.array([_errors(_new(signal, keep), _new(stick, keep), use[1:], dt_s) for signal, use in pairs])
        lag, delay = np.unravel_index(int(errors.argmin()), errors.shape)
        gain, bias, rest = _line(inputs[lag][: len(stick) - delay], stick[delay:], inside[lag][: len(stick) - delay])
        keep = float(np.clip((rest[1:] * rest[:-1]).sum() / max(float((rest**2).sum()), 1e-12), 0.0, 0.995))
    later = round(_WANDER_LATER_S / dt_s)
    memory = float((rest[later:] * rest[:-later]).sum() / max(float((rest[:-later] ** 2).sum()), 1e-12))
    return HandFit(
        delay_s=_between(errors[lag], int(delay)) * dt_s,
        lag_s=float(_LAGS_S[0] + _between(errors[:, delay], int(lag)) * (_LAGS_S[1] - _LAGS_S[0])),
        gain=gain,
        bias=bias,
        wander=float(rest.std(axis=0).mean()),
        wander_rate=-math.log(min(max(memory, 1e-3), 0.999)) / _WANDER_LATER_S,
    )


def pauses(intents: F64, tick_s: float) -> Pauses:
    """Stretches in which an intent (N, 2) only let go of the steering, if anything; rest and backing up count not."""
    driven = (np.abs(intents[1:]).max(axis=1) > 0.0) & (intents[1:, 1] >= 0.0)
    still = (np.diff(intents[:, 1]) == 0.0) & (np.diff(np.abs(intents[:, 0])) <= 0.0) & driven
    lengths = [stop - start for start, stop in stretches(still)]
    mean_s = tick_s * float(np.mean(lengths)) if lengths else None
    return Pauses(share=float(still.sum()) / max(1, int(driven.sum())), mean_s=mean_s)


def correction_s(intents: F64, tick_s: float) -> float | None:
    """Mean time between changes of an intent (N, 2); stretches at rest are left out. None without any."""
    changed = np.flatnonzero((np.diff(intents, axis=0) != 0.0).any(axis=1))
    gaps = np.diff(changed)
    resting = np.array([bool((intents[a + 1 : b + 1] == 0.0).all()) for a, b in pairwise(changed.tolist())], np.bool_)
    gaps = gaps[~resting] if len(gaps) else gaps
    return float(gaps.mean()) * tick_s if len(gaps) else None


def switch_holds(sticks: F64, dt_s: float) -> tuple[F64, F64]:
    """How long switches (n, 2) were held, seconds: turns, and forward or stop between two turns."""
    changes = np.flatnonzero((np.diff(sticks, axis=0) != 0.0).any(axis=1)) + 1
    spans = np.diff(changes) * dt_s
    turning = sticks[changes[:-1], 0] != 0.0 if len(changes) else np.zeros(0, np.bool_)
    between = ~turning[1:-1] & turning[:-2] & turning[2:] if len(turning) > 2 else np.zeros(0, np.bool_)
    return spans[turning], spans[1:-1][between] if len(spans) > 2 else np.zeros(0)


def stretches(flags: Bool) -> Sequence[tuple[int, int]]:
    """(start, stop) of each run of true flags.

    >>> stretches(np.array([False, True, True, False, True]))
    [(1, 3), (4, 5)]
    """
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False].astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


@exact_kernel
def _lagged(signal: F64, dt_s: float, time_constant_s: float) -> F64:
    """A first-order low-pass over (n, 2), from rest."""
    keep = math.exp(-dt_s / time_constant_s)
    out = np.zeros_like(signal)
    for k in range(len(signal)):
        for axis in range(2):
            before = out[k - 1, axis] if k else 0.0
            out[k, axis] = keep * before + (1.0 - keep) * signal[k, axis]
    return out


def _averaged(signal: F64, width: int) -> F64:
    if width == 1:
        return signal
    sums = np.cumsum(np.concatenate([np.zeros((1, 2)), signal]), axis=0)
    mean: F64 = (sums[width:] - sums[:-width]) / width
    return mean


def _new(signal: F64, keep: float) -> F64:
    return signal[1:] - keep * signal[:-1]


def _inside(signal: F64, stick: F64) -> Bool:
    """(n,) which samples of a wish to take: where the gate often stops the stick, only those that stay clear of it."""
    if float((np.hypot(*stick.T) > _AT_GATE).mean()) < _GATE_SHARE:
        return np.ones(len(signal), np.bool_)
    clear: Bool = np.hypot(*signal.T) < _CLEAR_OF_GATE
    return clear if float(clear.mean()) > _GATE_SHARE else np.ones(len(signal), np.bool_)


def _errors(signal: F64, stick: F64, use: Bool, dt_s: float) -> F64:
    """Square error for each delay in steps, the best gain and bias taken for each."""
    errors = []
    for delay in range(round(_LONGEST_DELAY_S / dt_s) + 1):
        chosen = use[: len(signal) - delay]
        x, y = signal[: len(signal) - delay][chosen], stick[delay:][chosen]
        x, y = x - x.mean(axis=0), y - y.mean(axis=0)
        explained = (x * y).sum(axis=0) ** 2 / np.maximum((x**2).sum(axis=0), 1e-12)
        errors.append(float(((y**2).sum(axis=0) - explained).sum() / len(x)))
    return np.array(errors)


def _line(signal: F64, stick: F64, use: Bool) -> tuple[tuple[float, float], tuple[float, float], F64]:
    """Gain and bias of each axis from the samples to use, and what they leave of all (n, 2)."""
    middle_x, middle_y = signal[use].mean(axis=0), stick[use].mean(axis=0)
    x, y = signal[use] - middle_x, stick[use] - middle_y
    gain = (x * y).sum(axis=0) / np.maximum((x**2).sum(axis=0), 1e-12)
    bias = middle_y - gain * middle_x
    rest = stick - gain * signal - bias
    return (float(gain[0]), float(gain[1])), (float(bias[0]), float(bias[1])), rest


def _between(values: F64, lowest: int) -> float:
    """Where the parabola through the lowest value and its neighbours has its bottom."""
    if not 0 < lowest < len(values) - 1:
        return float(lowest)
    a, b, c = values[lowest - 1 : lowest + 2].tolist()
    return float(lowest + 0.5 * (a - c) / max(a - 2.0 * b + c, 1e-15))
