"""The features of a danger network: the street from above around the chair, and how it moves.

A raster in the odometric frame O has cells of 0.1 m. A cell is written whenever a camera sees it.
For some seconds it holds heights, the kind of ground, and the time of its last person or vehicle.
The picture is read out of the raster around the chair, from 1.6 m behind its axle to 4.8 m ahead.
Its first row is the farthest ahead, and its first column the farthest to the left.

`sweep` computes which cells of the picture each joystick position leads over. The position is held
for half a second and then released, as by the oracle.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.agents.perception.arcs import integrate_chair_state
from wcsim.agents.perception.surroundings import StreetPerception
from wcsim.agents.policy_api import (
    CLASS_KEY,
    DEPTH_KEY,
    IMU_KEY,
    JOYSTICK_KEY,
    ODOMETRY_KEY,
    Observation,
)
from wcsim.config import RunConfig
from wcsim.core.jit import compile_exact_kernel
from wcsim.errors import PolicyError
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.actions import action_set
from wcsim.types import F32, F64, I32, I64, U8, Bool, ClassId

# The picture.
SIDE: Final = 64  # cells each way
CELL_M: Final = 0.1
BEHIND_M: Final = 1.6
HALF_M: Final = 0.5 * SIDE * CELL_M
HIGHEST, LOWEST, AGE, TRAIL, KIND = range(5)  # its planes
PLANES: Final = 5
LOW_M, SPAN_M = -0.5, 1.5  # heights above the axle's ground that the codes 1 to 255 stand for
# The raster.
RASTER: Final = 160  # cells each way: more than twice as many as the picture has
_KEY_X, _KEY_Y, _TICK, _MOVER, _CLASS = range(5)  # columns of a cell
_PAVED, _ROAD, _EARTH, _OTHER = range(1, 5)  # kinds of ground
KEEP_TICKS: Final = 40
TRAIL_TICKS: Final = 20
HEAD_M: Final = 1.8  # what hangs higher passes above the chair
MOVER_M: Final = 0.2  # a person or vehicle shows something above this
REACH_M: Final = 7.5  # farther points are left out
# Roll-outs.
HOLD_S: Final = 0.5
STEP_S: Final = 0.1
SLICES: Final = 3  # of time
EACH_SLICE: Final = 7  # steps of a slice: a chair at its top speed stands after all of them
POINTS_M: Final = 0.2  # between points on the edge of the hull, at most
KNOWN_M: Final = 0.25  # around the chair the ground counts as seen
# The vector.
COMMANDS: Final = 3  # the last ones are an input
TILT: Final = slice(3, 5)  # roll and pitch in the IMU vector
TURNS: Final = slice(5, 8)  # turn rates there
FULL_MOTION: Final = (1.67, 1.5, 2.0)  # speed, turn rate and acceleration that are 1
_MOTION: Final = 4  # numbers: v, w, acceleration, delay
VECTOR: Final = 2 + 3 + _MOTION + 2 * COMMANDS
# Numbers that change their sign when left and right change places.
MIRRORED: Final = (0, 2, 4, 6, *range(9, VECTOR, 2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Features:
    """One tick of one chair."""

    picture: U8  # (PLANES, SIDE, SIDE)
    vector: F32  # (VECTOR,) roll, pitch, turn rates, v, w, acceleration, delay, commands (x, y)
    start: F32  # (6,) where roll-outs start, see `sweep`

    def batch(self) -> tuple[U8, F32, F64]:
        """Picture, vector and start of a batch of one."""
        # From float32, as in `Dataset.batch`: roll-outs in training and driving are equal.
        return self.picture[None], self.vector[None], self.start[None].astype(np.float64)


class FeatureExtractor:
    """Makes the features of one chair, from tick to tick: `extract`, then `command`.

    Args:
        config: Of the run: its cameras of `env.camera` are seen, and its chair driven.
        delay_ticks: From a command to the chair that obeys it; None for the configuration's.
    """

    def __init__(self, config: RunConfig, delay_ticks: int | None = None) -> None:
        self._shapes = {
            prefix + key: (camera.height_px, camera.width_px)
            for prefix, camera in config.eyes.items()
            for key in (DEPTH_KEY, CLASS_KEY)
        }
        self._actions = action_set(config.env.actions)
        self.around = StreetPerception(config, delay_ticks)
        self._kinds, self._movers = kinds_of_ground(), movers()
        self._cells = np.zeros((RASTER, RASTER, 5), np.int64)
        self._heights_m = np.zeros((RASTER, RASTER, 2), np.float32)  # highest and lowest
        wheels_m = np.array(plant_spec(config.chair).stand_m(), np.float64)
        self.chair = hull_and_wheels(self.around.box_B_m, wheels_m)
        self.forget()

    def forget(self) -> None:
        """An episode starts: the chair stands still, and the street is unknown."""
        self.around.forget()
        # Heights stay: they are read only where a cell has a tick.
        self._cells[:] = 0
        self._tick = 0
        self._sent = np.zeros((COMMANDS, 2))  # joystick positions, the newest first

    def extract(self, observation: Observation) -> Features:
        """The features of a new tick.

        Raises:
            PolicyError: The observation lacks a sense, or is of other cameras.
        """
        self._require_senses(observation)
        # 1. Write what the cameras show into the raster.
        around, ego = self.around, self.around.ego
        around.observe_motion_and_depth(observation)
        self._tick += 1
        for view in around.views:
            _write_cells(
                view.depth_m,
                view.classes(observation),
                view.rays,
                view.eye_B_m,
                view.far_m,
                ego.pose_O,
                self._tick,
                self._kinds,
                self._movers,
                self._cells,
                self._heights_m,
            )

        # 2. Read the picture out of it.
        picture = np.zeros((PLANES, SIDE, SIDE), np.uint8)
        _read_cells(ego.pose_O, self._tick, self._cells, self._heights_m, picture)

        # 3. How the chair moves, and where its roll-outs start.
        start, later_s = around.start()
        imu = observation[IMU_KEY]
        # Tilts are a few hundredths of the half turn that is 1 in the observation.
        vector: F64 = np.concatenate(
            [
                10.0 * imu[TILT],
                imu[TURNS],
                ego.motion / FULL_MOTION,
                [later_s],
                self._sent.reshape(-1),
            ]
        )
        return Features(
            picture=picture,
            # A sensor fault must not lead beyond what the network was trained with.
            vector=np.clip(vector, -2.0, 2.0).astype(np.float32),
            start=start.astype(np.float32),
        )

    def backs_blindly(self, features: Features) -> Bool:
        """(A,) the actions that back the chair up onto ground that no camera saw of late."""
        around, (_, _, start) = self.around, features.batch()
        out = np.empty(len(around.commands), np.bool_)
        _backs_blindly(
            features.picture[AGE], start[0], around.commands, around.limits, around.box_B_m, out
        )
        return out

    def command(self, action: int) -> None:
        """Take the action that is sent now."""
        self.around.command(action)
        self._sent = np.roll(self._sent, 1, axis=0)
        self._sent[0] = self._actions.points[action]

    def _require_senses(self, observation: Observation) -> None:
        """Raise PolicyError if the observation lacks a sense, or is of other cameras."""
        required = (*self._shapes, IMU_KEY, JOYSTICK_KEY, ODOMETRY_KEY)
        lacks = [key for key in required if key not in observation]
        if lacks or len(observation[IMU_KEY]) < TURNS.stop:
            what = f"no {', '.join(lacks)}"
            if not lacks:
                what = f"{len(observation[IMU_KEY])} numbers of the IMU"
            raise PolicyError(
                f"a danger network got {what}; expected pictures with classes, tilt, turn rates, "
                "odometry, joystick: set sensors.odometry=typical, env.observe_gyro=true, "
                "env.camera and env.classes as in its training"
            )
        shapes = {key: tuple(observation[key].shape[-2:]) for key in self._shapes}
        if shapes != self._shapes:
            raise PolicyError(
                f"a danger network got pictures of {shapes}; expected {self._shapes} (rows, "
                "columns): test it with the cameras of its training"
            )


def kinds_of_ground() -> U8:
    """Table (256,) from a pixel's class to a kind of ground, 0 for what is none."""
    table = np.zeros(256, np.uint8)
    table[[ClassId.SIDEWALK, ClassId.KERB, ClassId.LOWERED_KERB]] = _PAVED
    table[[ClassId.ROAD, ClassId.PARKING, ClassId.RAIL_TRACK, ClassId.CROSSWALK]] = _ROAD
    table[[ClassId.GROUND, ClassId.TERRAIN]] = _EARTH
    table[[ClassId.BUILDING, ClassId.WALL, ClassId.FENCE]] = _OTHER
    return table


def movers() -> Bool:
    """Table (256,) of the classes that may move."""
    table = np.zeros(256, np.bool_)
    table[ClassId.PERSON : ClassId.BICYCLE + 1] = True
    return table


def hull_and_wheels(box: F64, wheels_m: F64) -> F64:
    """The points of a chair that sweep over the ground.

    Args:
        box: (3,) rear, front, half the width of the chair in B.
        wheels_m: (w, 2) places of its wheels in B.

    Returns:
        (n, 3) x and y in B, then 1 for a wheel and 0 for the hull.
    """
    rear, front, half = box.tolist()
    along = np.linspace(rear, front, 1 + math.ceil((front - rear) / POINTS_M))
    across = np.linspace(-half, half, 1 + math.ceil(2.0 * half / POINTS_M))
    rows = [(x, y, 0.0) for x in along for y in across if x in (rear, front) or abs(y) == half]
    rows += [(x, y, 1.0) for x, y in wheels_m.tolist()]
    return np.array(rows, np.float64)


@compile_exact_kernel
def sweep(starts: F64, commands: F64, limits: F64, chair: F64, out: I32) -> None:
    """Write the cells of a street map that each command leads over.

    Args:
        starts: (B, 6) states when the commands reach the chairs, see `integrate_chair_state`.
        commands: (K, 2) joystick positions as the drive takes them.
        limits: (8,) of the drive.
        chair: (n, 3) see `hull_and_wheels`.
        out: (B, K, SLICES * EACH_SLICE * n) written: flat indices into maps (2 * SLICES, SIDE,
            SIDE), those of the hull first.
    """
    rest, now = np.zeros(2), np.empty(6)
    plane = SIDE * SIDE
    for b in range(len(starts)):
        for k in range(len(commands)):
            now[:] = starts[b]
            place = 0
            for i in range(SLICES * EACH_SLICE):
                # A hair less: rounding of the product must not add a step.
                held = i * STEP_S < HOLD_S - 1e-9
                integrate_chair_state(now, commands[k] if held else rest, limits, STEP_S)
                cos, sin = math.cos(now[2]), math.sin(now[2])
                for p in range(len(chair)):
                    x = now[0] + cos * chair[p, 0] - sin * chair[p, 1]
                    y = now[1] + sin * chair[p, 0] + cos * chair[p, 1]
                    # Clamped: no cell says "unknown", so what leaves the map is read at its edge.
                    row = min(max(SIDE - 1 - math.floor((x + BEHIND_M) / CELL_M), 0), SIDE - 1)
                    column = min(max(math.floor((HALF_M - y) / CELL_M), 0), SIDE - 1)
                    which = i // EACH_SLICE + (SLICES if chair[p, 2] > 0.0 else 0)
                    out[b, k, place] = which * plane + row * SIDE + column
                    place += 1


@compile_exact_kernel
def _write_cells(
    depth: F32,
    classes: U8,
    rays: F32,
    eye: F64,
    far_m: float,
    pose: F64,
    tick: int,
    kinds: U8,
    movers: Bool,
    cells: I64,
    heights: F32,
) -> None:
    """Write the pixels of a camera into the raster.

    Args:
        depth: (n,) in metres; 0 is not measured.
        classes: (n,) of the pixels.
        rays: (n, 3) in B, one metre deep.
        eye: (3,) the camera in B.
        far_m: Depths from here on show nothing.
        pose: (3,) of the chair in O.
        tick: Of the episode, from 1.
        kinds: (256,) see `kinds_of_ground`.
        movers: (256,) see `movers`.
        cells: (RASTER, RASTER, 5) written: keys, the tick of the picture and of the last mover, and
            the kind of ground.
        heights: (RASTER, RASTER, 2) written: highest and lowest, in metres.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for n in range(len(depth)):
        if not 0.0 < depth[n] < far_m:
            continue
        x = eye[0] + depth[n] * rays[n, 0]
        y = eye[1] + depth[n] * rays[n, 1]
        z = eye[2] + depth[n] * rays[n, 2]
        if z > HEAD_M or max(abs(x), abs(y)) > REACH_M:
            continue
        ix = math.floor((pose[0] + cos * x - sin * y) / CELL_M)
        iy = math.floor((pose[1] + sin * x + cos * y) / CELL_M)
        cell, height = cells[ix % RASTER, iy % RASTER], heights[ix % RASTER, iy % RASTER]
        kind = kinds[classes[n]]
        # The raster wraps around: keys tell a place from another one that has the same cell.
        if cell[_KEY_X] != ix or cell[_KEY_Y] != iy:
            cell[_KEY_X], cell[_KEY_Y], cell[_MOVER] = ix, iy, 0
            cell[_TICK] = 0
        # A new picture replaces the older ones; within it heights are gathered.
        if cell[_TICK] != tick:
            cell[_TICK], cell[_CLASS] = tick, kind
            height[0] = height[1] = z
        else:
            height[0], height[1] = max(height[0], z), min(height[1], z)
            if kind > 0:
                cell[_CLASS] = kind
        if movers[classes[n]] and z > MOVER_M:
            cell[_MOVER] = tick


@compile_exact_kernel
def _read_cells(pose: F64, tick: int, cells: I64, heights: F32, out: U8) -> None:
    """Read the picture around a pose; for the arguments see `_write_cells`.

    `out` is written: (PLANES, SIDE, SIDE).
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    out[:] = 0
    for i in range(SIDE):
        for j in range(SIDE):
            bx, by = (SIDE - i - 0.5) * CELL_M - BEHIND_M, HALF_M - (j + 0.5) * CELL_M
            x, y = pose[0] + cos * bx - sin * by, pose[1] + sin * bx + cos * by
            ix, iy = math.floor(x / CELL_M), math.floor(y / CELL_M)
            cell = cells[ix % RASTER, iy % RASTER]
            if cell[_TICK] == 0 or cell[_KEY_X] != ix or cell[_KEY_Y] != iy:
                continue
            # Codes fall with age: what was seen long ago may have moved since.
            age = tick - cell[_TICK]
            if age <= KEEP_TICKS:
                out[HIGHEST, i, j] = _height_code(heights[ix % RASTER, iy % RASTER, 0])
                out[LOWEST, i, j] = _height_code(heights[ix % RASTER, iy % RASTER, 1])
                out[AGE, i, j] = 255 - 5 * age
                out[KIND, i, j] = 60 * cell[_CLASS]
            if cell[_MOVER] > 0 and tick - cell[_MOVER] <= TRAIL_TICKS:
                out[TRAIL, i, j] = 255 - 12 * (tick - cell[_MOVER])


@compile_exact_kernel
def _height_code(height_m: float) -> int:
    return 1 + int(254.0 * min(max((height_m - LOW_M) / SPAN_M, 0.0), 1.0))


@compile_exact_kernel
def _backs_blindly(age: U8, start: F64, commands: F64, limits: F64, box: F64, out: Bool) -> None:
    """Write which commands bring the chair's rear, backwards, onto ground that no camera saw.

    What is near its place at the start counts as seen.

    Args:
        age: (SIDE, SIDE) of the picture; 0 was not seen.
        start: (6,) the state when a command reaches the chair.
        commands: (K, 2) joystick positions as the drive takes them.
        limits: (8,) of the drive.
        box: (3,) rear, front, half the width of the chair in B.
        out: (K,) written.
    """
    rest, now = np.zeros(2), np.empty(6)
    for k in range(len(commands)):
        out[k] = False
        if commands[k, 1] >= 0.0:
            continue
        now[:] = start
        for i in range(SLICES * EACH_SLICE):
            held = i * STEP_S < HOLD_S - 1e-9
            integrate_chair_state(now, commands[k] if held else rest, limits, STEP_S)
            if now[3] >= 0.0:
                continue
            cos, sin = math.cos(now[2]), math.sin(now[2])
            for side in (-1.0, 0.0, 1.0):
                x = now[0] + cos * box[0] - sin * side * box[2]
                y = now[1] + sin * box[0] + cos * side * box[2]
                if box[0] - KNOWN_M < x < box[1] and abs(y) < box[2] + KNOWN_M:
                    continue
                row = SIDE - 1 - math.floor((x + BEHIND_M) / CELL_M)
                column = math.floor((HALF_M - y) / CELL_M)
                if not (0 <= row < SIDE and 0 <= column < SIDE) or age[row, column] == 0:
                    out[k] = True
