"""Recorded driving as the danger network learns from it: features and labels, packed, drawn in batches."""

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
from wcsim.agents.runs.data_folder import BY_EVENTS, ORACLE, DrivingSegment, mask_soon_unsafe_actions, segment_images
from wcsim.config import RewardConfig, RunConfig
from wcsim.core.reading import decompress_zstd
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.supervisor.rewards import reward_of_distance
from wcsim.types import F32, F64, I64, U8

Inputs = tuple[torch.Tensor, ...]
"""Picture, vector and swept cells, see `DangerNet.forward`."""
_START_MIRRORED = (1, 2, 4)  # y, yaw, w
UNKNOWN: Final = 2  # label of a joystick position that nobody tried
_SHARED = 0.26  # so near on the joystick positions share a label: they lie 0.25 apart
_HELD = 0.5  # so near it is the same stick still, in a hand that trembles
_LEVEL = 1  # of zstd
_DISCOUNT: Final = 0.9  # a tick
_HORIZON: Final = 20  # ticks after which a crash says little
_BAD: Final = 0.35  # a step with a label from here on is tight: a crash within a second
CRASH_STEPS: Final = 10  # before a crash, in which the stick that was held counts as unsafe


def _happened(segment: DrivingSegment, actions: ActionSet, ahead: int, tick_s: float) -> U8:
    """(N, A) what became of the positions that were executed: 1 a crash of the chair's own fault, 0 none, or UNKNOWN.

    It is known of the executed one and its neighbours alone. 1: the position was held, or held and let go, until the
    crash, which came at most `ahead` steps after it had begun to act. 0: it was held for half a second, and no crash
    came for twice `ahead` steps. Where an episode was cut, or somebody drove into the chair, nobody knows the rest.
    """
    rows, points = np.arange(len(segment)), actions.points[segment.action]
    ends = np.union1d(np.flatnonzero(segment.ended), rows[-1:])
    end = ends[np.searchsorted(ends, rows)]
    # A command acts only after its delay: the last ones before a crash had no part in it.
    acts = end - rows - segment.delay.astype(np.int64)
    held, kept = np.zeros_like(rows), np.zeros_like(rows)
    rests = np.linalg.norm(points, axis=1) <= _SHARED
    hold = max(0, round(HOLD_S / tick_s) - 1)
    for step in range(1, max(ahead, hold) + 1):
        later, there = np.minimum(rows + step, end), rows + step <= end
        let_go = there & rests[later]
        # A stick that is let go is no longer held, however little it was pushed before.
        same = there & (np.linalg.norm(points[later] - points, axis=1) <= _HELD) & (rests[later] == rests)
        held += same & (held == step - 1)
        kept += (same | let_go) & (kept == step - 1)
    crashed = segment.own[end] & (acts >= 0) & (acts <= np.minimum(ahead, kept))
    passed = (acts > 2 * ahead) & (held >= hold)
    label = np.where(crashed, 1, np.where(passed, 0, UNKNOWN)).astype(np.uint8)
    near = np.linalg.norm(actions.points[:, None] - actions.points, axis=2) <= _SHARED
    return np.where(near[segment.action], label[:, None], np.uint8(UNKNOWN))


def _returns(segment: DrivingSegment, actions: ActionSet, reward: RewardConfig) -> F32:
    """(N, A) what Table 2 took from the moment on in which a stick acted, as a share of a crash; or UNKNOWN.

    It is discounted, and without what is paid for the distance of the sticks, which is known. It is given to the
    executed position and its neighbours alone.
    """
    points, rows = actions.points[segment.action], np.arange(len(segment))
    distance = np.minimum(np.linalg.norm(points - segment.stick, axis=1), reward.max_distance)
    rest = segment.reward - reward_of_distance(distance, reward)
    ends = np.union1d(np.flatnonzero(segment.ended), rows[-1:])
    end = ends[np.searchsorted(ends, rows)]
    sums = np.zeros(len(segment) + 1)
    for row in rows[::-1]:
        sums[row] = rest[row] + (0.0 if row == end[row] else _DISCOUNT * sums[row + 1])
    acts = rows + segment.delay
    # Where an episode was cut, nobody knows the rest.
    known = (acts <= end) & (segment.crashed[end] | (end - acts >= _HORIZON))
    share = np.clip(-sums[np.minimum(acts, end)] / reward.crash, 0.0, 1.0)
    label = np.where(known, share, UNKNOWN).astype(np.float32)
    near = np.linalg.norm(actions.points[:, None] - actions.points, axis=2) <= _SHARED
    return np.where(near[segment.action], label[:, None], np.float32(UNKNOWN))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Batch:
    """What a step of learning gets."""

    inputs: Inputs
    unsafe: torch.Tensor  # (B, A) float32: 1, 0, or UNKNOWN


class Dataset:
    """Draws batches from all steps so far.

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
        self._unsafe: list[U8 | F32] = []  # (A,) 1, 0, between them, or UNKNOWN
        self._tight = np.zeros(0, np.int64)  # steps in which something is unsafe
        self._told = np.zeros(0, np.int64)  # steps of which something is known

    def add(self, segment: DrivingSegment) -> None:
        """Learn from its steps, too; their features are extracted again, as a chair that drives would.

        Raises:
            PolicyError: It has labels for other actions, or the oracle drove though nobody is to learn from it.
        """
        first, unsafe = len(self), self._labels(segment)
        extractors: dict[int, FeatureExtractor] = {}
        begins = True
        for row in range(len(segment)):
            delay = int(segment.delay[row])
            if begins:
                # Where roll-outs begin depends on the delay, which an episode may draw.
                if delay not in extractors:
                    extractors[delay] = FeatureExtractor(self._config, delay)
                extractor = extractors[delay]
                extractor.forget()
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
            # Packed at once: the pictures of a whole segment would take a hundred times the memory.
            self._pictures.append(_packed(features.picture))
            self._vectors.append(features.vector)
            self._starts.append(features.start)
            begins = bool(segment.ended[row])
        self._unsafe += list(unsafe)
        bad = (unsafe >= _BAD) & (unsafe < UNKNOWN)
        self._tight = np.concatenate([self._tight, first + np.flatnonzero(bad.any(axis=1))])
        self._told = np.concatenate([self._told, first + np.flatnonzero((unsafe < UNKNOWN).any(axis=1))])

    def _labels(self, segment: DrivingSegment) -> U8 | F32:
        """(N, A) of its steps, by the teacher that was asked for."""
        danger, actions, labels = self._config.danger, len(self._actions), segment.truth.shape[1]
        if danger.teacher in BY_EVENTS:
            if (segment.driver == ORACLE).any() or segment.action.max() >= actions:
                told = f"a segment was driven by the oracle, or with actions beyond {actions}"
                raise PolicyError(
                    f"{told}; danger.teacher={danger.teacher} expected users and networks: collect it again"
                )
            if danger.teacher == "returns":
                return _returns(segment, self._actions, self._config.reward)
            return _happened(segment, self._actions, danger.ahead, self._config.world.tick_s)
        if labels != actions:
            told = f"a segment has labels for {labels} actions; expected {actions}"
            raise PolicyError(f"{told}: collect it again, with an oracle as danger.teacher")
        codes = segment.truth if danger.teacher == "truth" else segment.visible
        unsafe = mask_soon_unsafe_actions(codes, segment.ended, danger.ahead).astype(np.uint8)
        # What happened overrules the oracle.
        happened = _happened(segment, self._actions, CRASH_STEPS, self._config.world.tick_s)
        unsafe[happened == 1] = 1
        return unsafe

    def begin(self, rng: np.random.Generator) -> None:
        """Draw with this generator from now on."""
        self._rng = rng

    def __len__(self) -> int:
        """How many steps there are."""
        return len(self._pictures)

    @property
    def tight_share(self) -> float:
        """The share of steps in which something is unsafe."""
        return len(self._tight) / max(len(self), 1)

    def draw(self) -> _Batch:
        """A batch, a share of it from steps in which something is unsafe, mirrored half of the time.

        Raises:
            PolicyError: Nothing is known of any step.
        """
        danger, size, rng = self._config.danger, self._config.danger.batch, self._rng
        if not len(self._told):
            raise PolicyError(f"nothing is known of {len(self)} steps; expected longer episodes, or more of them")
        # Steps with a danger are rare. Drawn evenly, they would hardly move the weights.
        tight = round(danger.tight_share * size) if len(self._tight) else 0
        picks = np.concatenate(
            [
                self._tight[rng.integers(0, max(len(self._tight), 1), tight)],
                self._told[rng.integers(0, len(self._told), size - tight)],
            ]
        )
        # A street map lies around the chair wherever its cameras look.
        return self.batch(picks, mirror=bool(rng.random() < 0.5))

    def batch(self, picks: I64, mirror: bool = False) -> _Batch:
        """These steps, (B,)."""
        rows = picks.tolist()
        pictures = _unpacked([self._pictures[row] for row in rows], PLANES * SIDE * SIDE)
        picture = pictures.reshape(-1, PLANES, SIDE, SIDE)
        vector = np.stack([self._vectors[row] for row in rows])
        # Through float32 to float64, as `Features.batch` does: learned and driven roll-outs are equal to the bit.
        start = np.stack([self._starts[row] for row in rows]).astype(np.float64)
        unsafe = np.stack([self._unsafe[row] for row in rows])
        if mirror:
            picture, unsafe = picture[..., ::-1].copy(), unsafe[:, self._actions.mirror]
            # What turns or leans changes its sign with the sides. Otherwise left would teach right the wrong way.
            vector[:, MIRRORED] *= -1.0
            start[:, _START_MIRRORED] *= -1.0
        street, *rest = to_tensors(self._extractor, picture, vector, start)
        return _Batch(
            inputs=(street.contiguous(memory_format=torch.channels_last), *rest),
            unsafe=torch.from_numpy(unsafe).float(),
        )


def to_tensors(extractor: FeatureExtractor, picture: U8, vector: F32, start: F64) -> Inputs:
    """What the network is called with, for a batch of B steps of chairs like that of `extractor`."""
    around, chair = extractor.around, extractor.chair
    # (B, A, n) over which cells each action sweeps.
    swept = np.empty((len(start), len(around.commands), SLICES * EACH_SLICE * len(chair)), np.int32)
    sweep(start, around.commands, around.limits, chair, swept)
    return (
        torch.from_numpy(picture).float().div_(255.0),
        torch.from_numpy(vector),
        torch.from_numpy(swept).long(),
    )


def _packed(frame: U8) -> bytes:
    """A frame as a compressed blob."""
    # Copied: a blob as it comes lies in a block for a frame that cannot be compressed, whose rest is lost.
    return bytes(memoryview(zstandard.ZstdCompressor(level=_LEVEL).compress(frame.tobytes())))


def _unpacked(blobs: list[bytes], size: int) -> U8:
    """The frames of blobs, (K, size)."""
    unpacker, out = zstandard.ZstdDecompressor(), np.empty((len(blobs), size), np.uint8)
    for row, blob in zip(out, blobs, strict=True):
        row[:] = np.frombuffer(decompress_zstd(blob, size, unpacker), np.uint8)
    return out
