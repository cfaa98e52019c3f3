"""Memory (a) of the paper: groups of consecutive steps, shuffled before each update.

A group is up to `length` steps of one episode, cut at multiples of `length` from the episode's
start. So groups never overlap and never cross the end of an episode; the last one of an episode is
shorter. Each update shuffles all complete groups that are in the memory and takes the first ones,
so a group is as likely as any other from the moment when it is complete.

The state of a recurrent network is stored, as it was when driven, `burn_in` steps before each group
(or at the start of the episode, where it is zero). Learning runs the network over these steps
again, without loss, so that a state which older weights made is nearly that of the present ones
(R2D2: Kapturowski et al. 2019).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from wcsim.types import F32, I64, U8

if TYPE_CHECKING:
    from wcsim.agents.learning.replay.buffer import FrameReplay

Tensors = dict[str, Tensor]


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceBatch:
    """K groups of up to L steps, each from its first step on.

    P observations reach to the last one that is needed.
    """

    observations: Tensors  # (K, P, ...)
    states: Tensor  # (K, S) as stored, at the start of the burn-in
    # Rows (R,) of K with the same number of steps, and these steps (R, steps, ...).
    burn_in: tuple[tuple[Tensor, Tensors], ...]
    live: Tensor  # (K, L) bool: steps that the group has
    actions: Tensor  # (K, L) int64
    returns: Tensor  # (K, L) float32: unscaled n-step returns
    discounts: Tensor  # (K, L) float32: weight of the value after them
    terminated: Tensor  # (K, L) float32: 1 where nothing comes after them
    after: Tensor  # (K, L) int64: which of the P observations comes after them


class Groups:
    """Draws a memory's groups, and holds the states that were stored for them."""

    def __init__(self, length: int, burn_in: int) -> None:
        self.length, self.burn_in = length, burn_in
        # Of the network that learns from them; without one, nothing is stored or burned in.
        self.state_size = 0
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        # (S,) before the step of (absolute index, seat)
        self.states: dict[tuple[int, int], F32] = {}
        self.next_states: F32 | None = None  # (seats, S) before the step that is added next

    def store_states(self, index: int, episode_step: I64, oldest: int) -> None:
        """Store the states before step `index` of the seats whose burn-in starts with it.

        Those before `oldest` are forgotten.
        """
        while self.states and next(iter(self.states))[0] < oldest:
            self.states.pop(next(iter(self.states)))
        if self.next_states is None or self.state_size == 0:
            return
        states, self.next_states = self.next_states, None
        starts = (episode_step > 0) & ((episode_step + self.burn_in) % self.length == 0)
        for seat in np.flatnonzero(starts).tolist():
            self.states[index, seat] = states[seat].copy()

    def draw(self, memory: FrameReplay, count: int) -> tuple[I64, I64]:
        """First steps (absolute) and seats of `count` groups; none twice, unless there are fewer.

        Raises ValueError when none is complete.
        """
        found = self.complete(memory)
        if len(found) == 0:
            raise ValueError(
                f"replay holds {memory.total} steps and no whole group of {self.length}: raise "
                "learn.learning_starts"
            )
        index, seats = found[memory.rng.choice(len(found), count, replace=count > len(found))].T
        return index, seats

    def complete(self, memory: FrameReplay) -> I64:
        """All complete groups in the memory, (G, 2) of first step and seat.

        Their last step is known, and the observation after it.
        """
        first = memory.total - memory.size()
        rows = np.arange(first, memory.total) % memory.buffer_size
        starts = np.argwhere(memory.episode_step[rows] % self.length == 0)
        index, seats = first + starts[:, 0], starts[:, 1]
        last = index + self.lengths(memory, index, seats) - 1
        ended = memory.ended[last % memory.buffer_size, seats]
        # What follows the newest step is not known yet, unless its episode ended with it.
        followed = (last == index + self.length - 1) & (last < memory.total - 1)
        # Nothing of a group, or of its burn-in, may be overwritten.
        burned = self._burned(memory, index, seats)
        usable = (ended | followed) & (index - burned >= first)
        return np.stack([index[usable], seats[usable]], axis=1)

    def gather(self, memory: FrameReplay, index: I64, seats: I64) -> SequenceBatch:
        """The groups whose first steps these are, with what comes after and before them."""
        # 1. Their steps, (K, L); behind the end of a short group its last step stands again.
        live = np.arange(self.length) < self.lengths(memory, index, seats)[:, None]
        offsets = np.minimum(np.arange(self.length), live.sum(axis=1, keepdims=True) - 1)
        steps = index[:, None] + offsets
        step_seats = np.broadcast_to(seats[:, None], steps.shape)
        # 2. The n-step returns from each of them on.
        chains = memory.chains(steps.reshape(-1), step_seats.reshape(-1))
        shaped = {
            name: getattr(chains, name).reshape(steps.shape)
            for name in ("returns", "discounts", "terminated", "last")
        }
        after = shaped["last"] + 1 - index[:, None]
        # 3. The states before them, and the steps over which these are carried on.
        states, burned = self.stored_states(memory, index, seats)
        to_torch = memory.to_torch
        return SequenceBatch(
            observations=_observations(memory, index, seats, after.max(axis=1)),
            states=to_torch(states, copy=False),
            burn_in=_burn_in_steps(memory, index, seats, burned),
            live=to_torch(live, copy=False),
            actions=to_torch(memory.actions[steps % memory.buffer_size, step_seats], copy=False),
            returns=to_torch(shaped["returns"], copy=False),
            discounts=to_torch(shaped["discounts"], copy=False),
            terminated=to_torch(shaped["terminated"].astype(np.float32), copy=False),
            after=to_torch(after, copy=False),
        )

    def lengths(self, memory: FrameReplay, index: I64, seats: I64) -> I64:
        """How many steps the groups with these first steps have so far, (K,)."""
        steps = index[:, None] + np.arange(self.length)
        ended = memory.ended[steps % memory.buffer_size, seats[:, None]] & (steps < memory.total)
        until_end = np.where(ended.any(axis=1), ended.argmax(axis=1) + 1, self.length)
        return np.minimum(until_end, memory.total - index)

    def stored_states(self, memory: FrameReplay, index: I64, seats: I64) -> tuple[F32, I64]:
        """States (K, S) at the start of the burn-in of these groups, and its steps (K,)."""
        steps = self._burned(memory, index, seats)
        states = np.zeros((len(index), self.state_size), np.float32)
        for k, key in enumerate(zip((index - steps).tolist(), seats.tolist(), strict=True)):
            # None is stored where an episode starts.
            states[k] = self.states.get(key, 0.0)
        return states, steps

    def _burned(self, memory: FrameReplay, index: I64, seats: I64) -> I64:
        """How many steps are burned in before these groups, (K,)."""
        if self.state_size == 0:
            return np.zeros_like(index)
        return np.minimum(memory.episode_step[index % memory.buffer_size, seats], self.burn_in)


def _observations(memory: FrameReplay, index: I64, seats: I64, last: I64) -> Tensors:
    """Observations 0 to `last` (K,) from these steps on, (K, P, ...); zeros behind the last one."""
    places = np.arange(int(last.max()) + 1)
    needed = np.argwhere(places <= last[:, None])
    steps, seat = index[needed[:, 0]] + needed[:, 1], seats[needed[:, 0]]
    # Those after the end of an episode are stored beside the ring.
    ended = memory.ended[(steps - 1) % memory.buffer_size, seat]
    beyond = ended & (needed[:, 1] > 0)
    images = np.zeros((len(index), len(places), memory.layout.image_bytes), np.uint8)
    vectors = np.zeros((len(index), len(places), memory.layout.vector_size), np.float32)
    (row, place), inside = needed[~beyond].T, ~beyond
    images[row, place] = memory.windows.read(steps[inside], seat[inside])
    vectors[row, place] = memory.vectors[steps[inside] % memory.buffer_size, seat[inside]]
    for k in np.flatnonzero(beyond):
        at = tuple(needed[k])
        images[at], vectors[at] = memory.observation_after_end(int(steps[k]) - 1, int(seat[k]))
    return _split(memory, images, vectors)


def _burn_in_steps(
    memory: FrameReplay, index: I64, seats: I64, burned: I64
) -> tuple[tuple[Tensor, Tensors], ...]:
    """The steps before these groups, those of equally many together.

    A network is unrolled over them at once.
    """
    found = []
    for count in sorted(set(burned.tolist()) - {0}):
        rows = np.flatnonzero(burned == count)
        steps = (index[rows, None] - count + np.arange(count)).reshape(-1)
        seat = np.repeat(seats[rows], count)
        images = memory.windows.read(steps, seat).reshape(len(rows), count, -1)
        vectors = memory.vectors[steps % memory.buffer_size, seat].reshape(len(rows), count, -1)
        found.append((memory.to_torch(rows, copy=False), _split(memory, images, vectors)))
    return tuple(found)


def _split(memory: FrameReplay, images: U8, vectors: F32) -> Tensors:
    """Tensors (K, T, ...) by key of image parts (K, T, bytes) and vector parts (K, T, numbers)."""
    shape = images.shape[:2]
    parts = memory.layout.split(
        images.reshape(-1, images.shape[2]), vectors.reshape(-1, vectors.shape[2])
    )
    return {
        key: torch.unflatten(memory.to_torch(value, copy=False), 0, shape)
        for key, value in parts.items()
    }
