"""Drives one segment: fresh worlds, chairs with different users, everything that happens written down."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt

from wcsim.agents.collecting.data_drivers import Choice, DataDriver, Learned
from wcsim.agents.collecting.segment import Segment, SegmentKey, codes_of, joined
from wcsim.agents.collecting.segment_places import SegmentOrder, SegmentPlace, places_of
from wcsim.agents.envs.episode_view import EpisodeStep, Info, delay_ticks
from wcsim.agents.envs.seat_driver import SeatDriver
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, IMU_KEY, JOYSTICK_KEY, ODOMETRY_KEY, Observation
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.supervisor.actions import action_set
from wcsim.types import ClientSnapshot, Truth

MakeLearned = Callable[[int], Learned]  # for a chair whose commands arrive so many ticks late


def collect(order: SegmentOrder, make_learned: MakeLearned | None) -> Segment:
    """The segment that an order asks for; the same one wherever and whenever it is driven.

    Args:
        order: Its worlds are driven one after the other.
        make_learned: The network that drives some of the episodes, where there is one.

    Raises:
        TownError: A town cannot be opened.
        ConfigError: The chairs lack a sense that data needs.
    """
    with TemporaryDirectory(prefix="wcsim-collect-") as work:
        return joined(
            [
                _driven(place, make_learned, _driving_seed(order.key, number))
                for number, place in enumerate(places_of(order, Path(work)))
            ]
        )


def _driving_seed(key: SegmentKey, number: int) -> int:
    """Of who drives, and how, in the world of that number of a segment."""
    return seeding.derive(key.run, "collect", key.round, key.index, "drivers", number)


def _driven(place: SegmentPlace, make_learned: MakeLearned | None, seed: int) -> Segment:
    """Drive for so many ticks, with a new episode wherever one ends."""
    specs = tuple(replace(spec, truth=True, truth_visible=True) for spec in place.seats)
    with World(place.town, place.config, specs, place.seed) as world:
        seats = [
            _Seat(place.config, client, make_learned, seeding.generator(seed, "collect", number))
            for number, client in enumerate(world.snapshot.clients)
        ]
        steps = rollout(world, {number: seat.driver.choose for number, seat in enumerate(seats)})
        for step in islice(steps, place.ticks):
            for seat, client in zip(seats, step.after.clients, strict=True):
                seat.take(client)
    return _segment_of([seat.rows for seat in seats])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _DrivenRow:
    """One step of one chair."""

    seen: Observation
    said: Truth
    choice: Choice
    step: EpisodeStep
    delay: int


class _Seat:
    """One chair with its agent, and what it has written down."""

    def __init__(
        self, config: RunConfig, first: ClientSnapshot, make_learned: MakeLearned | None, rng: np.random.Generator
    ) -> None:
        self.rows: list[_DrivenRow] = []
        self._config, self._make, self._rng = config, make_learned, rng
        self._actions = action_set(config.env.actions)
        self._delay = 0
        self._choice: Choice
        self._agent: DataDriver
        self.driver = SeatDriver(config, self, first)

    def reset(self, info: Info) -> None:
        """Draw who drives the episode that begins."""
        self._delay = delay_ticks(self._config, info["drawn"])
        learned = None if self._make is None else self._make(self._delay)
        self._agent = DataDriver(self._config.collect, self._actions, self._rng, learned)

    def act(self, observation: Observation, info: Info) -> int:
        """Answer what is seen now."""
        said: Truth = info["truth"]
        self._choice = self._agent.choose(observation, said.visible or said)
        return self._choice.action

    def take(self, client: ClientSnapshot) -> None:
        """Write down what came of it."""
        seen, said = self.driver.observation, self.driver.info["truth"]
        step = self.driver.take(client)
        self.rows.append(_DrivenRow(seen=seen, said=said, choice=self._choice, step=step, delay=self._delay))


def _segment_of(chairs: Sequence[Sequence[_DrivenRow]]) -> Segment:
    """The rows of all chairs, one chair after the other; a chair's last step here ends its episode."""
    rows = [row for chair in chairs for row in chair]
    last = [number == len(chair) - 1 for chair in chairs for number in range(len(chair))]
    return Segment(
        depth=_seen(rows, DEPTH_KEY)[:, -1],
        seg=_seen(rows, CLASS_KEY)[:, -1],
        imu=_seen(rows, IMU_KEY),
        odometry=_seen(rows, ODOMETRY_KEY),
        stick=_seen(rows, JOYSTICK_KEY),
        wish=_column(rows, lambda row: row.choice.wish, np.float32),
        action=_column(rows, lambda row: row.choice.action, np.uint8),
        driver=_column(rows, lambda row: row.choice.driver, np.uint8),
        visible=_column(rows, lambda row: codes_of((row.said.visible or row.said).first_s), np.uint8),
        truth=_column(rows, lambda row: codes_of(row.said.first_s), np.uint8),
        reward=_column(rows, lambda row: row.step.reward, np.float32),
        crashed=_column(rows, lambda row: row.step.terminated, np.bool_),
        ended=np.array(last) | _column(rows, lambda row: row.step.done, np.bool_),
        delay=_column(rows, lambda row: row.delay, np.uint8),
    )


def _seen(rows: Sequence[_DrivenRow], key: str) -> npt.NDArray[Any]:
    return np.stack([row.seen[key] for row in rows])


def _column(rows: Sequence[_DrivenRow], take: Callable[[_DrivenRow], Any], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    return np.array([take(row) for row in rows], dtype)
