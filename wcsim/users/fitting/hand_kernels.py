"""What the likelihood of a hand is made of: the wish on its way to the stick, and how new each sample of it is."""

from __future__ import annotations

import math

import numpy as np

from wcsim.core.jit import exact_kernel
from wcsim.types import F64, Bool

# the noise of a hand (6,)
STEP_S, NOISE, RATE, TREMOR, TURN_RAD, FADING = range(6)
# a hand's line (4,)
GAIN_X, GAIN_Y, BIAS_X, BIAS_Y = range(4)
_SEEN = 1e-6  # variance of what a sample adds of its own
_FORWARD = 0.5  # the tremor forward, as a share of that to the side


@exact_kernel
def wish_on_its_way(intents: F64, steps: int, dt_s: float, delay_s: float, lag_s: float, filter_s: float) -> F64:
    """The hand (N * steps, 2) without noise: intents (N, 2), one a tick, after delay, lag and the joystick's low-pass.

    A wish counts in part around the step in which it arrives, so that the result changes smoothly with the delay.
    """
    ticks = len(intents)
    out = np.zeros((ticks * steps, 2))
    share = 1.0 - math.exp(-dt_s / max(lag_s, 1e-9))
    filtered = 1.0 if filter_s <= 0.0 else 1.0 - math.exp(-dt_s / filter_s)
    state, stick = np.zeros(2), np.zeros(2)
    for k in range(ticks * steps):
        at = ((k + 1.5) * dt_s - delay_s) / (steps * dt_s)  # a hand heeds what comes within a step in all of it
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
def surprises(hand: F64, wish: F64, free: Bool, noise: F64, line: F64, counted: Bool, clear: Bool) -> F64:
    """How unlikely each sample (n,) of a hand is after those before it: minus the logarithm of its density.

    The noise is an Ornstein-Uhlenbeck process on each axis, and a tremor whose phase wanders; both are followed by a
    Kalman filter. A sample at the gate is not known: it changes nothing, and the first one after it counts for nothing.

    Args:
        hand: (n, 2) the samples.
        wish: (n, 2) what `wish_on_its_way` makes of the intents.
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
        p[axis, 1, 1] = p[axis, 2, 2] = 0.5 * (noise[TREMOR] * (1.0 if axis == 0 else _FORWARD)) ** 2
    for k in range(n):
        for axis in range(2):
            a, b, c = x[axis, 0], x[axis, 1], x[axis, 2]
            x[axis, 0], x[axis, 1], x[axis, 2] = keep * a, cos * b - sin * c, sin * b + cos * c
            _grow(p[axis], keep, cos, sin)
            shake = 0.5 * (noise[TREMOR] * (1.0 if axis == 0 else _FORWARD)) ** 2 * (1.0 - noise[FADING] ** 2)
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
