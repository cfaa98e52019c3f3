"""What a hand makes of a wish: delay, lag, gain and bias, and the noise that is left, fitted to a log of both."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.users.hand_habits import HandLog
from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F64, Bool
from wcsim.users.hand import STICK_FILTER_S

_THIN = 6  # of the substeps one in so many is fitted
_LAGS_S = np.arange(0.04, 0.56, 0.02)
_LONGEST_DELAY_S = 1.0
_AT_GATE = 1.0 - 1e-6  # of the stick's travel: there it may have been stopped
_HOPS = 4.0  # so many usual movements before the gate a stick is clear of it
_LEAST_SHARE = 0.05  # of the samples
_ROUNDS, _FIRST_KEEP, _MOST_KEPT = 3, 0.9, 0.995


@dataclass(frozen=True, slots=True, kw_only=True)
class HandFit:
    """The delayed, lagging, scaled and shifted intent that comes nearest to the stick."""

    delay_s: float
    lag_s: float
    gain: tuple[float, float]
    gain_sd: tuple[float, float]  # how uncertain the gain is: large where the intent hardly moves
    bias: tuple[float, float]
    wander: float  # standard deviation of what is left, mean of both axes
    wander_rate: float  # how fast that forgets itself, 1/s


def fit_hand(log: HandLog, smooth_s: float = 0.0) -> HandFit:
    """Fit delay, lag, gain and bias.

    What is left is taken for noise with a memory (AR(1)), and everything is fitted to what is new of it in each step:
    in the loop an intent answers to the noise of before, which lasts until that intent moves the hand. A fit to the
    stick itself takes that for a hand that moves less than it is told.

    Args:
        log: At least some seconds in which the intent moves.
        smooth_s: Both sides are averaged over this time first: the period of a tremor takes it out.
    """
    dt_s = _THIN * log.dt_s
    width = max(1, round(smooth_s / dt_s))
    use = _clear_of_gate(log.flat[::_THIN], width)
    hand = _averaged(_unfiltered(log)[::_THIN], width)
    held = np.repeat(log.intents, log.sticks.shape[1], axis=0)
    inputs = [_averaged(_lagged(held, log.dt_s, float(lag_s))[::_THIN], width) for lag_s in _LAGS_S]
    keep = _FIRST_KEEP
    for _ in range(_ROUNDS):
        new = _new(hand, keep)
        errors = np.array([_errors(_new(signal, keep), new, use, dt_s) for signal in inputs])
        lag, delay = (int(at) for at in np.unravel_index(int(errors.argmin()), errors.shape))
        signal, chosen = inputs[lag][: len(hand) - delay], use[delay:]
        gain, shift = _line(_new(signal, keep)[chosen], new[delay:][chosen])
        rest = hand[delay:] - gain * signal - shift / (1.0 - keep)
        keep_before, keep = keep, _memory(rest[:-1][chosen], rest[1:][chosen])
    bias, fresh = shift / (1.0 - keep_before), _new(rest, keep)[chosen]
    moved = _new(signal, keep)[chosen].std(axis=0) * math.sqrt(int(chosen.sum()))
    gain_sd = fresh.std(axis=0) / np.maximum(moved, 1e-9)
    return HandFit(
        delay_s=_between(errors[lag], delay) * dt_s,
        lag_s=float(_LAGS_S[0] + _between(errors[:, delay], lag) * (_LAGS_S[1] - _LAGS_S[0])),
        gain=(float(gain[0]), float(gain[1])),
        gain_sd=(float(gain_sd[0]), float(gain_sd[1])),
        bias=(float(bias[0]), float(bias[1])),
        wander=float(fresh.std(axis=0).mean()) / math.sqrt(1.0 - keep**2),
        wander_rate=-math.log(max(keep, 1e-3)) / dt_s,
    )


def _unfiltered(log: HandLog) -> F64:
    """The hand (N * S, 2) before the joystick's electronics, exact wherever the gate did not stop the stick."""
    keep = math.exp(-log.dt_s / STICK_FILTER_S)
    return _new(np.concatenate([np.zeros((1, 2)), log.flat]), keep) / (1.0 - keep)


def _clear_of_gate(stick: F64, width: int) -> Bool:
    """(n - width,) which steps of a stick (n, 2), averaged over `width`, the round gate had no part in.

    Steps are chosen by where the stick was before: chosen by where it went, those with noise towards the gate would be
    missing.
    """
    radius = np.hypot(*stick.T)
    clear = radius < 1.0 - _HOPS * float(np.median(np.abs(np.diff(radius))))
    stopped = np.concatenate([[0], np.cumsum(radius > _AT_GATE)])
    use: Bool = clear[:-width] & (stopped[width + 1 :] == stopped[: -width - 1])
    return use if float(use.mean()) > _LEAST_SHARE else np.ones(len(use), np.bool_)


@compile_exact_kernel
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


def _errors(signal: F64, stick: F64, use: Bool, dt_s: float) -> F64:
    """Mean square error for each delay in steps, the best gain and bias taken for each; infinite without samples."""
    errors = []
    signals, sticks = np.ascontiguousarray(signal.T), np.ascontiguousarray(stick.T)
    for delay in range(round(_LONGEST_DELAY_S / dt_s) + 1):
        chosen = use[delay:]
        if int(chosen.sum()) < _LEAST_SHARE * len(use):
            errors.append(math.inf)
            continue
        x = np.compress(chosen, signals[:, : len(signal) - delay], axis=1)
        y = np.compress(chosen, sticks[:, delay:], axis=1)
        x -= x.mean(axis=1, keepdims=True)
        y -= y.mean(axis=1, keepdims=True)
        both, of_x, of_y = (np.einsum("an,an->a", *pair) for pair in ((x, y), (x, x), (y, y)))
        errors.append(float((of_y - both**2 / np.maximum(of_x, 1e-12)).sum() / x.shape[1]))
    return np.array(errors)


def _line(signal: F64, stick: F64) -> tuple[F64, F64]:
    """Gain (2,) and shift (2,) of the straight line through samples (n, 2)."""
    middle_x, middle_y = signal.mean(axis=0), stick.mean(axis=0)
    x, y = signal - middle_x, stick - middle_y
    gain: F64 = (x * y).sum(axis=0) / np.maximum((x**2).sum(axis=0), 1e-12)
    return gain, middle_y - gain * middle_x


def _memory(before: F64, after: F64) -> float:
    """How much of a noise (n, 2) is left a step later."""
    return float(np.clip((before * after).sum() / max(float((before**2).sum()), 1e-12), 0.0, _MOST_KEPT))


def _between(values: F64, lowest: int) -> float:
    """Where the parabola through the lowest value and its neighbours has its bottom."""
    if not 0 < lowest < len(values) - 1:
        return float(lowest)
    a, b, c = values[lowest - 1 : lowest + 2].tolist()
    return float(lowest + 0.5 * (a - c) / max(a - 2.0 * b + c, 1e-15))
