"""The user's hand: from the intent to the stick, a fraction of a second later and not quite there.

A hand moves on by a whole tick at a time, in steps as short as those of the physics. Nothing that
happens within a tick changes what it does. A tremor of 4.5 Hz is too near the Nyquist frequency of
a tick of 0.1 s to be drawn there.
"""

import math
from collections import deque
from typing import Final

import numpy as np

from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F64, Joystick
from wcsim.types.chair import AT_REST
from wcsim.users.profiles import UserProfile

# First-order low-pass of the joystick's electronics, which every stick has passed.
STICK_FILTER_S: Final = 0.02
# The phase of the tremor diffuses by this relative change of its frequency in this time.
TREMOR_WANDER: Final = 0.08
TREMOR_WANDER_S: Final = 0.05
# The tremor is an ellipse: forward and back it is half as large as to the side, and early.
TREMOR_FORWARD: Final = 0.5
_TREMOR_AHEAD_RAD: Final = 0.7

_SWITCH_FORWARD_Y: Final = 0.6
_SWITCH_TURN_X: Final = 0.35
SWITCH_POSITIONS: Final = (  # stop, forward, left, right
    (0.0, 0.0),
    (0.0, _SWITCH_FORWARD_Y),
    (-_SWITCH_TURN_X, 0.0),
    (_SWITCH_TURN_X, 0.0),
)
PULSE_S: Final = (0.15, 1.0)
# The intent is a turn rate. Half a second of it is the turn that a pulse makes.
_PULSE_OF_INTENT_S: Final = 0.5
STEER_ABOVE: Final = 0.2  # an intent to turn less than this is not worth a switch
DRIVE_ABOVE: Final = 0.1


class StickHandModel:
    """A hand on a joystick: reaction delay, lag, slow wander, tremor, bias, the stick's low-pass.

    Its noise does not depend on the step's length (Ornstein-Uhlenbeck and phase diffusion).
    """

    def __init__(self, profile: UserProfile, rng: np.random.Generator) -> None:
        """A hand at rest; it draws the phase of the tremor."""
        self._profile = profile
        self._rng = rng
        self._delay = _Delay(profile.reaction_s)
        self._state = np.zeros(7)  # that of `_move`
        self._state[6] = rng.uniform(0.0, 2.0 * math.pi)
        self._step_s = 0.0  # for which there are coefficients
        self._coefficients = np.zeros(0)

    def send_intent(self, intent: Joystick) -> None:
        """Send a new intent on its way to the hand."""
        self._delay.put(intent)

    def move(self, steps: int, dt_s: float) -> F64:
        """Advance by `steps` steps of `dt_s`; the stick (steps, 2) after each, on the unit disc."""
        if self._step_s != dt_s:
            self._step_s = dt_s
            self._coefficients = _coefficients(self._profile, dt_s)
        normals = self._rng.standard_normal((steps, 3))
        return _move(self._delay.advance(steps, dt_s), normals, self._coefficients, self._state)


class SwitchHandModel:
    """Four switches instead of a stick: forward latches, left and right are pulses.

    A pulse lasts as long as the turn needs.
    """

    def __init__(self, profile: UserProfile) -> None:
        self._delay = _Delay(profile.reaction_s)
        self._hold_s = profile.hold_s
        self._held = (0.0, 0.0)
        self._remaining_s = 0.0

    def send_intent(self, intent: Joystick) -> None:
        """Send a new intent on its way to the switches."""
        self._delay.put(intent)

    def move(self, steps: int, dt_s: float) -> F64:
        """Advance by `steps` steps of `dt_s`; the positions (steps, 2) of the switches."""
        sticks = np.empty((steps, 2))
        for step, (x, y) in enumerate(self._delay.advance(steps, dt_s).tolist()):
            self._remaining_s -= dt_s
            if self._remaining_s <= 1e-9:
                self._press(x, y)
            sticks[step] = self._held
        return sticks

    def _press(self, x: float, y: float) -> None:
        """Set the switch for an intent, and how long it is held at least."""
        after_turn = self._held[0] != 0.0
        if abs(x) > STEER_ABOVE and not after_turn:
            self._held = (math.copysign(_SWITCH_TURN_X, x), 0.0)
            pulse_s = _PULSE_OF_INTENT_S * abs(x) / _SWITCH_TURN_X
            self._remaining_s = min(max(pulse_s, PULSE_S[0]), PULSE_S[1])
            return
        forward = y > DRIVE_ABOVE
        self._held = (0.0, _SWITCH_FORWARD_Y) if forward else (0.0, 0.0)
        # A user at rest may start at any time.
        self._remaining_s = self._hold_s if forward or after_turn else 0.0


def clip_to_disc(x: float, y: float) -> tuple[float, float]:
    """The nearest position in the joystick's round gate.

    >>> clip_to_disc(3.0, 4.0)
    (0.6, 0.8)
    """
    radius = math.hypot(x, y)
    return (x / radius, y / radius) if radius > 1.0 else (x, y)


def clip_stick_to_gate(stick: Joystick) -> Joystick:
    """A stick within its round gate; one that is not finite is at rest.

    >>> clip_stick_to_gate(Joystick(0.0, -3.0)), clip_stick_to_gate(Joystick(math.nan, 1.0))
    (Joystick(x=0.0, y=-1.0), Joystick(x=0.0, y=0.0))
    """
    if not (math.isfinite(stick.x) and math.isfinite(stick.y)):
        return AT_REST
    return Joystick(*clip_to_disc(stick.x, stick.y))


class _Delay:
    """Intents on their way to the muscles."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._now_s = 0.0
        self._queue: deque[tuple[float, float, float]] = deque()  # when it arrives, x, y
        self._arrived = (0.0, 0.0)

    def put(self, intent: Joystick) -> None:
        self._queue.append((self._now_s + self._delay_s, intent.x, intent.y))

    def advance(self, steps: int, dt_s: float) -> F64:
        """Advance the time; the intent (steps, 2) that the muscles know of after each step."""
        intents = np.empty((steps, 2))
        intents[:] = self._arrived
        end_s = self._now_s + steps * dt_s
        while self._queue and self._queue[0][0] <= end_s + 1e-9:
            at_s, x, y = self._queue.popleft()
            first = max(0, math.ceil((at_s - self._now_s) / dt_s - 1e-6) - 1)
            intents[first:] = self._arrived = (x, y)
        self._now_s = end_s
        return intents


def _coefficients(p: UserProfile, dt_s: float) -> F64:
    """What a step of `dt_s` needs of a profile (13,); the order is that of `_move`."""
    decay = math.exp(-p.noise_rate * dt_s)
    turn_rad = math.tau * p.tremor_hz
    return np.array(
        [
            _filter_share(dt_s, p.lag_s),
            _filter_share(dt_s, STICK_FILTER_S),
            decay,
            p.noise * math.sqrt(1.0 - decay * decay),
            turn_rad * dt_s,
            turn_rad * TREMOR_WANDER * math.sqrt(dt_s * TREMOR_WANDER_S),
            p.tremor,
            TREMOR_FORWARD * p.tremor,
            _TREMOR_AHEAD_RAD,
            *p.gain,
            *p.bias,
        ]
    )


def _filter_share(dt_s: float, time_constant_s: float) -> float:
    return 1.0 - math.exp(-dt_s / max(time_constant_s, 1e-9))


@compile_exact_kernel
def _move(intents: F64, normals: F64, c: F64, state: F64) -> F64:
    """The stick (N, 2) after each of N steps; `state` is carried on in place.

    Args:
        intents: (N, 2) what the muscles know of.
        normals: (N, 3) standard normal numbers: wander x, wander y, tremor.
        c: What a step needs, see `_coefficients`.
        state: (7,) hand x, y, wander x, y, stick x, y, phase of the tremor.
    """
    sticks = np.empty_like(intents)
    for step in range(len(intents)):
        state[6] = (state[6] + c[4] + c[5] * normals[step, 2]) % math.tau
        for axis in range(2):
            state[axis] += c[0] * (intents[step, axis] - state[axis])
            state[2 + axis] = c[2] * state[2 + axis] + c[3] * normals[step, axis]
            shake = c[6 + axis] * math.sin(state[6] + axis * c[8])
            moved = c[9 + axis] * state[axis] + c[11 + axis] + state[2 + axis] + shake
            state[4 + axis] += c[1] * (moved - state[4 + axis])
        # The round gate stops the stick itself, so the filter's memory must stay on the disc too.
        radius = math.hypot(state[4], state[5])
        if radius > 1.0:
            state[4] /= radius
            state[5] /= radius
        sticks[step, 0] = state[4]
        sticks[step, 1] = state[5]
    return sticks
