"""Replay memory for image observations: each frame is stored once.

The next observation of a row is that of the next row. Of a window of frames, too, a row
stores the newest alone (`agents/learning/replay/frame_store.py`).

A chain of rows ends where an episode ends (crash, time limit, a world that was restarted) or where
the next step did not continue this one (the environment was reset from outside). The observation
after the end of a chain is stored beside the ring, so that a truncated episode bootstraps from its
true last observation. n-step returns never cross an end of a chain; at the newest row, whose
successor is not known yet, they are shorter.

What is drawn: single steps, uniformly (`memory` "steps", or "windows" where an observation is a
window of frames: memory (b) of the paper), or groups of steps in a row
(`agents/learning/replay/groups.py`: memory (a)).

An observation is cut into a flat image part (bytes) and a flat vector part (float32), and put
together again from them. Images of float32 are stored as their bytes. The image part of a window is
its frames one after the other, the newest last; a frame is all images of one moment.

Safe actions of every step are a training aid from the privileged truth, never an observation. The
environment reports them in `info["objects"]` of the step that leads to an observation. The first
observation of an episode comes from a reset, whose info Stable-Baselines3 does not hand to the
memory: that row stays without advice.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.utils import get_device
from stable_baselines3.common.vec_env import VecNormalize

from wcsim.agents.envs.episode_view import OBJECTS, WORLD_RESTARTED, Info
from wcsim.agents.learning.replay.frame_store import PACK_ABOVE_BYTES, BlobCodec, WindowStore
from wcsim.agents.learning.replay.groups import Groups, SequenceBatch, Tensors
from wcsim.agents.networks.q_network import Array
from wcsim.agents.policy_api import DEPTH_KEY
from wcsim.config import LearnConfig
from wcsim.core import seeding
from wcsim.errors import PolicyError
from wcsim.supervisor.observation import Observation
from wcsim.types import F32, I64, U8, Bool

Advice = tuple[Tensors, torch.Tensor]
"""Observations (B, ...), and which actions end well in them, (B, A) bool."""
Shapes = tuple[tuple[str, tuple[int, ...]], ...]
_Steps = deque[tuple[int, int]]  # (absolute index, seat), oldest first


class FrameReplay(ReplayBuffer):
    """A ring of steps, `buffer_size` frames in all seats together, as SB3's algorithms use it.

    Rows are addressed by their absolute index (steps added before them), which never repeats. Only
    with `learn.aid` it stores which actions end well, too.
    """

    precrash_window = 20  # steps before a crash of which a share of each batch is drawn

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        device: torch.device | str = "auto",
        n_envs: int = 1,
        optimize_memory_usage: bool = False,
        settings: LearnConfig | None = None,
        seed: int = 0,
    ) -> None:
        settings = settings or LearnConfig()
        # SB3's own constructor would allocate two uncompressed copies of every frame.
        self.observation_space = observation_space
        self.action_space = action_space
        self.device = get_device(device)
        self.n_envs = n_envs
        self.action_dim = 1
        self.optimize_memory_usage = optimize_memory_usage
        self.handle_timeout_termination = True
        least = 2
        if settings.memory == "groups":
            least = 2 * settings.group_steps + settings.burn_in + 1
        rows = max(buffer_size // n_envs, settings.n_step + 1, least)
        self.buffer_size = rows
        self.n_step = settings.n_step
        self.gamma = settings.gamma
        self.precrash_share = settings.precrash_share
        self.layout = _layout_of(observation_space)
        self.rng = seeding.make_rng(seed, "agent", "replay")
        self.groups: Groups | None = None
        if settings.memory == "groups":
            self.groups = Groups(settings.group_steps, settings.burn_in)
        layout = self.layout
        self.windows = WindowStore(
            rows, n_envs, layout.window, layout.frame_bytes, layout.depth_bytes
        )
        self._end_codec = BlobCodec(layout.image_bytes, 0)
        self.vectors = np.zeros((rows, n_envs, layout.vector_size), np.float32)
        self.actions = np.zeros((rows, n_envs), np.int64)
        self.rewards = np.zeros((rows, n_envs), np.float32)
        self.ended = np.zeros((rows, n_envs), bool)
        self.terminated = np.zeros((rows, n_envs), bool)
        # Steps since the start of the chain.
        self.episode_step = np.zeros((rows, n_envs), np.int64)
        self.advised = settings.aid == "oracle"
        self._action_count = int(action_space.n) if isinstance(action_space, spaces.Discrete) else 0
        # 1 where safe, packed
        advice_bytes = (self._action_count + 7) // 8
        self.advice_bits = np.zeros((rows, n_envs, advice_bytes), np.uint8)
        self.advice_known = np.zeros((rows, n_envs), bool)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.total = 0  # steps added per seat, ever
        self.pos = 0
        self.full = False
        self.ended[:] = False
        self.terminated[:] = False
        self.advice_known[:] = False
        self.windows.reset()
        # Images, packed where they are large, and vectors, by (absolute index, seat).
        self.after_end: dict[tuple[int, int], tuple[U8 | bytes, F32]] = {}
        # A batch is drawn at almost every step: lists, for a search would read the whole memory
        # each time.
        self.crashes = _Steps()
        self.advised_steps = _Steps()
        self.unsafe_steps = _Steps()  # those of them in which some action ends badly
        self.expected: tuple[U8, F32] | None = None  # the observations that should come next
        self._next_truths: list[Any] = []  # of the next row, by seat
        if self.groups is not None:
            self.groups.reset()

    def add(
        self,
        obs: Observation,  # type: ignore[override]
        next_obs: Observation,  # type: ignore[override]
        action: Array,
        reward: Array,
        done: Array,
        infos: list[Info],
    ) -> None:
        """Store one step of every seat.

        `next_obs` holds the terminal observation of a seat that is done. A step that no seat has
        driven, as its world was restarted, is left out: the one before leads to its observation.
        """
        images, vectors = self.layout.image_rows(obs), self.layout.vector_rows(obs)
        # 1. A chain ends where this step does not continue it, and where its world was restarted.
        restarted = all(info.get(WORLD_RESTARTED) for info in infos)
        if self.total > 0:
            last = self.total - 1
            ended = self.ended[last % self.buffer_size]
            for seat in np.flatnonzero(~ended).tolist():
                if restarted or not self._is_expected(images, vectors, seat):
                    ended[seat] = True
                    self._store_expected(last, seat)
        if restarted:
            return
        # 2. What belongs to the row that is overwritten goes with it.
        row = self.pos
        self._forget(self.total - self.buffer_size)
        # 3. The observation, and where in its chain it is.
        previous = (row - 1) % self.buffer_size
        starts = self.ended[previous] if self.total > 0 else np.ones(self.n_envs, bool)
        self.windows.write(self.total, images, starts)
        self.vectors[row] = vectors
        self.episode_step[row] = np.where(starts, 0, self.episode_step[previous] + 1)
        # 4. What goes with the observation: advice, and the states before groups.
        self._store_advice(row, starts, infos)
        if self.groups is not None:
            oldest = self.total + 1 - self.buffer_size
            self.groups.store_states(self.total, self.episode_step[row], oldest)
        # 5. The action and its outcome.
        self.actions[row] = np.asarray(action).reshape(self.n_envs)
        self.rewards[row] = reward
        self.ended[row] = np.asarray(done, bool)
        timeouts = [bool(info.get("TimeLimit.truncated", False)) for info in infos]
        self.terminated[row] = self.ended[row] & ~np.array(timeouts, bool)
        # 6. The observation after it is the next row, but for seats whose episode ends here.
        self.expected = (self.layout.image_rows(next_obs), self.layout.vector_rows(next_obs))
        for seat in np.flatnonzero(self.ended[row]).tolist():
            self._store_expected(self.total, seat)
            if self.terminated[row, seat]:
                self.crashes.append((self.total, seat))
        self.total += 1
        self.pos = (row + 1) % self.buffer_size
        self.full = self.full or self.pos == 0

    def list_advice(self, index: int, seat: int, *, some_unsafe: bool) -> None:
        """List a step with advice as the newest one."""
        self.advised_steps.append((index, seat))
        if some_unsafe:
            self.unsafe_steps.append((index, seat))

    def sample(  # type: ignore[override]
        self, batch_size: int, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """A batch of n-step transitions; rewards are unscaled returns.

        Of a memory of groups, all steps of as many groups as make up about `batch_size` steps.
        `env` is ignored: nothing is normalised.
        """
        if self.groups is None:
            return self.gather(*self.draw(batch_size))
        index, seats = self.groups.draw(self, max(1, round(batch_size / self.groups.length)))
        count = self.groups.lengths(self, index, seats)
        steps = np.concatenate([np.arange(k, k + n) for k, n in zip(index, count, strict=True)])
        return self.gather(steps, np.repeat(seats, count))

    def sample_groups(self, batch_size: int) -> SequenceBatch:
        """As many groups as make up about `batch_size` steps, with their stored states.

        Raises ValueError when no group is complete, or the memory is none of groups.
        """
        if self.groups is None:
            raise ValueError("replay holds single steps; build it with memory='groups'")
        drawn = self.groups.draw(self, max(1, round(batch_size / self.groups.length)))
        return self.groups.gather(self, *drawn)

    def draw(self, batch_size: int) -> tuple[I64, I64]:
        """Start rows (absolute) and seats of a batch, a share of them from before crashes.

        Raises ValueError when fewer than two steps are stored.
        """
        if self.total < 2:
            raise ValueError(
                f"replay holds {self.total} steps; expected at least 2: raise learn.learning_starts"
            )
        first = self.total - self.size()
        seats = self.rng.integers(0, self.n_envs, batch_size)
        # The newest row has no successor to bootstrap from, unless its episode ended with it.
        known = self.total - 1 - first + self.ended[(self.total - 1) % self.buffer_size, seats]
        starts = first + np.floor(self.rng.random(batch_size) * known).astype(np.int64)
        count = round(self.precrash_share * batch_size)
        if count > 0 and self.crashes:
            # Steps 0..window-1 before crashes, within their episodes and the ring.
            index, crashed = self._draw_listed(self.crashes, count).T
            steps = self.episode_step[index % self.buffer_size, crashed]
            back = np.minimum(
                self.rng.integers(0, self.precrash_window, count), np.minimum(steps, index - first)
            )
            starts[:count], seats[:count] = index - back, crashed
        return starts, seats

    def gather(self, starts: I64, seats: I64) -> DictReplayBufferSamples:
        """The transitions that start at these rows."""
        chains = self.chains(starts, seats)
        now = self._observations(starts, seats)
        after = self._observations_after(chains, seats)
        actions = self.actions[starts % self.buffer_size, seats]
        return DictReplayBufferSamples(
            observations=now,
            actions=self.to_torch(actions[:, None], copy=False),
            next_observations=after,
            dones=self.to_torch(chains.terminated.astype(np.float32)[:, None], copy=False),
            rewards=self.to_torch(chains.returns[:, None], copy=False),
            discounts=self.to_torch(chains.discounts[:, None], copy=False),
        )

    def sample_advice(self, count: int, unsafe_share: float, ahead: int = 0) -> Advice | None:
        """Observations and their safe actions; None when none is known.

        A share of them is drawn from steps in which some action is not safe. An action that ends
        badly in one of the next `ahead` steps of the episode counts as unsafe already, as long as
        another one is left.

        Raises ValueError when the memory was built without `advice`.
        """
        if not self.advised:
            raise ValueError(
                "replay stores no advice; build it with advice=True (learn.aid=oracle)"
            )
        if not self.advised_steps:
            return None
        unsafe = round(unsafe_share * count) if self.unsafe_steps else 0
        drawn = [
            self._draw_listed(self.unsafe_steps, unsafe),
            self._draw_listed(self.advised_steps, count - unsafe),
        ]
        index, seats = np.concatenate(drawn).T
        safe = self._safe_ahead(index, seats, ahead)
        return self._observations(index, seats), self.to_torch(safe, copy=False)

    def safe_actions(self, index: I64, seats: I64) -> Bool:
        """Which actions end well in these steps, (..., A)."""
        packed = self.advice_bits[index % self.buffer_size, seats]
        return np.unpackbits(packed, axis=-1, count=self._action_count).astype(bool)

    def chains(self, starts: I64, seats: I64) -> _Chains:
        """Follow each start for up to n steps, to the end of its chain or the newest known row."""
        returns = np.zeros(len(starts), np.float64)
        discounts = np.ones(len(starts), np.float64)
        last = starts.copy()
        alive = np.ones(len(starts), bool)
        for step in range(self.n_step):
            index = starts + step
            rows = index % self.buffer_size
            # The newest row counts only where its episode ended with it.
            newest = (index == self.total - 1) & self.ended[rows, seats]
            alive &= (index < self.total - 1) | newest
            returns += np.where(alive, discounts * self.rewards[rows, seats], 0.0)
            discounts = np.where(alive, discounts * self.gamma, discounts)
            last = np.where(alive, index, last)
            alive &= ~self.ended[rows, seats]
        at = last % self.buffer_size
        return _Chains(
            returns=returns.astype(np.float32),
            discounts=discounts.astype(np.float32),
            terminated=self.terminated[at, seats],
            last=last,
            ended=self.ended[at, seats],
        )

    def observation_after_end(self, index: int, seat: int) -> tuple[U8, F32]:
        """Images and vectors after the last step of a chain."""
        image, vector = self.after_end[index, int(seat)]
        return self._end_codec.unpack(image) if isinstance(image, bytes) else image, vector

    def store_end(self, index: int, seat: int, image: U8, vector: F32) -> None:
        """Store images and vectors after the last step of a chain."""
        is_large = len(image) > PACK_ABOVE_BYTES
        packed = self._end_codec.pack(image) if is_large else image.copy()
        self.after_end[index, seat] = packed, vector.copy()

    def _is_expected(self, images: U8, vectors: F32, seat: int) -> bool:
        """Whether a seat's observation is the one that its last step led to."""
        if self.expected is None:
            return True
        next_images, next_vectors = self.expected
        return np.array_equal(images[seat], next_images[seat]) and np.array_equal(
            vectors[seat], next_vectors[seat]
        )

    def _store_expected(self, index: int, seat: int) -> None:
        if self.expected is not None:
            images, vectors = self.expected
            self.store_end(index, seat, images[seat], vectors[seat])

    def _forget(self, index: int) -> None:
        """Drop what belongs to the step that is overwritten now."""
        for seat in range(self.n_envs):
            self.after_end.pop((index, seat), None)
        for listed in (self.crashes, self.advised_steps, self.unsafe_steps):
            while listed and listed[0][0] <= index:
                listed.popleft()

    def _store_advice(self, row: int, starts: Bool, infos: Sequence[Info]) -> None:
        """Store the advice of a step; its `infos` hold that of the next one."""
        for seat, is_start in enumerate(starts):
            truth = None if is_start or not self._next_truths else self._next_truths[seat]
            self.advice_known[row, seat] = truth is not None
            if truth is not None:
                safe = np.asarray(truth.safe_actions, bool)
                self.advice_bits[row, seat] = np.packbits(safe)
                self.list_advice(self.total, seat, some_unsafe=not safe.all())
        self._next_truths = [
            getattr(info.get(OBJECTS), "truth", None) if self.advised else None for info in infos
        ]

    def _observations(self, index: I64, seats: I64) -> Tensors:
        """The observations of these steps, (K, ...) each."""
        vectors = self.vectors[index % self.buffer_size, seats]
        return self._tensors(self.windows.read(index, seats), vectors)

    def _observations_after(self, chains: _Chains, seats: I64) -> Tensors:
        """The observations after these chains, (K, ...) each."""
        images = self.windows.read(chains.last + 1, seats)
        vectors = self.vectors[(chains.last + 1) % self.buffer_size, seats]
        for k in np.flatnonzero(chains.ended):
            images[k], vectors[k] = self.observation_after_end(int(chains.last[k]), int(seats[k]))
        return self._tensors(images, vectors)

    def _tensors(self, images: U8, vectors: F32) -> Tensors:
        parts = self.layout.split(images, vectors)
        return {key: self.to_torch(value, copy=False) for key, value in parts.items()}

    def _safe_ahead(self, index: I64, seats: I64, ahead: int) -> Bool:
        """Which actions end well in these steps and the next ones, as long as one is left."""
        safe, at = self.safe_actions(index, seats), index
        for _ in range(ahead):
            goes_on = ~self.ended[at % self.buffer_size, seats] & (at < self.total - 1)
            at = np.where(goes_on, at + 1, at)
            both = safe & self.safe_actions(at, seats)
            safe = np.where(both.any(axis=1, keepdims=True), both, safe)
        return safe

    def _draw_listed(self, listed: _Steps, count: int) -> I64:
        """Absolute index and seat, (count, 2), of some of these steps."""
        picks = self.rng.integers(0, max(len(listed), 1), count)
        return np.array([listed[k] for k in picks], np.int64).reshape(-1, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Chains:
    """n-step chains from K start rows."""

    returns: F32  # (K,) discounted rewards up to and including the last step
    discounts: F32  # (K,) gamma ** length, the weight of the value after the last step
    terminated: Bool  # (K,) the last step crashed: nothing comes after it
    last: I64  # (K,) absolute index of the last step
    ended: Bool  # (K,) the observation after the last step is stored beside the ring


@dataclass(frozen=True, slots=True, kw_only=True)
class _ObservationLayout:
    """Which keys of an observation are images and which are vectors (float32), with shapes."""

    images: Shapes  # by name, as the vectors
    vectors: Shapes
    item_bytes: int = 1  # of a number of an image: uint8, or 4 for float32

    @property
    def window(self) -> int:
        """Frames in one observation.

        The smallest first dimension of its images, where it divides them all; else 1.
        """
        firsts = [shape[0] if len(shape) > 2 else 1 for _, shape in self.images] or [1]
        return min(firsts) if all(first % min(firsts) == 0 for first in firsts) else 1

    @property
    def frame_bytes(self) -> int:
        """Bytes of all images at one moment."""
        return self.image_bytes // self.window

    @property
    def depth_bytes(self) -> int:
        """How many bytes at a frame's start are of depth."""
        if not self.images or self.item_bytes != 1:
            return 0
        key, shape = self.images[0]
        return int(np.prod(shape)) // self.window if key == DEPTH_KEY else 0

    @property
    def image_bytes(self) -> int:
        """Bytes of all images of one observation."""
        return self.item_bytes * sum(int(np.prod(shape)) for _, shape in self.images)

    @property
    def vector_size(self) -> int:
        """Numbers in all vectors of one observation."""
        return sum(int(np.prod(shape)) for _, shape in self.vectors)

    def image_rows(self, batch: Observation) -> U8:
        """Images of a batch side by side, (N, image_bytes)."""
        count, frames = len(next(iter(batch.values()))), self.window
        if not self.images:
            return np.zeros((count, 0), np.uint8)
        parts = [
            np.asarray(batch[key], self._dtype).reshape(count, frames, -1) for key, _ in self.images
        ]
        # As bytes: the stores behind it know no floats, and the same bits come back.
        return np.concatenate(parts, axis=2).reshape(count, -1).view(np.uint8)

    def vector_rows(self, batch: Observation) -> F32:
        """Vectors of a batch side by side, (N, vector_size)."""
        count = len(next(iter(batch.values())))
        if not self.vectors:
            return np.zeros((count, 0), np.float32)
        parts = [np.asarray(batch[key], np.float32).reshape(count, -1) for key, _ in self.vectors]
        return np.concatenate(parts, axis=1)

    def split(self, images: U8, vectors: F32) -> Observation:
        """The batch of observations that these rows were made of; the parts are views."""
        pictures = np.ascontiguousarray(images).view(self._dtype)
        return {**_parts(pictures, self.images, self.window), **_parts(vectors, self.vectors, 1)}

    @property
    def _dtype(self) -> type[np.uint8] | type[np.float32]:
        return np.uint8 if self.item_bytes == 1 else np.float32


def _layout_of(space: spaces.Space[Any]) -> _ObservationLayout:
    """The layout of an observation space.

    Raises:
        PolicyError: It is not a Dict of uint8 and float32 boxes, or has images of both kinds.
    """
    if not isinstance(space, spaces.Dict):
        raise PolicyError(
            f"observation space is {space}; expected a Dict of boxes: set env.observation=compact"
        )
    images: list[tuple[str, tuple[int, ...]]] = []
    vectors: list[tuple[str, tuple[int, ...]]] = []
    for key, box in sorted(space.spaces.items()):
        if not isinstance(box, spaces.Box) or box.dtype not in (np.uint8, np.float32):
            raise PolicyError(f"observation {key!r} is {box}; expected a Box of uint8 or float32")
        is_image = box.dtype == np.uint8 or len(box.shape) > 2
        (images if is_image else vectors).append((key, tuple(box.shape)))
    sizes = {space[key].dtype.itemsize for key, _ in images} or {1}  # type: ignore[union-attr]
    if len(sizes) > 1:
        raise PolicyError(
            f"images of {space} are of uint8 and float32; expected one kind: see env.observation"
        )
    return _ObservationLayout(images=tuple(images), vectors=tuple(vectors), item_bytes=sizes.pop())


def _parts(rows: Array, shapes: Shapes, frames: int) -> Observation:
    out: Observation = {}
    by_frame = rows.reshape(len(rows), frames, rows.shape[1] // frames)
    start = 0
    for key, shape in shapes:
        stop = start + int(np.prod(shape)) // frames
        out[key] = by_frame[:, :, start:stop].reshape(len(rows), *shape)
        start = stop
    return out
