"""The user's hand: from what the user wants to where the stick is, a fraction of a second later and not quite there.

A hand moves on by a whole tick at a time, in steps as short as those of the physics: nothing that happens within a
tick changes what it does, and a tremor of 4.5 Hz is too near the Nyquist frequency of a 0.1 s tick to be drawn there.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from wcsim.core.jit import exact_kernel
from wcsim.types import F64, Joystick
from wcsim.users.profiles import UserProfile

STICK_FILTER_S = (
    0.02  # first-order low-pass of the joystick's electronics, which every stick has passed
)
TREMOR_WANDER = 0.08  # relative frequency change that the tremor's phase picks up ...
TREMOR_WANDER_S = 0.05  # ... in this time
_TREMOR_AHEAD_RAD = 0.7  # the tremor is an ellipse: forward and back it is half as large, and early
_TREMOR_FORWARD = 0.5

# The four switches: stop, forward, left, right.
_SWITCH_FORWARD_Y = 0.6
_SWITCH_TURN_X = 0.35
SWITCH_POSITIONS = (
    (0.0, 0.0),
    (0.0, _SWITCH_FORWARD_Y),
    (-_SWITCH_TURN_X, 0.0),
    (_SWITCH_TURN_X, 0.0),
)
PULSE_S = (0.15, 1.0)
_PULSE_OF_WISH_S = 0.5  # the wish asks for a turn rate; half a second of it is the turn
STEER_ABOVE = 0.2  # a wish to turn less than this is not worth a switch
DRIVE_ABOVE = 0.1


class Hand:
    """A hand on a joystick: reaction delay, first-order lag, slow wander, tremor, bias, the electronics' low-pass.

    Its noise does not depend on the step's length (Ornstein-Uhlenbeck and phase diffusion).
    """

    def __init__(self, profile: UserProfile, rng: np.random.Generator) -> None:
        self._profile = profile
        self._rng = rng
        self._wishes = _Delay(profile.reaction_s)
        self._state = np.zeros(7)  # that of `_moved`
        self._state[6] = rng.uniform(0.0, 2.0 * math.pi)
        self._steps: tuple[float, F64] = (0.0, np.zeros(0))

    def want(self, wish: Joystick) -> None:
        """Send a new wish on its way to the hand."""
        self._wishes.put(wish)

    def move(self, steps: int, dt_s: float) -> F64:
        """Advance by `steps` steps of `dt_s`; the stick (steps, 2) after each of them, on the unit disc."""
        if self._steps[0] != dt_s:
            self._steps = (dt_s, _coefficients(self._profile, dt_s))
        normals = self._rng.standard_normal((steps, 3))
        return _moved(self._wishes.take(steps, dt_s), normals, self._steps[1], self._state)


class SwitchHand:
    """Four switches instead of a stick: forward latches, left and right are pulses as long as the turn needs."""

    def __init__(self, profile: UserProfile) -> None:
        self._wishes = _Delay(profile.reaction_s)
        self._hold_s = profile.hold_s
        self._held = (0.0, 0.0)
        self._left_s = 0.0

    def want(self, wish: Joystick) -> None:
        """Send a new wish on its way to the switches."""
        self._wishes.put(wish)

    def move(self, steps: int, dt_s: float) -> F64:
        """Advance by `steps` steps of `dt_s`; the positions (steps, 2) that the switches stand for."""
        sticks = np.empty((steps, 2))
        for step, (x, y) in enumerate(self._wishes.take(steps, dt_s).tolist()):
            self._left_s -= dt_s
            if self._left_s <= 1e-9:
                self._choose(x, y)
            sticks[step] = self._held
        return sticks

    def _choose(self, x: float, y: float) -> None:
        after_turn = self._held[0] != 0.0
        if abs(x) > STEER_ABOVE and not after_turn:
            self._held = (math.copysign(_SWITCH_TURN_X, x), 0.0)
            self._left_s = min(
                max(_PULSE_OF_WISH_S * abs(x) / _SWITCH_TURN_X, PULSE_S[0]), PULSE_S[1]
            )
            return
        forward = y > DRIVE_ABOVE
        self._held = (0.0, _SWITCH_FORWARD_Y) if forward else (0.0, 0.0)
        self._left_s = (
            self._hold_s if forward or after_turn else 0.0
        )  # who rests may begin at any time


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
        self._queue: deque[tuple[float, float, float]] = deque()  # when it arrives, x, y
        self._arrived = (0.0, 0.0)

    def put(self, wish: Joystick) -> None:
        self._queue.append((self._now_s + self._delay_s, wish.x, wish.y))

    def take(self, steps: int, dt_s: float) -> F64:
        """Advance; the wish (steps, 2) that the muscles know of after each step."""
        wishes = np.empty((steps, 2))
        wishes[:] = self._arrived
        end_s = self._now_s + steps * dt_s
        while self._queue and self._queue[0][0] <= end_s + 1e-9:
            at_s, x, y = self._queue.popleft()
            first = max(0, math.ceil((at_s - self._now_s) / dt_s - 1e-6) - 1)
            wishes[first:] = self._arrived = (x, y)
        self._now_s = end_s
        return wishes


def _coefficients(p: UserProfile, dt_s: float) -> F64:
    """What a step of `dt_s` needs of a profile (13,); the order is that of `_moved`."""
    keep = math.exp(-p.noise_rate * dt_s)
    turn_rad = math.tau * p.tremor_hz
    return np.array(
        [
            _share(dt_s, p.lag_s),
            _share(dt_s, STICK_FILTER_S),
            keep,
            p.noise * math.sqrt(1.0 - keep * keep),
            turn_rad * dt_s,
            turn_rad * TREMOR_WANDER * math.sqrt(dt_s * TREMOR_WANDER_S),
            p.tremor,
            _TREMOR_FORWARD * p.tremor,
            _TREMOR_AHEAD_RAD,
            *p.gain,
            *p.bias,
        ]
    )


def _share(dt_s: float, time_constant_s: float) -> float:
    return 1.0 - math.exp(-dt_s / max(time_constant_s, 1e-9))


@exact_kernel
def _moved(wishes: F64, normals: F64, c: F64, state: F64) -> F64:
    """The stick (N, 2) after each of N steps; `state` is carried on in place.

    Args:
        wishes: (N, 2) what the muscles are told.
        normals: (N, 3) standard normal numbers: wander x, wander y, tremor.
        c: What a step needs, see `_coefficients`.
        state: (7,) hand x, y, wander x, y, stick x, y, phase of the tremor.
    """
    sticks = np.empty_like(wishes)
    for step in range(len(wishes)):
        state[6] = (state[6] + c[4] + c[5] * normals[step, 2]) % math.tau
        for axis in range(2):
            state[axis] += c[0] * (wishes[step, axis] - state[axis])
            state[2 + axis] = c[2] * state[2 + axis] + c[3] * normals[step, axis]
            shake = c[6 + axis] * math.sin(state[6] + axis * c[8])
            moved = c[9 + axis] * state[axis] + c[11 + axis] + state[2 + axis] + shake
            state[4 + axis] += c[1] * (moved - state[4 + axis])
        # The round gate stops the stick itself, so the filter's memory must stay on the disc as well.
        radius = math.hypot(state[4], state[5])
        if radius > 1.0:
            state[4] /= radius
            state[5] /= radius
        sticks[step, 0] = state[4]
        sticks[step, 1] = state[5]
    return sticks


def in_gate(stick: Joystick) -> Joystick:
    """A stick within its round gate; one that is no number is at rest.

    >>> in_gate(Joystick(0.0, -3.0)), in_gate(Joystick(math.nan, 1.0))
    (Joystick(x=0.0, y=-1.0), Joystick(x=0.0, y=0.0))
    """
    if not (math.isfinite(stick.x) and math.isfinite(stick.y)):
        return Joystick(0.0, 0.0)
    return Joystick(*on_disc(stick.x, stick.y))
