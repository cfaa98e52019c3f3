"""From where the user wants to go to a joystick position: how a practised driver uses this chair's stick."""

from __future__ import annotations

import math

from wcsim.config import ChairConfig
from wcsim.core.frames import wrap
from wcsim.core.joystick import pushed, yaw_rate_limit
from wcsim.types import Joystick
from wcsim.users.avoidance import Body

# Turn rate asked for each radian of heading error, and its largest value: who answers late must steer gently, or the
# chair swings (a delayed integrator is stable for gain * delay < pi / 2; drivers keep well below).
_GAIN_DELAY = 0.6
_GAIN_MAX_PER_S = 1.4
_TURN_MAX_RADPS = 1.0
DRIVE_DELAY_S = 0.1  # of the chair's own drive
TURN_IN_PLACE_RAD = 1.0
_BEHIND_RAD = 2.6  # a goal farther round than this may be taken on either side: keep the side of before


def steer(
    body: Body,
    goal: tuple[float, float],
    speed_mps: float,
    chair: ChairConfig,
    delay_s: float,
    before_x: float,
) -> Joystick:
    """The stick that turns towards `goal` and drives at `speed_mps`, in place when the goal is far off ahead.

    Args:
        body: The chair's middle.
        goal: Point (x, y) in W to drive to.
        speed_mps: Wanted speed when the goal is straight ahead.
        chair: Its limits, and how far a stick must be moved before anything happens: the user has learnt them.
        delay_s: How late the driver's hand answers.
        before_x: The stick's x of the plan before, for goals right behind.
    """
    error = wrap(math.atan2(goal[1] - body.y_m, goal[0] - body.x_m) - body.yaw_rad)
    if abs(error) > _BEHIND_RAD and before_x * error > 0.0:
        error = -error
    turning = abs(error) > TURN_IN_PLACE_RAD
    speed = 0.0 if turning else speed_mps * math.cos(error) ** 2
    w_limit = yaw_rate_limit(max(abs(body.speed_mps), speed), chair.yaw_rate_max_radps)
    gain = min(_GAIN_MAX_PER_S, _GAIN_DELAY / (delay_s + DRIVE_DELAY_S))
    most = min(1.0, min(_TURN_MAX_RADPS, _GAIN_DELAY / (delay_s + DRIVE_DELAY_S)) / w_limit)
    x = min(most, max(-most, -gain * error / w_limit))
    y = min(speed / chair.v_max_mps, math.sqrt(1.0 - x * x))
    radius = math.hypot(x, y)
    if radius < 0.02:
        return Joystick(0.0, 0.0)
    scale = pushed(radius, chair) / radius
    return Joystick(x * scale, y * scale)


def stopping_speed(distance_m: float, brake_mps2: float) -> float:
    """The speed from which braking at `brake_mps2` stops within `distance_m`; 0 when it is passed already."""
    return math.sqrt(2.0 * brake_mps2 * max(0.0, distance_m))
