"""Training data of a danger network: features and labels of recorded steps, drawn in batches."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
import zstandard

from wcsim.agents.danger.street_map import (
    EACH_SLICE,
    HOLD_S,
    MIRRORED,
    PLANES,
    SIDE,
    SLICES,
    FeatureExtractor,
    sweep,
)
from wcsim.agents.policy_api import IMU_KEY, JOYSTICK_KEY, ODOMETRY_KEY
from wcsim.agents.runs.data_folder import (
    BY_EVENTS,
    ORACLE,
    DrivingSegment,
    mask_soon_unsafe_actions,
    segment_images,
)
from wcsim.config import RewardConfig, RunConfig
from wcsim.core.reading import decompress_zstd
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.supervisor.rewards import reward_of_distance
from wcsim.types import F32, F64, I64, U8, Bool

UNKNOWN: Final = 2  # label of a joystick position that was not tried
CRASH_S: Final = 1.0  # before a crash, in which the stick that was held counts as unsafe
_TIGHT_LABEL: Final = 0.34  # a step with such a label or more is tight: a crash within a second
# Within this distance joystick positions share a label: neighbours are 0.25 apart.
_SHARED_DISTANCE = 0.26
_HELD_DISTANCE = 0.5  # within it a stick counts as held, as hands tremble
_DISCOUNT: Final = 0.9  # of the reward, per tick
_HORIZON_S: Final = 2.0  # later a crash counts for little
_MIRRORED_STATE = (1, 2, 4)  # y, yaw and w change their sign when left and right change places
_ZSTD_LEVEL = 1

Inputs = tuple[torch.Tensor, ...]
"""Picture, vector and swept cells, see `DangerNet.forward`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Batch:
    """B steps to learn from."""

    inputs: Inputs
    unsafe: torch.Tensor  # (B, A) float32: 0 to 1, or UNKNOWN


class Dataset:
    """Features and labels of all steps so far; draws batches of them.

    Args:
        config: Of the run.
    """

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self._rng, self._extractor = np.random.default_rng(0), FeatureExtractor(config)
        self._actions = action_set(config.env.actions)
        self._pictures: list[bytes] = []  # of each step: zstd, (PLANES, SIDE, SIDE) uint8
        self._vectors: list[F32] = []  # (VECTOR,)
        self._starts: list[F32] = []  # (6,)
        self._unsafe: list[U8 | F32] = []  # (A,) 0 to 1, or UNKNOWN
        self._tight = np.zeros(0, np.int64)  # indices of steps with an unsafe position
        self._known = np.zeros(0, np.int64)  # indices of steps with a label

    def add(self, segment: DrivingSegment) -> None:
        """Add the steps of a segment; their features are extracted as by a chair that drives.

        Raises:
            PolicyError: It has labels for other actions, or images of other cameras. Or the oracle
                drove, and the teacher is one of `BY_EVENTS`.
        """
        first, unsafe = len(self), self._labels(segment)
        extractors: dict[int, FeatureExtractor] = {}
        for row in range(len(segment)):
            # 1. Where roll-outs start depends on the delay, which an episode may draw.
            delay = int(segment.delay[row])
            if row == 0 or segment.ended[row - 1]:
                if delay not in extractors:
                    extractors[delay] = FeatureExtractor(self._config, delay)
                extractor = extractors[delay]
                extractor.forget()

            # 2. The features, and the labels that follow from them.
            features = extractor.extract(
                {
                    **segment_images(segment, row, self._config.eyes),
                    IMU_KEY: segment.imu[row],
                    ODOMETRY_KEY: segment.odometry[row],
                    JOYSTICK_KEY: segment.wish[row],
                }
            )
            if self._config.danger.teacher not in BY_EVENTS:
                unsafe[row] |= extractor.backs_blindly(features)
            extractor.command(int(segment.action[row]))

            # 3. Compressed at once: unpacked pictures would take a hundred times the memory.
            compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
            packed = compressor.compress(features.picture.tobytes())
            # Copied: zstd's own bytes lie in a block for the worst case, whose rest is lost.
            self._pictures.append(bytes(memoryview(packed)))
            self._vectors.append(features.vector)
            self._starts.append(features.start)

        self._unsafe += list(unsafe)
        known = unsafe < UNKNOWN
        tight = known & (unsafe >= _TIGHT_LABEL)
        self._tight = np.concatenate([self._tight, first + np.flatnonzero(tight.any(axis=1))])
        self._known = np.concatenate([self._known, first + np.flatnonzero(known.any(axis=1))])

    def _labels(self, segment: DrivingSegment) -> U8 | F32:
        """(N, A) labels of its steps, by the teacher of `danger.teacher`."""
        danger, tick_s, count = self._config.danger, self._config.world.tick_s, len(self._actions)
        # 1. A teacher that needs no oracle.
        if danger.teacher in BY_EVENTS:
            if (segment.driver == ORACLE).any() or segment.action.max() >= count:
                raise PolicyError(
                    f"a segment was driven by the oracle, or with actions beyond {count}; "
                    f"danger.teacher={danger.teacher} expected users and networks: collect it again"
                )
            if danger.teacher == "returns":
                horizon = round(_HORIZON_S / tick_s)
                return _label_by_returns(segment, self._actions, self._config.reward, horizon)
            return _label_by_crashes(segment, self._actions, danger.ahead, tick_s)

        # 2. An oracle. A crash that happened overrules it.
        labels = segment.truth.shape[1]
        if labels != count:
            raise PolicyError(
                f"a segment has labels for {labels} actions; expected {count}: collect it again, "
                "with an oracle as danger.teacher"
            )
        codes = segment.truth if danger.teacher == "truth" else segment.visible
        unsafe = mask_soon_unsafe_actions(codes, segment.ended, danger.ahead).astype(np.uint8)
        ahead = round(CRASH_S / tick_s)
        unsafe[_label_by_crashes(segment, self._actions, ahead, tick_s) == 1] = 1
        return unsafe

    def begin(self, rng: np.random.Generator) -> None:
        """Draw with this generator from now on."""
        self._rng = rng

    def __len__(self) -> int:
        """The number of steps."""
        return len(self._pictures)

    @property
    def tight_share(self) -> float:
        """The share of steps with an unsafe position."""
        return len(self._tight) / max(len(self), 1)

    def draw(self) -> _Batch:
        """Draw a batch; half of the batches are mirrored.

        A share of its steps is drawn from those with an unsafe position.

        Raises:
            PolicyError: No step has a label.
        """
        danger, size, rng = self._config.danger, self._config.danger.batch, self._rng
        if not len(self._known):
            raise PolicyError(
                f"nothing is known of {len(self)} steps; expected longer episodes, or more of them"
            )
        # Steps with a danger are rare. Drawn evenly, they would hardly change the weights.
        tight = round(danger.tight_share * size) if len(self._tight) else 0
        picks = np.concatenate(
            [
                self._tight[rng.integers(0, max(len(self._tight), 1), tight)],
                self._known[rng.integers(0, len(self._known), size - tight)],
            ]
        )
        # A street map is around the chair, so it can be mirrored wherever the cameras look.
        return self.batch(picks, mirror=bool(rng.random() < 0.5))

    def batch(self, picks: I64, mirror: bool = False) -> _Batch:
        """The steps with these indices (B,); `mirror` makes left of right."""
        rows, unpacker = picks.tolist(), zstandard.ZstdDecompressor()
        pictures = np.empty((len(rows), PLANES, SIDE, SIDE), np.uint8)
        for picture, row in zip(pictures, rows, strict=True):
            unpacked = decompress_zstd(self._pictures[row], picture.size, unpacker)
            picture.flat[:] = np.frombuffer(unpacked, np.uint8)
        vector = np.stack([self._vectors[row] for row in rows])
        # From float32, as in `Features.batch`: roll-outs in training and driving are equal.
        start = np.stack([self._starts[row] for row in rows]).astype(np.float64)
        unsafe = np.stack([self._unsafe[row] for row in rows])
        if mirror:
            # What turns or leans changes its sign with the sides.
            pictures, unsafe = pictures[..., ::-1].copy(), unsafe[:, self._actions.mirror]
            vector[:, MIRRORED] *= -1.0
            start[:, _MIRRORED_STATE] *= -1.0
        street, *rest = to_tensors(self._extractor, pictures, vector, start)
        return _Batch(
            inputs=(street.contiguous(memory_format=torch.channels_last), *rest),
            unsafe=torch.from_numpy(unsafe).float(),
        )


def to_tensors(extractor: FeatureExtractor, picture: U8, vector: F32, start: F64) -> Inputs:
    """The inputs of the network for B steps of chairs like that of `extractor`.

    Args:
        extractor: Of a chair with the same drive, size and actions.
        picture: (B, PLANES, SIDE, SIDE).
        vector: (B, VECTOR).
        start: (B, 6) where roll-outs start.
    """
    around, chair = extractor.around, extractor.chair
    # (B, A, n) the cells that each action sweeps over.
    swept = np.empty((len(start), len(around.commands), SLICES * EACH_SLICE * len(chair)), np.int32)
    sweep(start, around.commands, around.limits, chair, swept)
    return (
        torch.from_numpy(picture).float().div_(255.0),
        torch.from_numpy(vector),
        torch.from_numpy(swept).long(),
    )


def _label_by_crashes(segment: DrivingSegment, actions: ActionSet, ahead: int, tick_s: float) -> U8:
    """(N, A) which positions led to a crash of the chair's own fault: 1 or 0, or UNKNOWN.

    The executed position and its neighbours have a label, if one of these holds:

    - 1: The position was held, or held and then released, until the crash. And the crash came at
      most `ahead` steps after the position had started to act.
    - 0: It was held for half a second, and no crash came for twice `ahead` steps.

    What follows the end of an episode without a crash is unknown. So is what would have followed
    if another had not driven into the chair.
    """
    rows, points = np.arange(len(segment)), actions.points[segment.action]
    end = _episode_ends(segment)
    # 1. For how many steps the stick of each step was held, and for how many held or released.
    held, held_or_released = np.zeros_like(rows), np.zeros_like(rows)
    released = np.linalg.norm(points, axis=1) <= _SHARED_DISTANCE
    hold_steps = max(0, round(HOLD_S / tick_s) - 1)
    for step in range(1, max(ahead, hold_steps) + 1):
        later, there = np.minimum(rows + step, end), rows + step <= end
        near = np.linalg.norm(points[later] - points, axis=1) <= _HELD_DISTANCE
        # A stick that is released is no longer held, however little it was pushed before.
        same = there & near & (released[later] == released)
        held += same & (held == step - 1)
        held_or_released += (same | (there & released[later])) & (held_or_released == step - 1)

    # 2. For how many steps it acted until the end. The last commands before a crash did not, as
    # each acts only after its delay.
    acting = end - rows - segment.delay.astype(np.int64)
    crashed = segment.own[end] & (acting >= 0) & (acting <= np.minimum(ahead, held_or_released))
    safe = (acting > 2 * ahead) & (held >= hold_steps)
    label = np.where(crashed, 1, np.where(safe, 0, UNKNOWN)).astype(np.uint8)
    return np.where(_near_executed(segment, actions), label[:, None], np.uint8(UNKNOWN))


def _label_by_returns(
    segment: DrivingSegment, actions: ActionSet, reward: RewardConfig, horizon: int
) -> F32:
    """(N, A) how bad the return after a position is, as a share of a crash; or UNKNOWN.

    The return is the discounted reward of Table 2 from the tick on in which the position acted. It
    lacks the reward for the distance of sticks, which is known without learning. The executed
    position and its neighbours have a label. A crash `horizon` steps later counts for little.
    """
    points, rows = actions.points[segment.action], np.arange(len(segment))
    distance = np.minimum(np.linalg.norm(points - segment.stick, axis=1), reward.max_distance)
    rest = segment.reward - reward_of_distance(distance, reward)
    end = _episode_ends(segment)
    returns = np.zeros(len(segment) + 1)
    for row in rows[::-1]:
        returns[row] = rest[row] + (0.0 if row == end[row] else _DISCOUNT * returns[row + 1])
    acts = rows + segment.delay
    # What would follow the last step is unknown, unless that is a crash or far away.
    known = (acts <= end) & (segment.crashed[end] | (end - acts >= horizon))
    share = np.clip(-returns[np.minimum(acts, end)] / reward.crash, 0.0, 1.0)
    label = np.where(known, share, UNKNOWN).astype(np.float32)
    return np.where(_near_executed(segment, actions), label[:, None], np.float32(UNKNOWN))


def _episode_ends(segment: DrivingSegment) -> I64:
    """(N,) the last step of the episode of each step."""
    rows = np.arange(len(segment))
    ends = np.union1d(np.flatnonzero(segment.ended), rows[-1:])
    return ends[np.searchsorted(ends, rows)]


def _near_executed(segment: DrivingSegment, actions: ActionSet) -> Bool:
    """(N, A) which positions share the label of the executed one."""
    gaps = np.linalg.norm(actions.points[:, None] - actions.points, axis=2)
    near: Bool = (gaps <= _SHARED_DISTANCE)[segment.action]
    return near
