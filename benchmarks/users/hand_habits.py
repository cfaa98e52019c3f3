"""What a hand does, read off its stick and its intents alone: tremor, pauses, how long switches are held.

Nothing here knows how the user model works inside: tremor comes from a spectrum, looks elsewhere from intents that do
not move.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wcsim.types import F64
from wcsim.users.hand import STICK_FILTER_S

_TREMOR_BAND_HZ = (2.5, 8.0)
_TREMOR_HALF_WIDTH_HZ = 1.2
_SEGMENT_S = 6.0


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
class Tremor:
    """The strongest oscillation of the stick to the sides."""

    hz: float
    amplitude: float  # before the electronics


@dataclass(frozen=True, slots=True, kw_only=True)
class Pauses:
    """Stretches in which nobody corrected an intent though the chair was driven."""

    still: int  # ticks in them
    driven: int  # ticks in which there might have been one
    ended: int  # stretches that ended with a correction


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


def pauses(intents: F64) -> Pauses:
    """Stretches in which an intent (N, 2) that drives forward only let go of the steering, if anything.

    Rest, backing up and turns on the spot are no samples: there an intent stands still, or its turn fades out, while
    its user looks on. A stretch that lasts until the log's end was cut off and has not ended.
    """
    driven = intents[1:, 1] > 0.0
    still = (np.diff(intents[:, 1]) == 0.0) & (np.diff(np.abs(intents[:, 0])) <= 0.0) & driven
    ended = still[:-1] & ~still[1:]
    return Pauses(still=int(still.sum()), driven=int(driven.sum()), ended=int(ended.sum()))


def switch_holds(sticks: F64, dt_s: float) -> tuple[F64, F64]:
    """How long switches (n, 2) were held, seconds: turns, and forward or stop between two turns."""
    changes = np.flatnonzero((np.diff(sticks, axis=0) != 0.0).any(axis=1)) + 1
    spans = np.diff(changes) * dt_s
    turning = sticks[changes[:-1], 0] != 0.0 if len(changes) else np.zeros(0, np.bool_)
    between = ~turning[1:-1] & turning[:-2] & turning[2:] if len(turning) > 2 else np.zeros(0, np.bool_)
    return spans[turning], spans[1:-1][between] if len(spans) > 2 else np.zeros(0)
