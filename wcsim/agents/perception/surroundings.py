"""What a chair knows of the street from its senses: where it is, what stands around it, who moves, and how.

Walls and kerbs go on: a straight edge that is seen ahead is carried on beside the chair, where it does not look.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from wcsim.agents.perception.arcs import after
from wcsim.agents.perception.clusters import beside_movers, find_clusters, kinds
from wcsim.agents.perception.depth_image import depth_metres, viewing_rays
from wcsim.agents.perception.ego_motion import EgoMotion, in_body, in_odometric
from wcsim.agents.perception.street_memory import CELL_M, REACH_M, StepMap, StreetMemory, is_ground
from wcsim.agents.perception.tracker import Mover, Tracker
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, IMU_KEY, JOYSTICK_KEY, Observation
from wcsim.config import CameraConfig, RunConfig
from wcsim.core.jit import exact_kernel
from wcsim.core.joystick import limits_of, shaped_rows
from wcsim.supervisor.actions import ActionSet
from wcsim.types import F32, F64, I64, U8, Outline

BACK_M = -1.2  # an edge is carried on as far as this, behind the axle
_NEAREST_M, _FARTHEST_M, _ASIDE_M = (
    0.5,
    3.2,
    1.4,
)  # where edges are looked for: ahead, and to each side
_OFF_M = 0.08  # a point so far from a line is on it
_APART_M, _LONG_M = 0.7, 1.0  # points that make a line, and how long it must be
_STEEPEST = 0.5  # aside per metre ahead
_FEWEST, _MOST = 8, 48


@exact_kernel
def _carry_on(points: F64, cells: I64, pose_O: F64, added: F64) -> int:
    """Carry on the longest straight edge on either side, over what was never seen.

    Args:
        points: (n, 2) what is in the way, in B.
        cells: Of `StreetMemory`.
        pose_O: (3,) of the chair.
        added: (m, 2) written: the places that may be in the way, in B.

    Returns:
        How many were written.
    """
    count = 0
    near = np.empty((_MOST, 2))
    cos, sin = math.cos(pose_O[2]), math.sin(pose_O[2])
    for side in (-1.0, 1.0):
        found = _beside(points, side, near)
        aside, slope, begins = _line(near[:found])
        if math.isinf(begins):
            continue
        x = begins - CELL_M
        while x > BACK_M and count < len(added):
            y = aside + slope * x
            x_O_m, y_O_m = pose_O[0] + cos * x - sin * y, pose_O[1] + sin * x + cos * y
            if y * side > 0.0 and not is_ground(cells, x_O_m, y_O_m):
                added[count, 0], added[count, 1] = x, y
                count += 1
            x -= CELL_M
    return count


@exact_kernel
def _beside(points: F64, side: float, near: F64) -> int:
    """Gather the points ahead on one side; every second one, and so on, when there are too many."""
    total = 0
    for n in range(len(points)):
        total += _is_beside(points[n, 0], side * points[n, 1])
    step, index, count = 1 + total // (len(near) + 1), 0, 0
    for n in range(len(points)):
        if _is_beside(points[n, 0], side * points[n, 1]):
            if index % step == 0 and count < len(near):
                near[count] = points[n]
                count += 1
            index += 1
    return count


@exact_kernel
def _is_beside(x: float, aside: float) -> bool:
    return bool(_NEAREST_M < x < _FARTHEST_M and 0.2 < aside < _ASIDE_M)


@exact_kernel
def _line(points: F64) -> tuple[float, float, float]:
    """The line y = aside + slope x on which most points lie, and where it begins; that is infinite without a line."""
    best, best_aside, best_slope, best_begins = _FEWEST - 1, 0.0, 0.0, np.inf
    for a in range(len(points)):
        for b in range(len(points)):
            along = points[b, 0] - points[a, 0]
            if along < _APART_M:
                continue
            slope = (points[b, 1] - points[a, 1]) / along
            if abs(slope) > _STEEPEST:
                continue
            aside = points[a, 1] - slope * points[a, 0]
            count, begins, ends = 0, np.inf, -np.inf
            for n in range(len(points)):
                if abs(points[n, 1] - aside - slope * points[n, 0]) < _OFF_M:
                    count += 1
                    begins, ends = min(begins, points[n, 0]), max(ends, points[n, 0])
            if count > best and ends - begins > _LONG_M:
                best, best_aside, best_slope, best_begins = count, aside, slope, begins
    return best_aside, best_slope, best_begins


Number = TypeVar("Number", np.float32, np.uint8)

SHY_M = 0.06  # more than from a wall: who moves is wider than what is seen, and may do otherwise
_AHEAD_MPS = 0.05  # slower is no driving ahead
_MOST_CARRIED = 96  # places of edges that go on


class StreetSense:
    """The street around one chair, from tick to tick: `observe`, then whatever is asked, then `command`.

    Args:
        config: Of the run: its first camera is seen, and its chair driven.
        actions: The joystick positions to choose from.
        outline: The box around the chair and its user.
        delay_ticks: From a command to the chair that obeys it; as the configuration says when it is None.
    """

    def __init__(
        self,
        config: RunConfig,
        actions: ActionSet,
        outline: Outline,
        delay_ticks: int | None = None,
    ) -> None:
        camera, self._chair, self._tick_s = config.cameras[0], config.chair, config.world.tick_s
        self.box_B_m = box_of(outline)
        self.commands, self.limits = (
            shaped_rows(actions.points, self._chair),
            limits_of(self._chair),
        )
        self._range_m, self._near_m, self.far_m = (
            camera.range_m,
            camera.near_m,
            0.99 * camera.range_m,
        )
        self._stride = stride_px(camera)
        self._size = (camera.height_px, camera.width_px)
        rays = viewing_rays(camera).reshape(*self._size, 3)[:: self._stride, :: self._stride]
        self.rays = np.ascontiguousarray(
            rays.reshape(-1, 3), np.float32
        )  # of the pixels that are looked at
        self._shape = rays.shape[:2]
        self.depth_m = np.zeros(len(self.rays), np.float32)
        self.eye_B_m = np.array(camera.p_BC_m, np.float64)
        self._map = StepMap()
        delay = config.world.action_delay_ticks if delay_ticks is None else delay_ticks
        self.ego = EgoMotion(self.limits, self._tick_s, delay)
        self.memory, self.tracker = StreetMemory(self._tick_s, self.box_B_m), Tracker(self._tick_s)
        self._carried_B_m = np.empty((_MOST_CARRIED, 2))
        self._kinds = kinds()
        self.forget()

    def forget(self) -> None:
        """Stand still, and know nothing of the street."""
        self.ego.reset()
        self.memory.forget()
        self.tracker.forget()

    def observe(self, observation: Observation) -> None:
        """Take the observation of a new tick."""
        self.feel(observation)
        self._look(observation)

    def feel(self, observation: Observation) -> None:
        """Take of it the chair's own motion alone, and look at nothing."""
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        self.ego.observe(observation, self.shaped(stick))

    def move(self, observation: Observation) -> None:
        """The same for who looks at the street itself: only how the chair moves, and the depths of the pixels."""
        self.feel(observation)
        self.depth_m = self._looked_at(depth_metres(observation[DEPTH_KEY], self._range_m))

    def command(self, action: int) -> None:
        """Say which action is sent now."""
        self.ego.command(self.commands[action])

    def shaped(self, stick: F64) -> F64:
        """A joystick position (2,) as the drive takes it."""
        shaped: F64 = shaped_rows(stick[None], self._chair)[0]
        return shaped

    def start(self) -> tuple[F64, float]:
        """The state (6,) of the moment when the next command reaches the chair, see `arcs`, and when that is."""
        waiting = self.ego.waiting
        return after(self.ego.motion, waiting, self.limits, self._tick_s), len(
            waiting
        ) * self._tick_s

    def in_the_way(self, margin_m: float) -> F64:
        """What is known to be in the way, (n, 5): place in B, speed over the ground, distance to keep."""
        pose = self.ego.pose_O
        seen = self.memory.points_B_m(pose, self.ego.way_m)
        more = self._carried_B_m[: _carry_on(seen, self.memory.cells, pose, self._carried_B_m)]
        others = np.concatenate(
            [np.zeros((0, 2)), *(in_body(who.cells_O_m, pose) for who in self._others())]
        )
        still = np.zeros((len(seen) + len(more), 5))
        still[:, :2] = np.concatenate([seen, more])
        still[:, 4] = margin_m
        still[: len(seen), 4] += SHY_M * beside_movers(seen, others)
        return np.concatenate(
            [still, *(self._moving(who, margin_m) for who in self.tracker.movers if who.rushes)]
        )

    def _others(self) -> list[Mover]:
        """Whoever is no vehicle that stands."""
        return [who for who in self.tracker.movers if who.walks or who.moves]

    def _moving(self, who: Mover, margin_m: float) -> F64:
        """Somebody who moves, (n, 5); whoever should be inside the chair by now went another way."""
        yaw, (rear, front, half) = self.ego.pose_O[2], self.box_B_m
        cells = in_body(who.cells_O_m, self.ego.pose_O)
        outside = (cells[:, 0] < rear) | (cells[:, 0] > front) | (np.abs(cells[:, 1]) > half)
        rows = np.empty((len(cells), 5))
        rows[:, :2] = cells
        rows[:, 2:4] = in_body(who.v_O_mps[None], np.array([0.0, 0.0, yaw]))
        rows[:, 4] = margin_m + SHY_M
        still_there: F64 = rows[outside]
        return still_there

    def _look(self, observation: Observation) -> None:
        """Take in what is seen now: who could move, and what is in the way."""
        image = depth_metres(observation[DEPTH_KEY], self._range_m)
        self.depth_m = depth_m = self._looked_at(image)
        up, pose = _up_in_body(observation[IMU_KEY]), self.ego.pose_O
        walkers = self._watch(observation, depth_m, up)
        span_m = (1.02 * self._near_m, self.far_m)
        now = self._map.obstacles(depth_m, self.rays, self.eye_B_m, span_m, up, self.box_B_m)
        near = now[np.hypot(now[:, 0], now[:, 1]) < REACH_M - CELL_M]
        ego, ahead = self.ego, bool(self.ego.motion[0] > _AHEAD_MPS)
        self.memory.see(
            near, beside_movers(near, walkers), self._map.low_m, pose, ego.way_m, ahead=ahead
        )

    def classes(self, observation: Observation) -> U8:
        """The classes (n,) of the pixels that are looked at."""
        return self._looked_at(observation[CLASS_KEY][-1])

    def _looked_at(self, image: npt.NDArray[Number]) -> npt.NDArray[Number]:
        return np.ascontiguousarray(
            image.reshape(self._size)[:: self._stride, :: self._stride]
        ).reshape(-1)

    def _watch(self, observation: Observation, depth_m: F32, up: F64) -> F64:
        """Follow those who could move; cells (n, 2) in B of all but the vehicles that stand."""
        if CLASS_KEY not in observation or observation[CLASS_KEY].dtype != np.uint8:
            return np.zeros((0, 2))
        kind = self._kinds[self.classes(observation)].reshape(self._shape)
        pose = self.ego.pose_O
        clusters, cells, owner = find_clusters(
            kind, depth_m, self.rays, self.eye_B_m, self.far_m, up, pose
        )
        each = [cells[owner == number] for number in range(len(clusters))]
        self.tracker.see(clusters, [in_odometric(own, pose) for own in each])
        seen = [in_body(who.cells_O_m, pose) for who in self._others() if who.unseen_s == 0.0]
        return np.concatenate([np.zeros((0, 2)), *seen])


def stride_px(camera: CameraConfig) -> int:
    """How many pixels it is from one that is looked at to the next, in rows and columns: more in a larger picture.

    >>> [stride_px(CameraConfig(width_px=width, height_px=60)) for width in (80, 160, 320, 640)]
    [1, 1, 2, 4]
    """
    return max(1, round(camera.width_px / 160))


def box_of(outline: Outline) -> F64:
    """(3,) rear, front and half the width of a chair in B."""
    half_m = 0.5 * outline.length_m
    return np.array(
        [outline.middle_x_m - half_m, outline.middle_x_m + half_m, 0.5 * outline.width_m]
    )


def _up_in_body(imu: F32) -> F64:
    """The direction up in B, (3,), from the tilt in an observation's IMU vector."""
    roll, pitch = np.pi * float(imu[3]), 0.5 * np.pi * float(imu[4])
    return np.array([np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
