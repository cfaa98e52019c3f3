"""Recorded driving as the danger network learns from it: sights and labels, kept small, drawn in batches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from wcsim.agents.collecting.labels import unsafe_ahead
from wcsim.agents.collecting.segment import Segment
from wcsim.agents.danger.roll_outs import EACH_SLICE, NUMBERS, SLICES, sweep
from wcsim.agents.danger.sight import MIRRORED, VECTOR, Eye
from wcsim.agents.danger.street_map import PLANES, SIDE
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, IMU_KEY, JOYSTICK_KEY, ODOMETRY_KEY
from wcsim.agents.replay.frame_store import pack_each, unpack_each
from wcsim.config import DangerConfig, RunConfig
from wcsim.supervisor.actions import action_set
from wcsim.types import F32, U8, Bool

_START_MIRRORED = (1, 2, 4)  # y, yaw, w


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lessons:
    """Sights of N steps and what is unsafe in each."""

    pictures: list[bytes]  # zstd, (PLANES, SIDE, SIDE) uint8 each
    actions: U8  # (N, A, NUMBERS)
    vectors: F32  # (N, VECTOR)
    starts: F32  # (N, 6)
    unsafe: Bool  # (N, A)

    def __len__(self) -> int:
        """How many steps."""
        return len(self.pictures)


def lessons_of(segment: Segment, config: RunConfig) -> Lessons:
    """Look at a segment again, step by step, as a chair that drives would."""
    count, danger = len(segment), config.danger
    pictures: list[bytes] = []
    actions = np.empty((count, len(action_set(config.env.actions)), NUMBERS), np.uint8)
    vectors, starts = np.empty((count, VECTOR), np.float32), np.empty((count, 6), np.float32)
    eyes: dict[int, Eye] = {}
    begins = True
    for row in range(count):
        delay = int(segment.delay[row])
        if begins:
            if delay not in eyes:
                eyes[delay] = Eye(config, delay)
            eye = eyes[delay]
            eye.forget()
        sight = eye.look(
            {
                DEPTH_KEY: segment.depth[row][None],
                CLASS_KEY: segment.seg[row][None],
                IMU_KEY: segment.imu[row],
                ODOMETRY_KEY: segment.odometry[row],
                JOYSTICK_KEY: segment.wish[row],
            }
        )
        eye.command(int(segment.action[row]))
        pictures += pack_each(sight.picture.reshape(1, -1))
        actions[row], vectors[row], starts[row] = sight.actions, sight.vector, sight.start
        begins = bool(segment.ended[row])
    codes = segment.truth if danger.teacher == "truth" else segment.visible
    unsafe = unsafe_ahead(codes, segment.ended, danger.ahead)
    return Lessons(pictures=pictures, actions=actions, vectors=vectors, starts=starts, unsafe=unsafe)


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """What a step of learning gets; see `DangerNet.forward`."""

    inputs: tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]
    unsafe: torch.Tensor  # (B, A) float32


class Lectures:
    """Draws batches from all lessons so far.

    Args:
        config: Of the run.
    """

    def __init__(self, config: RunConfig) -> None:
        self._danger: DangerConfig = config.danger
        self._rng, self._eye = np.random.default_rng(0), Eye(config)
        self._mirror = action_set(config.env.actions).mirror
        self._parts: list[Lessons] = []
        self._rows = np.zeros((0, 2), np.int64)  # part and row
        self._tight = np.zeros((0, 2), np.int64)

    def add(self, lessons: Lessons) -> None:
        """Learn from these, too."""
        rows = np.stack([np.full(len(lessons), len(self._parts)), np.arange(len(lessons))], 1)
        self._parts.append(lessons)
        self._rows = np.concatenate([self._rows, rows])
        self._tight = np.concatenate([self._tight, rows[lessons.unsafe.any(axis=1)]])

    def begin(self, rng: np.random.Generator) -> None:
        """Draw with this generator from now on."""
        self._rng = rng

    def __len__(self) -> int:
        """How many steps there are."""
        return len(self._rows)

    @property
    def tight_share(self) -> float:
        """The share of steps in which something is unsafe."""
        return len(self._tight) / max(len(self._rows), 1)

    def draw(self) -> Batch:
        """A batch, a share of it from steps in which something is unsafe, mirrored half of the time."""
        size, rng = self._danger.batch, self._rng
        tight = round(self._danger.tight_share * size) if len(self._tight) else 0
        picks = np.concatenate(
            [
                self._tight[rng.integers(0, max(len(self._tight), 1), tight)],
                self._rows[rng.integers(0, len(self._rows), size - tight)],
            ]
        )
        return self.batch(picks, mirror=bool(rng.random() < 0.5))

    def batch(self, picks: np.ndarray, mirror: bool = False) -> Batch:
        """These rows, (B, 2) part and row."""
        chosen = [(self._parts[part], row) for part, row in picks.tolist()]
        pictures = unpack_each([part.pictures[row] for part, row in chosen], PLANES * SIDE * SIDE)
        picture = pictures.reshape(-1, PLANES, SIDE, SIDE)
        numbers = np.stack([part.actions[row] for part, row in chosen])
        vector = np.stack([part.vectors[row] for part, row in chosen])
        start = np.stack([part.starts[row] for part, row in chosen]).astype(np.float64)
        unsafe = np.stack([part.unsafe[row] for part, row in chosen])
        if mirror:
            picture, numbers, unsafe = picture[..., ::-1].copy(), numbers[:, self._mirror], unsafe[:, self._mirror]
            vector[:, MIRRORED] *= -1.0
            start[:, _START_MIRRORED] *= -1.0
        around = self._eye.around
        swept = np.empty((len(picks), len(around.commands), SLICES * EACH_SLICE * len(self._eye.chair)), np.int32)
        sweep(start, around.commands, around.limits, self._eye.chair, swept)
        return Batch(
            inputs=(
                torch.from_numpy(picture).float().div_(255.0).contiguous(memory_format=torch.channels_last),
                torch.from_numpy(numbers).float().div_(255.0),
                torch.from_numpy(vector),
                torch.from_numpy(swept).long(),
            ),
            unsafe=torch.from_numpy(unsafe).float(),
        )
