"""An environment on a seat that was taken before it was made, as when the server says what the world is."""

from __future__ import annotations

from collections.abc import Sequence

from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.config import RunConfig
from wcsim.server.links.base import WorldLink
from wcsim.supervisor.reward_terms import RewardTerm
from wcsim.types import ClientSnapshot


class SeatedEnv(WheelchairEnv):
    """A `WheelchairEnv` in a joined world whose link is there already; the environment closes it."""

    def __init__(
        self, link: WorldLink, config: RunConfig, town: str = "", reward_terms: Sequence[RewardTerm] = ()
    ) -> None:
        """Use this link; cameras and actions of the configuration are the server's."""
        super().__init__(town, config=config, reward_terms=reward_terms)
        self._seat = link

    def _open(self, seed: int | None) -> ClientSnapshot:
        """The frame that the seat has; the world's seed is the server's."""
        del seed
        self._link = self._seat
        return self._seat.join()
