"""Several wheelchairs in one world, all driven from here: what PettingZoo's and SB3's faces are made of."""

from __future__ import annotations

import copy
from collections.abc import Sequence

from wcsim.agents.envs.env_spec import SEED_LIMIT, Face, drawn_seed
from wcsim.agents.envs.episode_view import Chair, Info
from wcsim.errors import ProtocolError
from wcsim.server.links.base import WorldLink
from wcsim.server.links.group import SeatGroup, open_group
from wcsim.supervisor.observation import Observation
from wcsim.supervisor.reward_terms import RewardTerm


class Chairs:
    """The chairs of a world, by seat; the world is made by the first `begin`."""

    def __init__(self, face: Face, count: int, terms: Sequence[RewardTerm] = ()) -> None:
        """So many chairs, each with a copy of the user's own reward terms, which remember one episode each."""
        self.face = face
        self.all = [Chair(face.config, copy.deepcopy(tuple(terms))) for _ in range(count)]
        self._group: SeatGroup | None = None

    @property
    def open(self) -> bool:
        """Whether there is a world, and no step of it was interrupted."""
        return self._group is not None and not any(link.interrupted for link in self._group.links)

    def begin(self, seed: int | None) -> list[tuple[Observation, Info]]:
        """Begin everybody's first episode in a world made anew; without a seed, with one drawn from the system."""
        seed = (drawn_seed() if seed is None else seed) % SEED_LIMIT
        if not self.open:
            self.close()
        if self._group is None:
            self._group = open_group(self.face.order(seed, len(self.all)))
            frames = self._group.join()
        else:
            frames = self._group.begin_again(seed)
        return [chair.begin(frame) for chair, frame in zip(self.all, frames, strict=True)]

    def begin_next(self) -> list[tuple[Observation, Info]]:
        """Begin everybody's next episode where the world is now, without a tick."""
        if self._group is None or not self.open:
            return self.begin(None)
        frames = self._group.respawn()
        return [chair.begin(frame) for chair, frame in zip(self.all, frames, strict=True)]

    def link(self, seat: int) -> WorldLink:
        """The link of a seat. Raises ProtocolError when there is no world."""
        if self._group is None:
            raise ProtocolError("step() came before reset(); call reset() first")
        return self._group.links[seat]

    def close(self) -> None:
        """End the world; a second call does nothing."""
        group, self._group = self._group, None
        for chair in self.all:
            chair.now = None
        if group is not None:
            group.close()
