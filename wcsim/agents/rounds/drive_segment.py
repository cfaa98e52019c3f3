"""Drives one segment of training data: several chairs with different users, each step recorded.

A segment is driven in a street, of several towns in turn, or in generated scenes with hidden road
users and narrow places.

In each episode the user, the oracle or the network drives. A user who never errs near a wall yields
no data of walls. So for a share of the time a random offset is added to the user's stick, and some
of these sticks are executed as they are. Where labels come from crashes alone (`danger.teacher`),
there is no oracle. A share of the chairs starts before a kerb, below or above it, or off the ways,
and is pushed ahead: users seldom get there.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from wcsim.agents.envs.episode_view import OBJECTS, Info, find_episode_delay_ticks
from wcsim.agents.envs.seat_driver import AgentSeatDriver
from wcsim.agents.policy_api import (
    CLASS_KEY,
    DEPTH_KEY,
    IMU_KEY,
    JOYSTICK_KEY,
    MOTION_SENSES,
    ODOMETRY_KEY,
    HearsSent,
    Observation,
    sense_settings,
)
from wcsim.agents.runs.data_folder import (
    BY_EVENTS,
    COLUMNS,
    FOLLOW,
    NETWORK,
    ORACLE,
    RECKLESS,
    DrivingSegment,
    DrivingSegmentKey,
    crash_times_to_codes,
    join_segments,
)
from wcsim.bridge.ego.ego import Ego
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import CollectConfig, RunConfig, resolve
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import escape
from wcsim.core.seeding import derive_seed, make_rng
from wcsim.errors import ConfigError
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.supervisor.rewards import judge_crash_fault
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.scene_folders.build import build_scene, scene_config, seat_specs
from wcsim.towns.scene_folders.families import family_of, write_scene
from wcsim.towns.walking.off_way import off_way_start
from wcsim.types import F64, U8, ActorState, ClientSnapshot, SeatSpec, Truth, Verdict
from wcsim.users.recordings.recorded_user import find_user

OFF_WAY_STEPS: Final = 60  # of an episode that starts off the way
_OFF_WAY_GAP_M: Final = 4.0  # least distance of such a start to any actor
_PUSH_Y, _PUSH_SPREAD = 0.9, 0.2  # mean and standard deviation of the stick that is pushed ahead
_RECKLESS_SHARE = 0.4  # of the random offsets: the stick is executed as it is
_SCENE_SEEDS: Final = 1 << 24  # first seed of scenes for training; those for tests are far below
_SCENES: Final = 12  # in a segment
HINDSIGHT_S: Final = (1.0, 2.0)  # after which it is seen how others went on


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentOrder:
    """One segment to drive; everything in it can be sent to another process."""

    key: DrivingSegmentKey
    towns: tuple[str, ...]  # folders or names
    config: RunConfig
    policy: str = ""  # the folder of the network that drives, "" for none


class _DrivingNetwork(HearsSent, Protocol):
    """A network that drives: in each step `choose` or `observe`, then `sent`."""

    def reset(self) -> None:
        """An episode starts."""

    def observe(self, observation: Observation) -> None:
        """Take in an observation without choosing."""


_MakeNetwork = Callable[[int], _DrivingNetwork]
"""Makes the network for a chair whose commands have this delay in ticks."""


def make_segment_orders(
    config: RunConfig,
    towns: tuple[str, ...],
    seed: int,
    round_number: int,
    count: int,
    policy: str = "",
) -> list[SegmentOrder]:
    """The segments of a round.

    Args:
        config: Of the run.
        towns: Folders or names.
        seed: Of the run.
        round_number: Which round, from 0.
        count: How many segments.
        policy: The folder of the network that drives, "" for none.
    """
    keys = [DrivingSegmentKey(run=seed, round=round_number, index=index) for index in range(count)]
    return [SegmentOrder(key=key, towns=towns, config=config, policy=policy) for key in keys]


def require_recordable(config: RunConfig) -> None:
    """Refuse settings with which no segment can be driven.

    Raises:
        ConfigError: The chairs lack the observations that data consists of, or may give any stick.
            Or the oracle would drive without being computed. Or a variant cannot be used.
    """
    env = config.env
    if env.observation != "compact":
        raise ConfigError(
            f"env.observation={env.observation}: training data consists of class ids and depth; "
            "expected compact"
        )
    seen = tuple(config.eyes.values())
    if seen != config.cameras[: len(seen)] or len({camera.width_px for camera in seen}) > 1:
        raise ConfigError(
            f"env.camera={env.camera}: training data has the images of cameras one below the "
            "other; expected the first ones, in their order, of one width_px"
        )
    _require_drivable(config)
    for variant in config.collect.variants:
        try:
            _require_drivable(resolve(config, tuple(variant.split())))
        except ConfigError as error:
            raise ConfigError(
                f"collect.variants: {escape(variant)!r} cannot be used ({error}); expected "
                "section.key=value, several separated by blanks, and no blanks within a value"
            ) from None


def drive_segment(order: SegmentOrder, make_network: _MakeNetwork | None) -> DrivingSegment:
    """Drive the worlds of a segment, one after the other; the same segment on every machine.

    Args:
        order: Which segment.
        make_network: Makes the network that drives a share of the episodes; None for no network.

    Raises:
        TownError: A town cannot be opened.
        ConfigError: The chairs lack a sense that data needs.
    """
    key, parts = order.key, list[DrivingSegment]()
    with create_temporary_folder() as work:
        for number, setup in enumerate(_iter_world_setups(order, work)):
            seed = derive_seed(key.run, "collect", key.round, key.index, "drivers", number)
            parts.append(_drive_world(setup, make_network, seed))
    return join_segments(parts)


def _require_drivable(config: RunConfig) -> None:
    # Labels belong to the positions of an action set: a set of any stick has none.
    action_set(config.env.actions)
    teacher, share = config.danger.teacher, config.collect.follow_share
    if teacher == "returns" and not config.reward.crash:
        raise ConfigError(
            "danger.teacher=returns, but reward.crash=0; expected more: labels are shares of it"
        )
    if teacher in BY_EVENTS and share < 1.0:
        raise ConfigError(
            f"danger.teacher={teacher}, but collect.follow_share={share:g} lets the oracle drive; "
            "expected 1: users, and then the network, drive alone"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _WorldSetup:
    """One world of a segment."""

    town: Town
    config: RunConfig
    seats: tuple[SeatSpec, ...]
    ticks: int
    seed: int
    off_way: int = 0  # so many of the first seats start where a chair does not belong


def _iter_world_setups(order: SegmentOrder, work: Path) -> Iterator[_WorldSetup]:
    """The worlds of a segment: one street, or several scenes, which are generated in `work`.

    Raises:
        TownError: A town is missing.
    """
    # 1. The settings of this segment: a variant, and the senses of a danger network.
    key = order.key
    seed_path = (key.run, "collect", key.round, key.index)
    config = resolve(order.config, (*_draw_variant(order.config, key), "world.draw_threads=1"))
    config = resolve(config, sense_settings(config, MOTION_SENSES))
    collect = config.collect
    if not _is_of_scenes(order.config, key):
        # 2. Either a street of the town whose turn it is, with users in random order,
        rng = make_rng(*seed_path, "street")
        town = find_town(order.towns[_town_index(order.config, key, len(order.towns))])
        drawn = rng.permutation(len(collect.profiles))
        off_way = round(collect.off_way_share * collect.chairs)
        seats = tuple(
            SeatSpec(
                profile=collect.profiles[int(drawn[seat % len(drawn)])],
                max_steps=OFF_WAY_STEPS if seat < off_way else collect.episode_steps,
            )
            for seat in range(collect.chairs)
        )
        yield _WorldSetup(
            town=town,
            config=config,
            seats=seats,
            ticks=collect.ticks,
            seed=derive_seed(*seed_path, "world"),
            off_way=off_way,
        )
        return

    # 3. or generated scenes, each with its own user, length and seed.
    rng = make_rng(*seed_path, "scenes")
    for number in range(_SCENES):
        seed = _SCENE_SEEDS + int(rng.integers(1 << 24))
        folder = write_scene(family_of(seed), seed, work / f"scene-{number}")
        town, scene = build_scene(folder, work / f"town-{number}")
        ticks = round(scene.duration_s / config.world.tick_s)
        specs = seat_specs(folder, scene, town.file.origin_m)
        yield _WorldSetup(
            town=replace(town, passing=True, drafted=True),
            config=scene_config(scene, config),
            seats=tuple(replace(spec, max_steps=ticks) for spec in specs),
            ticks=ticks,
            seed=scene.seed,
        )


def _draw_variant(config: RunConfig, key: DrivingSegmentKey) -> tuple[str, ...]:
    """The settings of one of `collect.variants`, drawn for each segment."""
    variants = config.collect.variants
    if not variants:
        return ()
    rng = make_rng(key.run, "collect", key.round, key.index, "variant")
    return tuple(variants[int(rng.integers(len(variants)))].split())


def _is_of_scenes(config: RunConfig, key: DrivingSegmentKey) -> bool:
    """Whether a segment is driven in generated scenes; their share is right at every segment.

    >>> config = resolve(RunConfig(), ("collect.scene_share=0.3",))
    >>> keys = [DrivingSegmentKey(run=0, round=0, index=index) for index in range(10)]
    >>> [_is_of_scenes(config, key) for key in keys].count(True)
    3
    """
    number = _segment_number(config, key)
    return _count_scenes(config, number + 1) > _count_scenes(config, number)


def _town_index(config: RunConfig, key: DrivingSegmentKey, towns: int) -> int:
    """Which of the towns a segment's street is in: each in turn, over all rounds.

    The first one is drawn for each run, so that many short runs leave no town out.

    >>> config = resolve(RunConfig(), ("collect.scene_share=0.5", "collect.segments=3"))
    >>> keys = [DrivingSegmentKey(run=0, round=n, index=k) for n in range(2) for k in range(3)]
    >>> sorted(_town_index(config, key, 3) for key in keys if not _is_of_scenes(config, key))
    [0, 1, 2]
    """
    number, first = _segment_number(config, key), derive_seed(key.run, "collect", "first town")
    return (first + number - _count_scenes(config, number)) % towns


def _segment_number(config: RunConfig, key: DrivingSegmentKey) -> int:
    """The index of a segment, counted over all rounds."""
    return key.round * config.collect.segments + key.index


def _count_scenes(config: RunConfig, number: int) -> int:
    """How many of the first `number` segments are driven in scenes."""
    return int(number * config.collect.scene_share + 1e-9)


def _drive_world(
    setup: _WorldSetup, make_network: _MakeNetwork | None, seed: int
) -> DrivingSegment:
    """Drive a world for its ticks; where an episode ends, a new one starts."""
    # The oracle takes time, and labels that come from crashes need none.
    oracle = setup.config.danger.teacher not in BY_EVENTS
    specs = tuple(replace(spec, truth=oracle, truth_visible=oracle) for spec in setup.seats)
    with World(setup.town, setup.config, specs, setup.seed, find_user=find_user) as world:
        # Starts off the way have their own generators, so that their share changes no other draw.
        start_rngs = [make_rng(seed, "off way", number) for number in range(setup.off_way)]
        for number, rng in enumerate(start_rngs):
            _start_off_way(world, number, rng)
        seats = [
            _SeatRecorder(
                setup.config,
                client,
                make_network,
                make_rng(seed, "collect", number),
                number < setup.off_way,
                world.seats[number],
            )
            for number, client in enumerate(world.snapshot.clients)
        ]
        actors = [world.snapshot.actors]
        steps = rollout(world, {number: seat.driver.choose for number, seat in enumerate(seats)})
        for step in islice(steps, setup.ticks):
            actors.append(step.after.actors)
            for number, (seat, client) in enumerate(zip(seats, step.after.clients, strict=True)):
                seat.record(client)
                if client.first is not None and number < setup.off_way:
                    _start_off_way(world, number, start_rngs[number])
    for seat in seats:
        seat.end(actors, setup.config.world.tick_s)
    rows = [row for seat in seats for row in seat.rows]
    columns = {
        name: np.array([row[name] for row in rows], kind) for name, (kind, _) in COLUMNS.items()
    }
    return DrivingSegment(**columns)


def _start_off_way(world: World, seat: int, rng: np.random.Generator) -> None:
    """Start a chair's episode anew, off the way near its place; where none is found it stays."""
    (here,) = (client.plant.p_WB_m for client in world.snapshot.clients if client.seat == seat)
    start = off_way_start(world.street.grid, here, rng)
    others = [actor.p_W_m[:2] for actor in world.snapshot.actors]
    if start is not None and all(
        math.dist(other, start.p_W_m) > _OFF_WAY_GAP_M for other in others
    ):
        world.respawn(seat, start=start)


class _DataDriver:
    """Drives one chair for one episode; who drives is drawn at its start.

    Args:
        settings: The shares of the drivers, and the random offsets.
        actions: The joystick positions.
        rng: Of this chair.
        network: None where there is none.
        pushed: Whether the stick is pushed ahead in place of the user's.
    """

    def __init__(
        self,
        settings: CollectConfig,
        actions: ActionSet,
        rng: np.random.Generator,
        network: _DrivingNetwork | None,
        pushed: bool = False,
    ) -> None:
        self._settings, self._actions, self._rng = settings, actions, rng
        self._pushed = pushed
        self._network: _DrivingNetwork | None = None  # if it drives
        # The random offset: ticks that are left, (2,) its value, and whether it is executed.
        self._offset_ticks, self._offset, self._is_executed = 0, np.zeros(2), False
        draws = rng.random(2)
        self._driver = FOLLOW if draws[1] < settings.follow_share else ORACLE
        if network is not None and draws[0] < settings.network_share:
            self._driver, self._network = NETWORK, network
            network.reset()

    def choose(self, observation: Observation, verdict: Verdict | None) -> dict[str, Any]:
        """Answer an observation, in columns of a segment.

        Args:
            observation: Of now.
            verdict: The oracle's for the same moment, None without an oracle.
        """
        # 1. The user's stick, or one that is pushed ahead.
        settings, rng = self._settings, self._rng
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        if self._pushed:
            stick = np.clip(rng.normal((0.0, _PUSH_Y), _PUSH_SPREAD), -1.0, 1.0)

        # 2. A random offset for some ticks. How often it starts follows from its share of the time.
        self._offset_ticks -= 1
        share, (low, high) = settings.astray_share, settings.astray_ticks
        mean = 0.5 * (low + high)
        if self._offset_ticks <= 0 and rng.random() < share / (mean - (mean - 1) * share):
            self._offset = rng.normal(0.0, settings.astray_spread, 2)
            self._offset_ticks = int(rng.integers(low, high + 1))
            self._is_executed = bool(rng.random() < _RECKLESS_SHARE)
        has_offset = self._offset_ticks > 0
        if has_offset:
            stick = np.clip(stick + self._offset, -1.0, 1.0)

        # 3. The action. The network observes each step, also those in which it does not choose.
        driver = RECKLESS if has_offset and self._is_executed else self._driver
        action = self._actions.nearest(stick)
        if self._network is not None:
            if driver == RECKLESS:
                self._network.observe(observation)
            else:
                action = self._network.choose(
                    {**observation, JOYSTICK_KEY: stick.astype(np.float32)}
                )
            self._network.sent(action)
        elif driver == ORACLE and verdict is not None:
            # The nearest of the actions that are safe the longest.
            distance = self._actions.distances(stick[None])[0]
            first_s = verdict.first_s
            action = int(np.argmin(np.where(first_s == first_s.max(), distance, np.inf)))
        return {"action": action, "wish": stick, "driver": driver}


class _SeatRecorder:
    """The agent of one chair; it draws a driver for each episode, and records all steps."""

    def __init__(
        self,
        config: RunConfig,
        first: ClientSnapshot,
        make_network: _MakeNetwork | None,
        rng: np.random.Generator,
        pushed: bool,
        ego: Ego,
    ) -> None:
        self.rows: list[dict[str, Any]] = []  # by column of a segment
        # Of each row, see `Ego.reassess`.
        self.judges: list[Callable[[Mapping[str, ActorState], float], F64]] = []
        self._ego = ego
        self._config, self._rng, self._pushed = config, rng, pushed
        self._make_network = make_network
        self._actions = action_set(config.env.actions)
        self._delay_ticks = 0
        self._choice: dict[str, Any]
        self._agent: _DataDriver
        self.driver = AgentSeatDriver(config, self, first)

    def reset(self, info: Info) -> None:
        """Draw the driver of the episode that starts."""
        self._delay_ticks = find_episode_delay_ticks(self._config, info[OBJECTS].drawn)
        network = None if self._make_network is None else self._make_network(self._delay_ticks)
        self._agent = _DataDriver(
            self._config.collect, self._actions, self._rng, network, self._pushed
        )

    def act(self, observation: Observation, info: Info) -> int:
        """The action for an observation."""
        truth: Truth | None = info[OBJECTS].truth
        if self._config.danger.teacher == "visible":
            self.judges.append(self._ego.reassess)
        self._choice = self._agent.choose(observation, truth and (truth.visible or truth))
        return int(self._choice["action"])

    def record(self, client: ClientSnapshot) -> None:
        """Record the step that led to a frame, with the observation before it."""
        seen, truth = self.driver.observation, self.driver.info[OBJECTS].truth
        step = self.driver.finish_step(client)
        fault = judge_crash_fault(client.events.crash_reason, client.contacts, self._config.reward)
        self.rows.append(
            {
                "depth": np.concatenate(
                    [seen[prefix + DEPTH_KEY][-1] for prefix in self._config.eyes]
                ),
                "seg": np.concatenate(
                    [seen[prefix + CLASS_KEY][-1] for prefix in self._config.eyes]
                ),
                "imu": seen[IMU_KEY],
                "odometry": seen[ODOMETRY_KEY],
                "stick": seen[JOYSTICK_KEY],
                **self._choice,
                "visible": _to_codes(truth and (truth.visible or truth)),
                "truth": _to_codes(truth),
                "reward": step.reward,
                "crashed": step.terminated,
                "own": step.terminated and fault == "own",
                "ended": step.done,
                "delay": self._delay_ticks,
            }
        )

    def end(self, actors: Sequence[Sequence[ActorState]], tick_s: float) -> None:
        """The world has ended.

        Args:
            actors: Of the world, at each of its ticks.
            tick_s: Of the world.
        """
        # 1. What would have followed is unknown.
        self.rows[-1]["ended"] = True

        # 2. The oracle supposed that others would go on as they did. What they did counts, too, as
        # long as the episode lasts: then the chair starts elsewhere.
        end = len(self.rows)
        for tick in reversed(range(len(self.judges))):
            row = self.rows[tick]
            end = tick + 1 if row["ended"] else end
            for after_s in HINDSIGHT_S:
                then = min(tick + max(1, round(after_s / tick_s)), end)
                later = {actor.id: actor for actor in actors[then]}
                codes = crash_times_to_codes(self.judges[tick](later, (then - tick) * tick_s))
                row["visible"] = np.minimum(row["visible"], codes)


def _to_codes(verdict: Verdict | None) -> U8:
    """(A,) see `crash_times_to_codes`, or (0,) without an oracle."""
    return np.zeros(0, np.uint8) if verdict is None else crash_times_to_codes(verdict.first_s)
