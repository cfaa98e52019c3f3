"""The baseline `dwa`: a dynamic-window shared controller that sees what a chair senses, and the user's joystick.

Every joystick position of the action set is an arc within the reach of the drive. One that could not be held for 0.3 s
and then braked before it meets something that it knows of (a wall, a person, a kerb, a drop) is out; of the others the
one nearest to the user's stick wins, pushed away from what it would pass closely. Arcs begin where the commands that
are on their way will have brought the chair.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wcsim.agents.policies.baseline_names import USUAL_LEVEL
from wcsim.agents.policies.depth_check import depth_metres, viewing_rays
from wcsim.agents.policies.dynamic_window.arcs import after, arcs, touches_after
from wcsim.agents.policies.dynamic_window.backing import backs_blindly
from wcsim.agents.policies.dynamic_window.clusters import beside_movers, find_clusters, kinds
from wcsim.agents.policies.dynamic_window.edges import carry_on
from wcsim.agents.policies.dynamic_window.ego_motion import EgoMotion, in_body, in_odometric
from wcsim.agents.policies.dynamic_window.street_memory import StreetMemory
from wcsim.agents.policies.dynamic_window.tracker import Mover, Tracker
from wcsim.agents.policies.elevation_map import CELL_M, REACH_M, StepMap
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, GYRO, IMU_KEY, JOYSTICK_KEY, Observation
from wcsim.config import RunConfig
from wcsim.core.joystick import limits_of, shaped_rows
from wcsim.supervisor.actions import ActionSet
from wcsim.types import F32, F64, Outline

_SHY_M = 0.06  # more than from a wall: who moves is wider than what is seen, and may do otherwise
_COMFORT_COST = 0.15  # joystick distance, less than the 0.1768 that still counts as following
WARN_S = 2.0  # of what the user's stick would meet so soon
_WARN_MARGIN_M = 0.03
_AHEAD_MPS = 0.05  # slower is no driving ahead
_MOST_CARRIED, _MOST_CELLS = 96, 1024  # places of edges that go on, cells of those who could move


@dataclass(frozen=True, slots=True, kw_only=True)
class Caution:
    """How early, and how widely, a driver is kept from what is in the way."""

    hold_s: float = 0.3  # each joystick position is held for so long before it is braked
    margin_m: float = 0.07  # kept all around: half a cell, and what the reckoning is off
    comfort_m: float = 0.25  # passing closer than this costs up to _COMFORT_COST


LAST_MOMENT = Caution(hold_s=0.1, margin_m=0.03, comfort_m=0.1)
EARLY = Caution(hold_s=1.0, margin_m=0.2, comfort_m=0.5)


def caution(level: float) -> Caution:
    """That of a level of assistance from 0 (LAST_MOMENT) over 1 (the usual one) to 2 (EARLY)."""
    low, high, share = (LAST_MOMENT, Caution(), level) if level < 1.0 else (Caution(), EARLY, level - 1.0)
    mixed = {key: (1.0 - share) * getattr(low, key) + share * getattr(high, key) for key in Caution.__slots__}
    return Caution(**mixed)


class DynamicWindow:
    """Chooses actions; remembers the street around it, who moves there, and how it drives.

    Args:
        name: What it is called.
        config: Of the run: its first camera is seen, and its chair driven.
        actions: The joystick positions to choose from.
        outline: The box around the chair and its user.
        level: Of assistance, see `caution`.
    """

    senses = ("odometry", GYRO)

    def __init__(
        self, name: str, config: RunConfig, actions: ActionSet, outline: Outline, level: float = USUAL_LEVEL
    ) -> None:
        self.name, self.warning = name, False
        self._caution = caution(level)
        camera, self._chair, self._tick_s = config.cameras[0], config.chair, config.world.tick_s
        half_m = 0.5 * outline.length_m
        self._box_B_m = np.array([outline.middle_x_m - half_m, outline.middle_x_m + half_m, 0.5 * outline.width_m])
        self._actions, self._range_m, self._near_m = actions, camera.range_m, camera.near_m
        self._stride = max(1, round(camera.width_px / 160))
        size = (camera.height_px, camera.width_px, 3)
        rays = viewing_rays(camera).reshape(size)[:: self._stride, :: self._stride]
        self._rays = np.ascontiguousarray(rays.reshape(-1, 3), np.float32)
        self._shape = size[:2]
        self._eye_B_m = np.array(camera.p_BC_m, np.float64)
        self._map = StepMap()
        self._commands = shaped_rows(actions.points, self._chair)
        self._limits = limits_of(self._chair)
        self._ego = EgoMotion(self._limits, self._tick_s, config.world.action_delay_ticks)
        self._memory, self._tracker = StreetMemory(self._tick_s, self._box_B_m), Tracker(self._tick_s)
        self._carried_B_m = np.empty((_MOST_CARRIED, 2))
        self._kinds = kinds()
        self._cells_B_m, self._owner = np.empty((_MOST_CELLS, 2)), np.empty(_MOST_CELLS, np.int64)
        self.reset()

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self._ego.reset()
        self._memory.forget()
        self._tracker.forget()
        self.warning = False

    def act(self, observation: Observation) -> int:
        """The action nearest to the user's stick that can be braked in time, with some room on its sides."""
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        self._ego.observe(observation, shaped_rows(stick[None], self._chair)[0])
        self._look(observation)
        points = self._in_the_way()
        waiting = self._ego.waiting
        start = after(self._ego.motion, waiting, self._limits, self._tick_s)
        later_s = len(waiting) * self._tick_s
        self.warning = self._meets(stick, start, later_s, points)
        choice = self._choose(stick, start, later_s, points)
        self._ego.command(self._commands[choice])
        return choice

    def _meets(self, stick: F64, start: F64, later_s: float, points: F64) -> bool:
        """Whether the user's stick, held, would meet something soon."""
        (shaped,) = shaped_rows(stick[None], self._chair)
        box = self._box_B_m
        return math.isfinite(touches_after(start, later_s, shaped, self._limits, box, points, _WARN_MARGIN_M, WARN_S))

    def _choose(self, stick: F64, start: F64, later_s: float, points: F64) -> int:
        """The action that begins at `start` (6,), with `points` (n, 5) in the way, see `arcs`."""
        care, box, pose = self._caution, self._box_B_m, self._ego.pose_O
        gap_m, blind = np.empty(len(self._actions)), np.empty(len(self._actions), np.bool_)
        free = arcs(start, later_s, care.hold_s, self._commands, self._limits, box, points, gap_m)
        backs_blindly(start, care.hold_s, self._commands, self._limits, box, self._memory.cells, pose, blind)
        free &= ~blind
        if not free.any():
            return self._actions.nearest((0.0, 0.0))
        cost = self._actions.distances(stick[None])[0]
        cost += _COMFORT_COST * np.clip((care.comfort_m - gap_m) / care.comfort_m, 0.0, 1.0)
        return int(np.argmin(np.where(free, cost, np.inf)))

    def _in_the_way(self) -> F64:
        """What is known to be in the way, (n, 5): place in B, speed over the ground, distance to keep."""
        pose, margin_m = self._ego.pose_O, self._caution.margin_m
        seen = self._memory.points_B_m(pose, self._ego.way_m)
        more = self._carried_B_m[: carry_on(seen, self._memory.cells, pose, self._carried_B_m)]
        others = np.concatenate([np.zeros((0, 2)), *(in_body(who.cells_O_m, pose) for who in self._others())])
        still = np.zeros((len(seen) + len(more), 5))
        still[:, :2] = np.concatenate([seen, more])
        still[:, 4] = margin_m
        still[: len(seen), 4] += _SHY_M * beside_movers(seen, others)
        return np.concatenate([still, *(self._moving(who) for who in self._tracker.movers if who.rushes)])

    def _others(self) -> list[Mover]:
        """Whoever is no vehicle that stands."""
        return [who for who in self._tracker.movers if who.walks or who.moves]

    def _moving(self, who: Mover) -> F64:
        """Somebody who moves, (n, 5); whoever should be inside the chair by now went another way."""
        yaw, (rear, front, half) = self._ego.pose_O[2], self._box_B_m
        cells = in_body(who.cells_O_m, self._ego.pose_O)
        outside = (cells[:, 0] < rear) | (cells[:, 0] > front) | (np.abs(cells[:, 1]) > half)
        rows = np.empty((len(cells), 5))
        rows[:, :2] = cells
        rows[:, 2:4] = in_body(who.v_O_mps[None], np.array([0.0, 0.0, yaw]))
        rows[:, 4] = self._caution.margin_m + _SHY_M
        still_there: F64 = rows[outside]
        return still_there

    def _look(self, observation: Observation) -> None:
        """Take in what is seen now: who could move, and what is in the way."""
        image = depth_metres(observation[DEPTH_KEY], self._range_m).reshape(self._shape)
        depth_m = np.ascontiguousarray(image[:: self._stride, :: self._stride]).reshape(-1)
        up, pose = up_in_body(observation[IMU_KEY]), self._ego.pose_O
        walkers = self._watch(observation, depth_m, up)
        span_m = (1.02 * self._near_m, 0.99 * self._range_m)
        now = self._map.obstacles(depth_m, self._rays, self._eye_B_m, span_m, up)
        near = now[np.hypot(now[:, 0], now[:, 1]) < REACH_M - CELL_M]
        ego, ahead = self._ego, bool(self._ego.motion[0] > _AHEAD_MPS)
        self._memory.see(near, beside_movers(near, walkers), self._map.low_m, pose, ego.way_m, ahead=ahead)

    def _watch(self, observation: Observation, depth_m: F32, up: F64) -> F64:
        """Follow those who could move; cells (n, 2) in B of all but the vehicles that stand."""
        if CLASS_KEY not in observation or observation[CLASS_KEY].dtype != np.uint8:
            return np.zeros((0, 2))
        kind = np.ascontiguousarray(self._kinds[observation[CLASS_KEY][-1]][:: self._stride, :: self._stride])
        pose, far_m = self._ego.pose_O, 0.99 * self._range_m
        clusters, count = find_clusters(
            kind, depth_m, self._rays, self._eye_B_m, far_m, up, pose, self._cells_B_m, self._owner
        )
        cells, owner = self._cells_B_m[:count], self._owner[:count]
        each = [cells[owner == number] for number in range(len(clusters))]
        self._tracker.see(clusters, [in_odometric(own, pose) for own in each])
        seen = [in_body(who.cells_O_m, pose) for who in self._others() if who.unseen_s == 0.0]
        return np.concatenate([np.zeros((0, 2)), *seen])


def up_in_body(imu: F32) -> F64:
    """The direction up in B, (3,), from the tilt in an observation's IMU vector."""
    roll, pitch = np.pi * float(imu[3]), 0.5 * np.pi * float(imu[4])
    return np.array([np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
