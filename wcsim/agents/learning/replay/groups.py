"""Memory (a) of the paper: groups of consecutive steps, shuffled before each update.

A group is a run of `length` steps of one episode, cut at multiples of `length` from the episode's start, so groups
never overlap and never cross the end of an episode; the last one of an episode is shorter. Each update shuffles all
whole groups that are in the memory and takes the first ones, so a group is as likely as any other from the moment when
it is whole.

The state of a recurrent network is stored, as it was when driven, `burn_in` steps before each group (or at the start of
the episode, where it is zero): learning runs the network over these steps again, without loss, so that a state which
older weights made is nearly that of the present ones (R2D2: Kapturowski et al. 2019).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import torch

from wcsim.types import F32, I64, Bool

if TYPE_CHECKING:
    from wcsim.agents.learning.replay.buffer import FrameReplay

Tensors = dict[str, torch.Tensor]


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceBatch:
    """K groups of up to L steps, each from its first step on; P observations reach to the last one that is needed."""

    observations: Tensors  # (K, P, ...)
    states: torch.Tensor  # (K, S) as stored, at the beginning of the burn-in
    burn_in: tuple[
        tuple[torch.Tensor, Tensors], ...
    ]  # rows (R,) of K with the same number of steps, (R, steps, ...)
    live: torch.Tensor  # (K, L) bool: steps that the group has
    actions: torch.Tensor  # (K, L) int64
    returns: torch.Tensor  # (K, L) float32: unscaled n-step returns
    discounts: torch.Tensor  # (K, L) float32: weight of the value after them
    terminated: torch.Tensor  # (K, L) float32: 1 where nothing comes after them
    after: torch.Tensor  # (K, L) int64: which of the P observations comes after them


class Groups:
    """Draws a memory's groups, and holds the states that were stored for them."""

    def __init__(self, length: int, burn_in: int) -> None:
        self.length, self.burn_in = length, burn_in
        self.state_size = 0  # of the network that learns from them; nothing is stored or burned in for one without
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.states: dict[
            tuple[int, int], F32
        ] = {}  # (S,) before the step of (absolute index, seat)
        self.coming: F32 | None = None  # (seats, S) before the step that is added next

    def note(self, index: int, episode_step: I64, oldest: int) -> None:
        """Store the coming states of the seats whose step `index` begins a burn-in; forget those before `oldest`."""
        while self.states and next(iter(self.states))[0] < oldest:
            self.states.pop(next(iter(self.states)))
        if self.coming is None or self.state_size == 0:
            return
        coming, self.coming = self.coming, None
        begins = (episode_step > 0) & ((episode_step + self.burn_in) % self.length == 0)
        for seat in np.flatnonzero(begins).tolist():
            self.states[index, seat] = coming[seat].copy()

    def draw(self, memory: FrameReplay, count: int) -> tuple[I64, I64]:
        """First steps (absolute) and seats of `count` groups; none twice, unless there are fewer.

        Raises ValueError when there is no whole one.
        """
        found = self.whole(memory)
        if len(found) == 0:
            raise ValueError(
                f"replay holds {memory.total} steps and no whole group of {self.length}: raise learn.learning_starts"
            )
        index, seats = found[memory.rng.choice(len(found), count, replace=count > len(found))].T
        return index, seats

    def whole(self, memory: FrameReplay) -> I64:
        """All whole groups in the memory, (G, 2) of first step and seat: their last step is known, and what follows."""
        first = memory.total - memory.size()
        rows = np.arange(first, memory.total) % memory.buffer_size
        begins = np.argwhere(memory.episode_step[rows] % self.length == 0)
        index, seats = first + begins[:, 0], begins[:, 1]
        last = index + self.lengths(memory, index, seats) - 1
        ends = memory.ended[last % memory.buffer_size, seats]
        known = ends | ((last == index + self.length - 1) & (last < memory.total - 1))
        kept = known & self._reaches_back(memory, index, seats)
        return np.stack([index[kept], seats[kept]], axis=1)

    def gather(self, memory: FrameReplay, index: I64, seats: I64) -> SequenceBatch:
        """The groups that begin at these steps, with what comes after them and before them."""
        live = np.arange(self.length) < self.lengths(memory, index, seats)[:, None]
        steps = index[:, None] + np.minimum(
            np.arange(self.length), live.sum(axis=1, keepdims=True) - 1
        )
        every = np.broadcast_to(seats[:, None], steps.shape)
        chains = memory.chains(steps.reshape(-1), every.reshape(-1))
        shaped = {
            name: getattr(chains, name).reshape(steps.shape)
            for name in ("returns", "discounts", "terminated", "last")
        }
        after = shaped["last"] + 1 - index[:, None]
        states, burned = self.stored(memory, index, seats)
        to_torch = memory.to_torch
        return SequenceBatch(
            observations=_observations(memory, index, seats, after.max(axis=1)),
            states=to_torch(states, copy=False),
            burn_in=_burn_ins(memory, index, seats, burned),
            live=to_torch(live, copy=False),
            actions=to_torch(memory.actions[steps % memory.buffer_size, every], copy=False),
            returns=to_torch(shaped["returns"], copy=False),
            discounts=to_torch(shaped["discounts"], copy=False),
            terminated=to_torch(shaped["terminated"].astype(np.float32), copy=False),
            after=to_torch(after, copy=False),
        )

    def lengths(self, memory: FrameReplay, index: I64, seats: I64) -> I64:
        """How many steps the groups that begin there have so far, (K,)."""
        steps = index[:, None] + np.arange(self.length)
        ended = memory.ended[steps % memory.buffer_size, seats[:, None]] & (steps < memory.total)
        until_end = np.where(ended.any(axis=1), ended.argmax(axis=1) + 1, self.length)
        return np.minimum(until_end, memory.total - index)

    def stored(self, memory: FrameReplay, index: I64, seats: I64) -> tuple[F32, I64]:
        """States (K, S) where the burn-in of these groups begins, and its steps (K,)."""
        steps = self._burned(memory, index, seats)
        states = np.zeros((len(index), self.state_size), dtype=np.float32)
        for k, key in enumerate(zip((index - steps).tolist(), seats.tolist(), strict=True)):
            states[k] = self.states.get(key, 0.0)  # none is kept where an episode begins
        return states, steps

    def _burned(self, memory: FrameReplay, index: I64, seats: I64) -> I64:
        if self.state_size == 0:
            return np.zeros_like(index)
        return np.minimum(memory.episode_step[index % memory.buffer_size, seats], self.burn_in)

    def _reaches_back(self, memory: FrameReplay, index: I64, seats: I64) -> Bool:
        """Whether nothing of the groups, and of their burn-in, was overwritten."""
        first = memory.total - memory.size()
        here = index >= first
        return here & (index - self._burned(memory, np.where(here, index, first), seats) >= first)


def _observations(memory: FrameReplay, index: I64, seats: I64, last: I64) -> Tensors:
    """Observations 0 to `last` (K,) from these steps on, (K, P, ...); what is behind the last one is zero."""
    places = np.arange(int(last.max()) + 1)
    wanted = np.argwhere(places <= last[:, None])
    steps, seat = index[wanted[:, 0]] + wanted[:, 1], seats[wanted[:, 0]]
    beyond = memory.ended[(steps - 1) % memory.buffer_size, seat] & (
        wanted[:, 1] > 0
    )  # after the end of an episode
    images = np.zeros((len(index), len(places), memory.layout.image_bytes), dtype=np.uint8)
    vectors = np.zeros((len(index), len(places), memory.layout.vector_size), dtype=np.float32)
    (row, place), inside = wanted[~beyond].T, ~beyond
    images[row, place] = memory.windows.read(steps[inside], seat[inside])
    vectors[row, place] = memory.vectors[steps[inside] % memory.buffer_size, seat[inside]]
    for k in np.flatnonzero(beyond):
        at = tuple(wanted[k])
        images[at], vectors[at] = memory.observation_after_end(int(steps[k]) - 1, int(seat[k]))
    return _split(memory, images, vectors)


def _burn_ins(
    memory: FrameReplay, index: I64, seats: I64, burned: I64
) -> tuple[tuple[torch.Tensor, Tensors], ...]:
    """Groups with equally many steps before them together: a network is unrolled over them at once."""
    found = []
    for count in sorted(set(burned.tolist()) - {0}):
        rows = np.flatnonzero(burned == count)
        steps = (index[rows, None] - count + np.arange(count)).reshape(-1)
        seat = np.repeat(seats[rows], count)
        images = memory.windows.read(steps, seat).reshape(len(rows), count, -1)
        vectors = memory.vectors[steps % memory.buffer_size, seat].reshape(len(rows), count, -1)
        found.append((memory.to_torch(rows, copy=False), _split(memory, images, vectors)))
    return tuple(found)


def _split(memory: FrameReplay, images: npt.NDArray[np.uint8], vectors: F32) -> Tensors:
    shape = images.shape[:2]
    parts = memory.layout.split(
        images.reshape(-1, images.shape[2]), vectors.reshape(-1, vectors.shape[2])
    )
    return {
        key: torch.unflatten(memory.to_torch(value, copy=False), 0, shape)
        for key, value in parts.items()
    }
