"""Drives one segment: a fresh world, chairs with different users, everything that happens written down."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from wcsim.agents.collecting.data_drivers import Choice, DataDriver, Learned
from wcsim.agents.collecting.segment import Segment, codes_of
from wcsim.agents.envs.episode_view import Chair, EpisodeStep, HeldLink, delay_ticks
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, IMU_KEY, JOYSTICK_KEY, ODOMETRY_KEY, Observation
from wcsim.bridge.world import World
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.supervisor.actions import action_set
from wcsim.towns.scenario.town import Town
from wcsim.types import ClientSnapshot, Command, Joystick, SeatSpec, Truth

MakeLearned = Callable[[int], Learned]  # for a chair whose commands arrive so many ticks late


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentPlace:
    """Where a segment is driven."""

    town: Town
    config: RunConfig
    seats: tuple[SeatSpec, ...]
    ticks: int
    seed: int  # of the world


def drive_segment(place: SegmentPlace, make_learned: MakeLearned | None, seed: int) -> Segment:
    """Drive for so many ticks, with a new episode wherever one ends.

    Args:
        place: Where.
        make_learned: The network that drives some of the episodes, where there is one.
        seed: Of who drives, and how.

    Raises:
        TownError: The town cannot be opened.
        ConfigError: The chairs lack a sense that data needs.
    """
    specs = tuple(replace(spec, truth=True, truth_visible=True) for spec in place.seats)
    with World(place.town, place.config, specs, place.seed) as world:
        seats = [
            _Seat(place.config, client, make_learned, seeding.generator(seed, "collect", number))
            for number, client in enumerate(world.snapshot.clients)
        ]
        for _ in range(place.ticks):
            tick = world.snapshot.tick
            commands = [Command(seat=number, tick=tick, joystick=seat.choose()) for number, seat in enumerate(seats)]
            for seat, client in zip(seats, world.tick(commands).clients, strict=True):
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
    """One chair, and what it has written down."""

    def __init__(
        self, config: RunConfig, first: ClientSnapshot, make_learned: MakeLearned | None, rng: np.random.Generator
    ) -> None:
        self.rows: list[_DrivenRow] = []
        self._config, self._make, self._rng = config, make_learned, rng
        self._actions = action_set(config.env.actions)
        self._chair, self._link = Chair(config), HeldLink()
        self._delay = 0
        self._seen: Observation
        self._said: Truth
        self._driver: DataDriver
        self._begin(first)

    def choose(self) -> Joystick:
        """Answer what is seen now."""
        self._choice = self._driver.choose(self._seen, self._said.visible or self._said)
        self._chair.send(self._link, self._choice.action)
        x, y = self._actions.points[self._choice.action].tolist()
        return Joystick(x, y)

    def take(self, client: ClientSnapshot) -> None:
        """Write down what came of it."""
        self._link.now = client
        step = self._chair.receive(self._link)
        row = _DrivenRow(seen=self._seen, said=self._said, choice=self._choice, step=step, delay=self._delay)
        self.rows.append(row)
        if client.first is not None:
            self._begin(client.first)
        else:
            self._seen, self._said = step.observation, step.info["truth"]

    def _begin(self, first: ClientSnapshot) -> None:
        self._seen, info = self._chair.begin(first)
        self._said = info["truth"]
        self._delay = delay_ticks(self._config, first.drawn)
        learned = None if self._make is None else self._make(self._delay)
        self._driver = DataDriver(self._config.collect, self._actions, self._rng, learned)


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
