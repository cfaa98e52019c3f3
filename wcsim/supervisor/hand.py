"""The user's hand: from what the user wants to where the stick is, a fraction of a second later and not quite there."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from wcsim.supervisor.profiles import UserProfile
from wcsim.types import Joystick

STICK_FILTER_S = 0.02  # first-order low-pass of the joystick's electronics
TREMOR_WANDER = 0.08  # relative frequency change that the tremor's phase picks up ...
TREMOR_WANDER_S = 0.05  # ... in this time
NOISE_BLOCK = 768

# The four switches: stop, forward, left, right.
SWITCH_STOP = Joystick(0.0, 0.0)
SWITCH_FORWARD = Joystick(0.0, 0.6)
SWITCH_TURN = 0.35
PULSE_S = (0.15, 1.0)
STEER_ABOVE = 0.2  # a wish to turn less than this is not worth a switch


class Hand:
    """A hand on a joystick: reaction delay, first-order lag, slow wander, tremor, bias, the electronics' low-pass.

    It runs in continuous time, one call a physics step, because a tremor of 4.5 Hz is near the Nyquist frequency of a
    0.1 s tick. Noise is independent of the step's length (Ornstein-Uhlenbeck and phase diffusion).
    """

    def __init__(self, profile: UserProfile, rng: np.random.Generator) -> None:
        self._profile = profile
        self._rng = rng
        self._wishes = _Delay(profile.reaction_s)
        self._hand = [0.0, 0.0]
        self._wander = [0.0, 0.0]
        self._phase = float(rng.uniform(0.0, 2.0 * math.pi))
        self._stick = [0.0, 0.0]
        self._noise: list[float] = []

    def want(self, wish: Joystick) -> None:
        """Send a new wish on its way to the hand."""
        self._wishes.put(wish)

    def move(self, dt_s: float) -> Joystick:
        """Advance by `dt_s`; the position of the stick then, on the unit disc."""
        p = self._profile
        wish = self._wishes.get(dt_s)
        follow, filtered = _share(dt_s, p.lag_s), _share(dt_s, STICK_FILTER_S)
        keep = math.exp(-p.noise_rate * dt_s)
        kick = p.noise * math.sqrt(1.0 - keep * keep)
        for axis, wanted in enumerate((wish.x, wish.y)):
            self._hand[axis] += follow * (wanted - self._hand[axis])
            self._wander[axis] = keep * self._wander[axis] + kick * self._normal()
        wander_rad = math.tau * p.tremor_hz * TREMOR_WANDER * math.sqrt(dt_s * TREMOR_WANDER_S) * self._normal()
        self._phase = (self._phase + math.tau * p.tremor_hz * dt_s + wander_rad) % math.tau
        shake = (p.tremor * math.sin(self._phase), 0.5 * p.tremor * math.sin(self._phase + 0.7))
        for axis in range(2):
            moved = p.gain[axis] * self._hand[axis] + p.bias[axis] + self._wander[axis] + shake[axis]
            self._stick[axis] += filtered * (moved - self._stick[axis])
        # The round gate stops the stick itself, so the filter's memory must stay on the disc as well.
        self._stick[:] = on_disc(self._stick[0], self._stick[1])
        return Joystick(self._stick[0], self._stick[1])

    def _normal(self) -> float:
        if not self._noise:
            self._noise = self._rng.standard_normal(NOISE_BLOCK).tolist()
        return self._noise.pop()


class SwitchHand:
    """Four switches instead of a stick: forward latches, left and right are pulses as long as the turn needs."""

    def __init__(self, profile: UserProfile) -> None:
        self._wishes = _Delay(profile.reaction_s)
        self._held = SWITCH_STOP
        self._left_s = 0.0

    def want(self, wish: Joystick) -> None:
        """Send a new wish on its way to the switches."""
        self._wishes.put(wish)

    def move(self, dt_s: float) -> Joystick:
        """Advance by `dt_s`; the position that the switches stand for."""
        wish = self._wishes.get(dt_s)
        self._left_s -= dt_s
        if self._left_s <= 0.0:
            self._choose(wish)
        return self._held

    def _choose(self, wish: Joystick) -> None:
        after_turn = self._held.x != 0.0
        if abs(wish.x) > STEER_ABOVE and not after_turn:
            self._held = Joystick(math.copysign(SWITCH_TURN, wish.x), 0.0)
            wanted_s = 0.5 * abs(wish.x) / SWITCH_TURN  # the wish asks for a rate; half a second of it is the turn
            self._left_s = min(max(wanted_s, PULSE_S[0]), PULSE_S[1])
        elif wish.y > 0.1:
            self._held, self._left_s = SWITCH_FORWARD, 0.3
        else:
            self._held, self._left_s = SWITCH_STOP, 0.3


def on_disc(x: float, y: float) -> tuple[float, float]:
    """The nearest position in the joystick's round gate.

    >>> on_disc(3.0, 4.0)
    (0.6, 0.8)
    """
    radius = math.hypot(x, y)
    return (x / radius, y / radius) if radius > 1.0 else (x, y)


class _Delay:
    """Wishes on their way to the muscles."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._now_s = 0.0
        self._queue: deque[tuple[float, Joystick]] = deque()
        self._arrived = Joystick(0.0, 0.0)

    def put(self, wish: Joystick) -> None:
        self._queue.append((self._now_s + self._delay_s, wish))

    def get(self, dt_s: float) -> Joystick:
        self._now_s += dt_s
        while self._queue and self._queue[0][0] <= self._now_s:
            self._arrived = self._queue.popleft()[1]
        return self._arrived


def _share(dt_s: float, time_constant_s: float) -> float:
    return 1.0 - math.exp(-dt_s / max(time_constant_s, 1e-9))
