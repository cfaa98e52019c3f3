"""What a chair knows of the street from its senses: its place, obstacles around it, and movers.

Walls and kerbs continue: a straight edge that is seen ahead is extended beside the chair, where its
camera does not look.
"""

import math
from typing import Final

import numpy as np

from wcsim.agents.perception.arcs import predict_delayed_state
from wcsim.agents.perception.clusters import (
    find_movable_clusters,
    make_class_mobility_table,
    mask_points_near_cells,
)
from wcsim.agents.perception.depth_image import CameraView
from wcsim.agents.perception.ego_motion import (
    EgoMotionEstimator,
    body_to_odometric,
    odometric_to_body,
)
from wcsim.agents.perception.street_memory import (
    CELL_M,
    REACH_M,
    StepObstacleDetector,
    StreetMemoryGrid,
    is_free_ground,
)
from wcsim.agents.perception.tracker import MoverTracker, TrackedMover
from wcsim.agents.policy_api import CLASS_KEY, IMU_KEY, JOYSTICK_KEY, Observation
from wcsim.config import RunConfig
from wcsim.core.jit import compile_exact_kernel
from wcsim.core.joystick import drive_limits_from_chair, shape_joysticks
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.actions import action_set
from wcsim.types import F32, F64, I64, Outline

SHY_M: Final = 0.06  # added for movers: they are wider than what is seen, and may move otherwise
_AHEAD_MPS: Final = 0.05  # slower is no driving ahead
# Where edges are searched for: ahead, and to each side.
_NEAREST_M: Final = 0.5
_FARTHEST_M: Final = 3.2
_LEAST_ASIDE_M: Final = 0.2
_MOST_ASIDE_M: Final = 1.4
_OFF_M: Final = 0.08  # a point so far from a line is on it
_APART_M: Final = 0.7  # of two points that make a line
_LONG_M: Final = 1.0  # a shorter line is no edge
_STEEPEST: Final = 0.5  # aside per metre ahead
_FEWEST: Final = 8  # points of an edge
_MOST: Final = 48
# An edge is extended as far as this, behind the axle.
BACK_M: Final = -1.2
_MOST_EXTENDED: Final = 96  # places of extended edges


class StreetPerception:
    """The street around one chair: in each tick `observe`, then any query, then `command`.

    Args:
        config: Of the run: its cameras of `env.camera` are seen, and its chair driven.
        delay_ticks: From a command to the chair that obeys it; None for the configuration's.
    """

    def __init__(self, config: RunConfig, delay_ticks: int | None = None) -> None:
        self._chair, self._tick_s = config.chair, config.world.tick_s
        self.box_B_m = outline_to_box(plant_spec(config.chair).outline)
        self.commands = shape_joysticks(action_set(config.env.actions).points, self._chair)
        self.limits = drive_limits_from_chair(self._chair)
        self.views = [CameraView(camera, prefix) for prefix, camera in config.eyes.items()]
        delay = config.world.action_delay_ticks if delay_ticks is None else delay_ticks
        self.ego = EgoMotionEstimator(self.limits, self._tick_s, delay)
        self.memory = StreetMemoryGrid(self._tick_s, self.box_B_m)
        self.tracker = MoverTracker(self._tick_s)
        self._map = StepObstacleDetector()
        self._extended_B_m = np.empty((_MOST_EXTENDED, 2))
        self._mobility = make_class_mobility_table()
        self.forget()

    def forget(self) -> None:
        """Stand still, and know nothing of the street."""
        self.ego.reset()
        self.memory.forget()
        self.tracker.forget()

    def observe(self, observation: Observation) -> None:
        """Take the observation of a new tick: the chair's motion, movers and obstacles."""
        self.observe_motion_and_depth(observation)
        up_B, pose_O = _up_in_body(observation[IMU_KEY]), self.ego.pose_O
        walkers_B_m = self._update_tracks(observation, up_B)
        now = self._map.obstacles(self.views, up_B, self.box_B_m)
        near = now[np.hypot(now[:, 0], now[:, 1]) < REACH_M - CELL_M]
        self.memory.update(
            near,
            mask_points_near_cells(near, walkers_B_m),
            self._map.low_m,
            pose_O,
            self.ego.way_m,
            ahead=bool(self.ego.motion[0] > _AHEAD_MPS),
        )

    def observe_motion_and_depth(self, observation: Observation) -> None:
        """Take only the chair's own motion and the depths of the sampled pixels."""
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        self.ego.observe(observation, self.shaped(stick))
        for view in self.views:
            view.observe(observation)

    def command(self, action: int) -> None:
        """Take the action that is sent now."""
        self.ego.command(self.commands[action])

    def shaped(self, stick: F64) -> F64:
        """A joystick position (2,) as the drive takes it."""
        shaped: F64 = shape_joysticks(stick[None], self._chair)[0]
        return shaped

    def start(self) -> tuple[F64, float]:
        """The state (6,) when the next command reaches the chair, and that time; see `arcs.py`."""
        waiting = self.ego.waiting
        state = predict_delayed_state(self.ego.motion, waiting, self.limits, self._tick_s)
        return state, len(waiting) * self._tick_s

    def in_the_way(self, margin_m: float) -> F64:
        """Known obstacles (n, 5): place in B, velocity over the ground, distance to keep."""
        pose_O = self.ego.pose_O
        # 1. What stands, and the edges that it makes.
        seen = self.memory.points_B_m(pose_O, self.ego.way_m)
        count = _extend_edges(seen, self.memory.cells, pose_O, self._extended_B_m)
        extended = self._extended_B_m[:count]
        movers = [np.zeros((0, 2))]
        movers += [odometric_to_body(mover.cells_O_m, pose_O) for mover in self._free_movers()]
        standing = np.zeros((len(seen) + count, 5))
        standing[:, :2] = np.concatenate([seen, extended])
        standing[:, 4] = margin_m
        standing[: len(seen), 4] += SHY_M * mask_points_near_cells(seen, np.concatenate(movers))
        # 2. What rushes; a place inside the chair is left out, as the mover went another way.
        rear, front, half = self.box_B_m
        rushing = []
        for mover in self.tracker.movers:
            if mover.rushes:
                cells = odometric_to_body(mover.cells_O_m, pose_O)
                rows = np.empty((len(cells), 5))
                rows[:, :2] = cells
                rows[:, 2:4] = odometric_to_body(
                    mover.v_O_mps[None], np.array([0.0, 0.0, pose_O[2]])
                )
                rows[:, 4] = margin_m + SHY_M
                behind_or_ahead = (cells[:, 0] < rear) | (cells[:, 0] > front)
                rushing.append(rows[behind_or_ahead | (np.abs(cells[:, 1]) > half)])
        return np.concatenate([standing, *rushing])

    def _free_movers(self) -> list[TrackedMover]:
        """All movers except vehicles that stand."""
        return [mover for mover in self.tracker.movers if mover.walks or mover.moves]

    def _update_tracks(self, observation: Observation, up_B: F64) -> F64:
        """Follow the movers; cells (n, 2) in B of those in view, without vehicles that stand."""
        if CLASS_KEY not in observation or observation[CLASS_KEY].dtype != np.uint8:
            return np.zeros((0, 2))
        pose_O = self.ego.pose_O
        clusters, each = [], list[F64]()
        for view in self.views:
            mobility = self._mobility[view.classes(observation)].reshape(view.shape)
            found, cells, owner = find_movable_clusters(mobility, view, up_B, pose_O)
            clusters.append(found)
            each += [
                body_to_odometric(cells[owner == number], pose_O) for number in range(len(found))
            ]
        self.tracker.update(np.concatenate(clusters), each)
        seen = [
            odometric_to_body(mover.cells_O_m, pose_O)
            for mover in self._free_movers()
            if mover.unseen_s == 0.0
        ]
        return np.concatenate([np.zeros((0, 2)), *seen])


def outline_to_box(outline: Outline) -> F64:
    """(3,) rear, front and half the width of a chair in B."""
    half_m = 0.5 * outline.length_m
    return np.array(
        [outline.middle_x_m - half_m, outline.middle_x_m + half_m, 0.5 * outline.width_m]
    )


def _up_in_body(imu: F32) -> F64:
    """The direction up in B, (3,), from the tilt in an observation's IMU vector."""
    roll, pitch = np.pi * float(imu[3]), 0.5 * np.pi * float(imu[4])
    return np.array([np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])


@compile_exact_kernel
def _extend_edges(points: F64, cells: I64, pose_O: F64, added: F64) -> int:
    """Extend the longest straight edge on either side, over what was never seen.

    Args:
        points: (n, 2) what is in the way, in B.
        cells: Of `StreetMemoryGrid`.
        pose_O: (3,) of the chair.
        added: (m, 2) written: the places that may be in the way, in B.

    Returns:
        How many were written.
    """
    count = 0
    near = np.empty((_MOST, 2))
    cos, sin = math.cos(pose_O[2]), math.sin(pose_O[2])
    for side in (-1.0, 1.0):
        found = _gather_beside(points, side, near)
        aside, slope, first = _line(near[:found])
        if math.isinf(first):
            continue
        x = first - CELL_M
        while x > BACK_M and count < len(added):
            y = aside + slope * x
            x_O_m, y_O_m = pose_O[0] + cos * x - sin * y, pose_O[1] + sin * x + cos * y
            if y * side > 0.0 and not is_free_ground(cells, x_O_m, y_O_m):
                added[count, 0], added[count, 1] = x, y
                count += 1
            x -= CELL_M
    return count


@compile_exact_kernel
def _gather_beside(points: F64, side: float, near: F64) -> int:
    """Write the points ahead on one side; every second one, and so on, when there are too many."""
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


@compile_exact_kernel
def _is_beside(x: float, aside: float) -> bool:
    return bool(_NEAREST_M < x < _FARTHEST_M and _LEAST_ASIDE_M < aside < _MOST_ASIDE_M)


@compile_exact_kernel
def _line(points: F64) -> tuple[float, float, float]:
    """The line y = aside + slope x with most points, and its first x, infinite without a line."""
    best, best_aside, best_slope, best_first = _FEWEST - 1, 0.0, 0.0, np.inf
    for a in range(len(points)):
        for b in range(len(points)):
            along = points[b, 0] - points[a, 0]
            if along < _APART_M:
                continue
            slope = (points[b, 1] - points[a, 1]) / along
            if abs(slope) > _STEEPEST:
                continue
            aside = points[a, 1] - slope * points[a, 0]
            count, first, last = 0, np.inf, -np.inf
            for n in range(len(points)):
                if abs(points[n, 1] - aside - slope * points[n, 0]) < _OFF_M:
                    count += 1
                    first, last = min(first, points[n, 0]), max(last, points[n, 0])
            if count > best and last - first > _LONG_M:
                best, best_aside, best_slope, best_first = count, aside, slope, first
    return best_aside, best_slope, best_first
