"""Drives one segment: fresh worlds, chairs with different users, everything that happens written down.

The user, the oracle or the network drives. A user who never errs near a wall teaches nothing of walls: so for a third
of the time an offset is laid over the wish, and some of these wishes are carried out as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

import numpy as np

from wcsim.agents.envs.episode_view import Info, delay_ticks
from wcsim.agents.envs.seat_driver import SeatDriver
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, IMU_KEY, JOYSTICK_KEY, ODOMETRY_KEY, HearsSent, Observation
from wcsim.agents.rounds.segment_places import SegmentOrder, SegmentPlace, places_of
from wcsim.agents.runs.data_folder import COLUMNS, FOLLOW, NETWORK, ORACLE, RECKLESS, Segment, codes_of, joined
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import CollectConfig, RunConfig
from wcsim.core import seeding
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.types import F64, ClientSnapshot, Truth, Verdict

_ASTRAY_SIGMA = 0.5  # spread of the offset, in stick units
_ASTRAY_TICKS = (4, 12)  # shortest and longest time that an offset is held
_RECKLESS_SHARE = 0.4  # share of these offsets that are executed as they are


class _Learned(HearsSent, Protocol):
    """The network as a driver: in each step `choose` or `observe`, then `sent`."""

    def reset(self) -> None:
        """An episode begins."""

    def observe(self, observation: Observation) -> None:
        """Take in an observation without choosing."""


class _DataDriver:
    """Drives one chair for an episode; who drives it is drawn as it begins.

    Args:
        settings: How often who drives.
        actions: The joystick positions.
        rng: Of this chair.
        learned: The network, where there is one.
    """

    def __init__(
        self, settings: CollectConfig, actions: ActionSet, rng: np.random.Generator, learned: _Learned | None
    ) -> None:
        self._settings, self._actions, self._rng, self._learned = settings, actions, rng, learned
        self._held, self._offset, self._reckless = 0, np.zeros(2), False
        draw = rng.random(2)
        self._driver = FOLLOW if draw[1] < settings.follow_share else ORACLE
        if learned is not None and draw[0] < settings.network_share:
            self._driver = NETWORK
            learned.reset()

    def choose(self, observation: Observation, said: Verdict) -> dict[str, Any]:
        """Answer an observation, in columns of a segment; `said` is the oracle's verdict of its moment."""
        wish = self._wish(np.asarray(observation[JOYSTICK_KEY], np.float64))
        reckless = self._held > 0 and self._reckless
        action = self._actions.nearest(wish)
        if self._driver == NETWORK and self._learned is not None:
            if reckless:
                self._learned.observe(observation)
            else:
                action = self._learned.choose({**observation, JOYSTICK_KEY: wish.astype(np.float32)})
            self._learned.sent(action)
        elif self._driver == ORACLE and not reckless:
            action = self._safest(wish, said.first_s)
        return {"action": action, "wish": wish, "driver": RECKLESS if reckless else self._driver}

    def _wish(self, stick: F64) -> F64:
        """The user's stick, or with an offset that is held for a while."""
        settings, rng = self._settings, self._rng
        self._held -= 1
        low, high = _ASTRAY_TICKS
        mean = 0.5 * (low + high)
        if self._held <= 0 and rng.random() < settings.astray_share / (mean - (mean - 1) * settings.astray_share):
            self._offset = rng.normal(0.0, _ASTRAY_SIGMA, 2)
            self._held = int(rng.integers(low, high + 1))
            self._reckless = bool(rng.random() < _RECKLESS_SHARE)
        if self._held <= 0:
            return stick
        wish: F64 = np.clip(stick + self._offset, -1.0, 1.0)
        return wish

    def _safest(self, wish: F64, first_s: F64) -> int:
        distance = self._actions.distances(wish[None])[0]
        return int(np.argmin(np.where(first_s == first_s.max(), distance, np.inf)))


MakeLearned = Callable[[int], _Learned]  # for a chair whose commands arrive so many ticks late


def collect(order: SegmentOrder, make_learned: MakeLearned | None) -> Segment:
    """The segment that an order asks for; the same one wherever and whenever it is driven.

    Args:
        order: Its worlds are driven one after the other.
        make_learned: The network that drives some of the episodes, where there is one.

    Raises:
        TownError: A town cannot be opened.
        ConfigError: The chairs lack a sense that data needs.
    """
    key, parts = order.key, list[Segment]()
    with TemporaryDirectory(prefix="wcsim-collect-") as work:
        for number, place in enumerate(places_of(order, Path(work))):
            seed = seeding.derive(key.run, "collect", key.round, key.index, "drivers", number)  # of who drives, and how
            parts.append(_driven(place, make_learned, seed))
    return joined(parts)


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


class _Seat:
    """One chair with its agent, and what it has written down."""

    def __init__(
        self, config: RunConfig, first: ClientSnapshot, make_learned: MakeLearned | None, rng: np.random.Generator
    ) -> None:
        self.rows: list[dict[str, Any]] = []  # by column of a segment
        self._config, self._make, self._rng = config, make_learned, rng
        self._actions = action_set(config.env.actions)
        self._delay = 0
        self._choice: dict[str, Any]
        self._agent: _DataDriver
        self.driver = SeatDriver(config, self, first)

    def reset(self, info: Info) -> None:
        """Draw who drives the episode that begins."""
        self._delay = delay_ticks(self._config, info["drawn"])
        learned = None if self._make is None else self._make(self._delay)
        self._agent = _DataDriver(self._config.collect, self._actions, self._rng, learned)

    def act(self, observation: Observation, info: Info) -> int:
        """Answer what is seen now."""
        said: Truth = info["truth"]
        self._choice = self._agent.choose(observation, said.visible or said)
        return int(self._choice["action"])

    def take(self, client: ClientSnapshot) -> None:
        """Write down what came of it."""
        seen, said = self.driver.observation, self.driver.info["truth"]
        step = self.driver.take(client)
        self.rows.append(
            {
                "depth": seen[DEPTH_KEY][-1],
                "seg": seen[CLASS_KEY][-1],
                "imu": seen[IMU_KEY],
                "odometry": seen[ODOMETRY_KEY],
                "stick": seen[JOYSTICK_KEY],
                **self._choice,
                "visible": codes_of((said.visible or said).first_s),
                "truth": codes_of(said.first_s),
                "reward": step.reward,
                "crashed": step.terminated,
                "ended": step.done,
                "delay": self._delay,
            }
        )


def _segment_of(chairs: Sequence[Sequence[dict[str, Any]]]) -> Segment:
    """The rows of all chairs, one chair after the other; a chair's last step here ends its episode."""
    for chair in chairs:
        chair[-1]["ended"] = True  # nobody drives on from here: what lies ahead of it is not known
    rows = [row for chair in chairs for row in chair]
    return Segment(**{name: np.array([row[name] for row in rows], kind) for name, (kind, _) in COLUMNS.items()})
