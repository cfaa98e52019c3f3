"""The baseline `dwa`: a dynamic-window shared controller that sees the depth image, the tilt and the joystick alone.

Every joystick position of the action set is an arc within the reach of the drive. One that could not be held for half
a second and then braked before it meets something seen (a wall, a person, a kerb, a drop) is out; of the others the
one nearest to the user's stick wins, pushed away from what it would pass closely. The chair's speed is not in the
observation: it is reckoned from what was commanded, and so is the way since something was seen.
"""

from __future__ import annotations

import math

import numpy as np

from wcsim.agents.policies.depth_check import depth_metres, viewing_rays
from wcsim.agents.policies.elevation_map import CELL_M, REACH_M, StepMap
from wcsim.agents.policy_api import DEPTH_KEY, IMU_KEY, JOYSTICK_KEY, Observation
from wcsim.config import CameraConfig, ChairConfig
from wcsim.core.frames import rad
from wcsim.core.jit import exact_kernel
from wcsim.core.joystick import driven, limits_of, shaped_rows
from wcsim.supervisor.actions import ActionSet
from wcsim.types import F32, F64, Outline

HOLD_S, STEP_S, LONGEST_S = 0.5, 0.1, 3.0
MARGIN_M = 0.07  # kept all around: half a cell, and what the reckoning is off
_CLOSER_M = 0.02  # who is nearer than the margin already may get no nearer than this
COMFORT_M = 0.25  # passing closer than this costs up to _COMFORT_COST
_COMFORT_COST = 0.15  # joystick distance, less than the 0.1768 that still counts as following
KEEP_S = 3.0  # what was seen is remembered for so long
_FORGET_M = 3.0  # and within this distance
_BLIND_M = 1.3  # nearer than this on the ground, the camera does not look over its own footplate


class DynamicWindow:
    """Chooses actions; remembers for a few seconds what it saw, and how it drives.

    Args:
        actions: The joystick positions to choose from.
        camera: Whose depth image is seen.
        chair: Limits of the drive.
        outline: The box around the chair and its user.
        tick_s: Time between two actions.
    """

    name = "dwa"

    def __init__(
        self, actions: ActionSet, camera: CameraConfig, chair: ChairConfig, outline: Outline, tick_s: float
    ) -> None:
        half_m = 0.5 * outline.length_m
        self._box_B_m = np.array([outline.middle_x_m - half_m, outline.middle_x_m + half_m, 0.5 * outline.width_m])
        self._actions, self._range_m, self._near_m, self._tick_s = actions, camera.range_m, camera.near_m, tick_s
        self._stride = max(1, round(camera.width_px / 160))
        size = (camera.height_px, camera.width_px, 3)
        rays = viewing_rays(camera).reshape(size)[:: self._stride, :: self._stride]
        self._rays = np.ascontiguousarray(rays.reshape(-1, 3), np.float32)
        self._shape = size[:2]
        self._eye_B_m = np.array(camera.p_BC_m, np.float64)
        self._ahead_rad, self._half_rad = rad(camera.yaw_deg), 0.5 * rad(camera.hfov_deg)
        self._map = StepMap()
        self._commands = shaped_rows(actions.points, chair)
        self._limits = limits_of(chair)
        self.reset()

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self._motion = np.zeros(3)  # v, w, acceleration, as reckoned
        self._seen_B_m = np.zeros((0, 2))
        self._age_s = np.zeros(0)

    def act(self, observation: Observation) -> int:
        """The action nearest to the user's stick that can be braked in time, with some room on its sides."""
        self._look(observation)
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        gap_m = np.empty(len(self._actions))
        arcs(self._motion, self._commands, self._limits, self._box_B_m, self._seen_B_m, gap_m)
        now_m = rectangle_gap(0.0, 0.0, 0.0, self._box_B_m, self._seen_B_m)
        allowed_m = min(MARGIN_M, now_m - _CLOSER_M)
        free = gap_m > allowed_m
        if free.any():
            cost = self._actions.distances(stick[None])[0]
            cost += _COMFORT_COST * np.clip((COMFORT_M - gap_m) / COMFORT_M, 0.0, 1.0)
            choice = int(np.argmin(np.where(free, cost, np.inf)))
        else:
            choice = self._actions.nearest((0.0, 0.0))
        self._reckon(choice)
        return choice

    def _look(self, observation: Observation) -> None:
        """Put what is seen now in the place of what is remembered of the same part of the street."""
        image = depth_metres(observation[DEPTH_KEY], self._range_m).reshape(self._shape)
        depth_m = np.ascontiguousarray(image[:: self._stride, :: self._stride]).reshape(-1)
        span_m = (1.02 * self._near_m, 0.99 * self._range_m)
        now = self._map.obstacles(depth_m, self._rays, self._eye_B_m, span_m, up_in_body(observation[IMU_KEY]))
        old, away = self._seen_B_m, np.hypot(*(self._seen_B_m - self._eye_B_m[:2]).T)
        bearing = np.arctan2(old[:, 1] - self._eye_B_m[1], old[:, 0] - self._eye_B_m[0]) - self._ahead_rad
        in_view = (np.abs(np.arctan2(np.sin(bearing), np.cos(bearing))) < self._half_rad) & (old[:, 0] > _BLIND_M)
        kept = ~in_view & (away < _FORGET_M) & (self._age_s < KEEP_S)
        near = now[np.hypot(now[:, 0], now[:, 1]) < REACH_M - CELL_M]
        self._seen_B_m = np.concatenate([near, old[kept]])
        self._age_s = np.concatenate([np.zeros(len(near)), self._age_s[kept]])

    def _reckon(self, choice: int) -> None:
        """Move on by a tick: speed and turn as the drive's limits let them, and what was seen the other way round."""
        before = self._motion.copy()
        follow(self._motion, self._commands[choice], self._limits, self._tick_s)
        way_m = 0.5 * (before[0] + self._motion[0]) * self._tick_s
        turn = 0.5 * (before[1] + self._motion[1]) * self._tick_s
        moved = self._seen_B_m - way_m * np.array([math.cos(0.5 * turn), math.sin(0.5 * turn)])
        cos, sin = math.cos(turn), math.sin(turn)
        self._seen_B_m = moved @ np.array([[cos, -sin], [sin, cos]])
        self._age_s = self._age_s + self._tick_s


def up_in_body(imu: F32) -> F64:
    """The direction up in B, (3,), from the tilt in an observation's IMU vector."""
    roll, pitch = math.pi * float(imu[3]), 0.5 * math.pi * float(imu[4])
    return np.array([math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)])


@exact_kernel
def follow(motion: F64, command: F64, limits: F64, dt_s: float) -> None:
    """Move `motion` (3,) v, w, acceleration on by `dt_s` towards a command (2,), within the drive's limits (7,)."""
    motion[0], motion[1], motion[2] = driven(motion[0], motion[1], motion[2], command[0], command[1], limits, dt_s)


@exact_kernel
def arcs(motion: F64, commands: F64, limits: F64, box: F64, points: F64, gap_m: F64) -> None:
    """Hold each command for HOLD_S, then brake to a stop; `gap_m` (K,) becomes the least distance to what is there.

    Args:
        motion: (3,) speed, turn rate, acceleration now.
        commands: (K, 2) joystick positions as the drive takes them.
        limits: (7,) of the drive.
        box: (3,) rear, front, half the width of the chair in B.
        points: (n, 2) what is in the way, in B.
        gap_m: Written; 0 means touched, which ends the arc, infinity that there is nothing.
    """
    now = np.empty(3)
    rest = np.zeros(2)
    for k in range(len(commands)):
        now[:] = motion
        x, y, yaw, gap = 0.0, 0.0, 0.0, np.inf
        for i in range(int(LONGEST_S / STEP_S) + 1):
            gap = min(gap, rectangle_gap(x, y, yaw, box, points))
            held = i * STEP_S < HOLD_S - 1e-9
            if gap <= 0.0 or (not held and now[0] == 0.0 and abs(now[1]) < 1e-3):
                break
            v, w = now[0], now[1]
            if held:
                follow(now, commands[k], limits, STEP_S)
            else:
                follow(now, rest, limits, STEP_S)
            turn = 0.5 * (w + now[1]) * STEP_S
            way = 0.5 * (v + now[0]) * STEP_S
            x += way * math.cos(yaw + 0.5 * turn)
            y += way * math.sin(yaw + 0.5 * turn)
            yaw += turn
        gap_m[k] = gap


@exact_kernel
def rectangle_gap(x: float, y: float, yaw: float, box: F64, points: F64) -> float:
    """Distance from the chair at a pose to the nearest of `points` (n, 2), 0 inside it; `box`: see `arcs`."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    middle, half = 0.5 * (box[0] + box[1]), 0.5 * (box[1] - box[0])
    least = np.inf
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        ahead = max(abs(dx * cos + dy * sin - middle) - half, 0.0)
        aside = max(abs(dy * cos - dx * sin) - box[2], 0.0)
        least = min(least, ahead * ahead + aside * aside)
    return math.sqrt(least)
