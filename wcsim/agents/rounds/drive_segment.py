"""Drives one segment: fresh worlds, chairs with different users, everything that happens written down.

It is driven in streets of several towns in turn, or in generated scenes of blind sides and tight places.

The user, the oracle or the network drives. A user who never errs near a wall teaches nothing of walls: so for a third
of the time an offset is laid over the wish, and some of these wishes are carried out as they are. Where crashes alone
teach (`danger.teacher`), no oracle is asked, and nobody but users and networks drives. A share of the chairs begins
before a kerb, below or above it, or where none belongs, and is pushed ahead: users seldom come there.
"""

import math
from collections.abc import Callable, Iterator
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
from wcsim.types import F64, U8, ClientSnapshot, SeatSpec, Truth, Verdict
from wcsim.users.recordings.recorded_user import find_user

_RECKLESS_SHARE = 0.4  # share of these offsets that are executed as they are
_SCENE_SEEDS: Final = 1 << 24  # those of scenes that are trained in begin here; those of tests are far below
_MOST_SCENES: Final = 12  # of a segment
OFF_WAY_STEPS: Final = 60  # of an episode that begins off the way
_AHEAD, _WAVERS = 0.9, 0.2  # there the user's stick is held ahead, and wavers by so much
_APART_M: Final = 4.0  # from everybody, at such a start


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentOrder:
    """One piece of work; everything in it can be sent to another process."""

    key: DrivingSegmentKey
    towns: tuple[str, ...]  # folders or names
    config: RunConfig
    policy: str = ""  # the folder of the network that drives, "" for none


@dataclass(frozen=True, slots=True, kw_only=True)
class _SegmentPlace:
    """Where a segment is driven."""

    town: Town
    config: RunConfig
    seats: tuple[SeatSpec, ...]
    ticks: int
    seed: int  # of the world
    off_way: int = 0  # so many seats, the first ones, begin where a chair does not belong


def orders_of(
    config: RunConfig, towns: tuple[str, ...], first: DrivingSegmentKey, count: int, policy: str = ""
) -> list[SegmentOrder]:
    """So many pieces of work of a round, with the keys from `first` on.

    Args:
        config: Of the run.
        towns: Folders or names.
        first: The key of the first one.
        count: How many.
        policy: The folder of the network that drives, "" for none.
    """
    keys = [replace(first, index=first.index + number) for number in range(count)]
    return [SegmentOrder(key=key, towns=towns, config=config, policy=policy) for key in keys]


def require_recordable(config: RunConfig) -> None:
    """Refuse settings with which segments could not be driven, before anything is made for them.

    Raises:
        ConfigError: The chairs would not see what data is made of or may give any stick, the oracle would drive though
            nobody asks it, or a variant cannot be used.
    """
    if config.env.observation != "compact":
        told = f"env.observation={config.env.observation}: training data consists of class ids and depth"
        raise ConfigError(f"{told}; expected compact")
    seen = tuple(config.eyes.values())
    if seen != config.cameras[: len(seen)] or len({camera.width_px for camera in seen}) > 1:
        told = f"env.camera={config.env.camera}: training data has the images of cameras one below the other"
        raise ConfigError(f"{told}; expected the first ones, in their order, of one width_px")
    _require_drivable(config)
    for variant in config.collect.variants:
        try:
            _require_drivable(resolve(config, tuple(variant.split())))
        except ConfigError as error:
            raise ConfigError(
                f"collect.variants: {escape(variant)!r} cannot be used ({error}); expected section.key=value, several "
                "separated by blanks, and no blanks within a value"
            ) from None


def _require_drivable(config: RunConfig) -> None:
    action_set(config.env.actions)  # labels are of its positions: any stick has none
    if config.danger.teacher in BY_EVENTS and config.collect.follow_share < 1.0:
        share = f"collect.follow_share={config.collect.follow_share:g}"
        told = f"danger.teacher={config.danger.teacher}, but {share} lets the oracle drive"
        raise ConfigError(f"{told}; expected 1: users, and then the network, drive alone")


def _drawn_settings(config: RunConfig, key: DrivingSegmentKey) -> tuple[str, ...]:
    """What differs from segment to segment: one of the settings of `collect.variants`, drawn for each."""
    variants = config.collect.variants
    if not variants:
        return ()
    draw = make_rng(key.run, "collect", key.round, key.index, "variant")
    return tuple(variants[int(draw.integers(len(variants)))].split())


def _is_of_scenes(config: RunConfig, key: DrivingSegmentKey) -> bool:
    """Whether a segment is driven in generated scenes; the share of all that are is kept from the first one on.

    >>> config = resolve(RunConfig(), ("collect.scene_share=0.3",))
    >>> [_is_of_scenes(config, DrivingSegmentKey(run=0, round=0, index=k)) for k in range(10)].count(True)
    3
    """
    number = _number(config, key)
    return _scenes_before(config, number + 1) > _scenes_before(config, number)


def _town_in_turn(config: RunConfig, key: DrivingSegmentKey, towns: int) -> int:
    """Which of so many towns a segment is driven in that is not of scenes: each in turn, over all rounds.

    The first one is drawn for each run, so that many short ones leave no town out.

    >>> config = resolve(RunConfig(), ("collect.scene_share=0.5", "collect.segments=3"))
    >>> keys = [DrivingSegmentKey(run=0, round=n, index=k) for n in range(2) for k in range(3)]
    >>> sorted(_town_in_turn(config, key, 3) for key in keys if not _is_of_scenes(config, key))
    [0, 1, 2]
    """
    number, first = _number(config, key), derive_seed(key.run, "collect", "first town")
    return (first + number - _scenes_before(config, number)) % towns


def _number(config: RunConfig, key: DrivingSegmentKey) -> int:
    """Of a segment, counted over all rounds."""
    return key.round * config.collect.segments + key.index


def _scenes_before(config: RunConfig, number: int) -> int:
    """How many of the first so many segments are driven in scenes."""
    return int(number * config.collect.scene_share + 1e-9)


def _places_of(order: SegmentOrder, work: Path) -> Iterator[_SegmentPlace]:
    """The worlds of a segment, one after the other.

    Args:
        order: The piece of work.
        work: A folder for generated scenes.

    Raises:
        TownError: A town is missing.
    """
    config = resolve(order.config, (*_drawn_settings(order.config, order.key), "world.draw_threads=1"))
    config = resolve(config, sense_settings(config, MOTION_SENSES))
    if _is_of_scenes(order.config, order.key):
        yield from _scenes(order, config, work)
    else:
        yield _street(order, config)


def _street(order: SegmentOrder, config: RunConfig) -> _SegmentPlace:
    key, collect = order.key, config.collect
    rng = make_rng(key.run, "collect", key.round, key.index, "street")
    town = find_town(order.towns[_town_in_turn(order.config, key, len(order.towns))])
    drawn = rng.permutation(len(collect.profiles))
    who = [collect.profiles[int(drawn[seat % len(drawn)])] for seat in range(collect.chairs)]
    off_way = round(collect.off_way_share * collect.chairs)
    steps = [OFF_WAY_STEPS if seat < off_way else collect.episode_steps for seat in range(collect.chairs)]
    seats = tuple(SeatSpec(profile=profile, max_steps=most) for profile, most in zip(who, steps, strict=True))
    seed = derive_seed(key.run, "collect", key.round, key.index, "world")
    return _SegmentPlace(town=town, config=config, seats=seats, ticks=collect.ticks, seed=seed, off_way=off_way)


def _scenes(order: SegmentOrder, config: RunConfig, work: Path) -> Iterator[_SegmentPlace]:
    key = order.key
    rng = make_rng(key.run, "collect", key.round, key.index, "scenes")
    for number in range(_MOST_SCENES):
        seed = _SCENE_SEEDS + int(rng.integers(1 << 24))
        folder = write_scene(family_of(seed), seed, work / f"scene-{number}")
        town, scene = build_scene(folder, work / f"town-{number}")
        ticks = round(scene.duration_s / config.world.tick_s)
        seats = tuple(replace(spec, max_steps=ticks) for spec in seat_specs(folder, scene, town.file.origin_m))
        own = scene_config(scene, config)
        town = replace(town, passing=True, drafted=True)
        yield _SegmentPlace(town=town, config=own, seats=seats, ticks=ticks, seed=scene.seed)


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
        pushed: Whether the stick is held ahead, whatever the user wants.
    """

    def __init__(
        self,
        settings: CollectConfig,
        actions: ActionSet,
        rng: np.random.Generator,
        learned: _Learned | None,
        pushed: bool = False,
    ) -> None:
        self._settings, self._actions, self._rng, self._learned = settings, actions, rng, learned
        self._pushed = pushed
        self._held, self._offset, self._reckless = 0, np.zeros(2), False
        draw = rng.random(2)
        self._driver = FOLLOW if draw[1] < settings.follow_share else ORACLE
        if learned is not None and draw[0] < settings.network_share:
            self._driver = NETWORK
            learned.reset()

    def choose(self, observation: Observation, said: Verdict | None) -> dict[str, Any]:
        """Answer an observation, in columns of a segment; `said` is the oracle's verdict of its moment, if any."""
        wish = self._wish(np.asarray(observation[JOYSTICK_KEY], np.float64))
        reckless = self._held > 0 and self._reckless
        action = self._actions.nearest(wish)
        if self._driver == NETWORK and self._learned is not None:
            if reckless:
                self._learned.observe(observation)
            else:
                action = self._learned.choose({**observation, JOYSTICK_KEY: wish.astype(np.float32)})
            self._learned.sent(action)
        elif self._driver == ORACLE and said is not None and not reckless:
            distance = self._actions.distances(wish[None])[0]
            action = int(np.argmin(np.where(said.first_s == said.first_s.max(), distance, np.inf)))
        return {"action": action, "wish": wish, "driver": RECKLESS if reckless else self._driver}

    def _wish(self, stick: F64) -> F64:
        """The user's stick, or with an offset that is held for a while."""
        settings, rng = self._settings, self._rng
        if self._pushed:
            stick = np.clip(rng.normal((0.0, _AHEAD), _WAVERS), -1.0, 1.0)
        self._held -= 1
        low, high = settings.astray_ticks
        mean = 0.5 * (low + high)
        if self._held <= 0 and rng.random() < settings.astray_share / (mean - (mean - 1) * settings.astray_share):
            self._offset = rng.normal(0.0, settings.astray_spread, 2)
            self._held = int(rng.integers(low, high + 1))
            self._reckless = bool(rng.random() < _RECKLESS_SHARE)
        if self._held <= 0:
            return stick
        return np.clip(stick + self._offset, -1.0, 1.0)


MakeLearned = Callable[[int], _Learned]  # for a chair whose commands arrive so many ticks late


def collect(order: SegmentOrder, make_learned: MakeLearned | None) -> DrivingSegment:
    """The segment that an order asks for; the same one wherever and whenever it is driven.

    Args:
        order: Its worlds are driven one after the other.
        make_learned: The network that drives some of the episodes, where there is one.

    Raises:
        TownError: A town cannot be opened.
        ConfigError: The chairs lack a sense that data needs.
    """
    key, parts = order.key, list[DrivingSegment]()
    with create_temporary_folder() as work:
        for number, place in enumerate(_places_of(order, work)):
            seed = derive_seed(key.run, "collect", key.round, key.index, "drivers", number)  # of who drives, and how
            parts.append(_driven(place, make_learned, seed))
    return join_segments(parts)


def _driven(place: _SegmentPlace, make_learned: MakeLearned | None, seed: int) -> DrivingSegment:
    """Drive for so many ticks, with a new episode wherever one ends."""
    asked = place.config.danger.teacher not in BY_EVENTS  # the oracle costs time, and what happens needs none
    specs = tuple(replace(spec, truth=asked, truth_visible=asked) for spec in place.seats)
    with World(place.town, place.config, specs, place.seed, find_user=find_user) as world:
        # Starts off the way have draws of their own, so that a share of them shifts nobody else's.
        draws = [make_rng(seed, "off way", number) for number in range(place.off_way)]
        for number, rng in enumerate(draws):
            _begin_off_way(world, number, rng)
        seats = [
            _Seat(place.config, client, make_learned, make_rng(seed, "collect", number), number < len(draws))
            for number, client in enumerate(world.snapshot.clients)
        ]
        steps = rollout(world, {number: seat.driver.choose for number, seat in enumerate(seats)})
        for step in islice(steps, place.ticks):
            for number, (seat, client) in enumerate(zip(seats, step.after.clients, strict=True)):
                seat.take(client)
                if client.first is not None and number < len(draws):
                    _begin_off_way(world, number, draws[number])
    for seat in seats:
        seat.rows[-1]["ended"] = True  # nobody drives on from here: what lies ahead of it is not known
    rows = [row for seat in seats for row in seat.rows]
    return DrivingSegment(**{name: np.array([row[name] for row in rows], kind) for name, (kind, _) in COLUMNS.items()})


def _begin_off_way(world: World, seat: int, rng: np.random.Generator) -> None:
    """Put a chair where it does not belong, near where it is now; it stays there where no such place is found."""
    (here,) = (client.plant.p_WB_m for client in world.snapshot.clients if client.seat == seat)
    start = off_way_start(world.street.grid, here, rng)
    others = [actor.p_W_m[:2] for actor in world.snapshot.actors]
    if start is not None and all(math.dist(other, start.p_W_m) > _APART_M for other in others):
        world.respawn(seat, start=start)


class _Seat:
    """One chair with its agent, and what it has written down."""

    def __init__(
        self,
        config: RunConfig,
        first: ClientSnapshot,
        make_learned: MakeLearned | None,
        rng: np.random.Generator,
        pushed: bool,
    ) -> None:
        self.rows: list[dict[str, Any]] = []  # by column of a segment
        self._config, self._make, self._rng, self._pushed = config, make_learned, rng, pushed
        self._actions = action_set(config.env.actions)
        self._delay = 0
        self._choice: dict[str, Any]
        self._agent: _DataDriver
        self.driver = AgentSeatDriver(config, self, first)

    def reset(self, info: Info) -> None:
        """Draw who drives the episode that begins."""
        self._delay = find_episode_delay_ticks(self._config, info[OBJECTS].drawn)
        learned = None if self._make is None else self._make(self._delay)
        self._agent = _DataDriver(self._config.collect, self._actions, self._rng, learned, self._pushed)

    def act(self, observation: Observation, info: Info) -> int:
        """Answer what is seen now."""
        said: Truth | None = info[OBJECTS].truth
        self._choice = self._agent.choose(observation, said and (said.visible or said))
        return int(self._choice["action"])

    def take(self, client: ClientSnapshot) -> None:
        """Write down what came of it."""
        seen, said = self.driver.observation, self.driver.info[OBJECTS].truth
        step = self.driver.finish_step(client)
        own = judge_crash_fault(client.events.crash_reason, client.contacts, self._config.reward) == "own"
        self.rows.append(
            {
                "depth": np.concatenate([seen[prefix + DEPTH_KEY][-1] for prefix in self._config.eyes]),
                "seg": np.concatenate([seen[prefix + CLASS_KEY][-1] for prefix in self._config.eyes]),
                "imu": seen[IMU_KEY],
                "odometry": seen[ODOMETRY_KEY],
                "stick": seen[JOYSTICK_KEY],
                **self._choice,
                "visible": _codes(said and (said.visible or said)),
                "truth": _codes(said),
                "reward": step.reward,
                "crashed": step.terminated,
                "own": step.terminated and own,
                "ended": step.done,
                "delay": self._delay,
            }
        )


def _codes(said: Verdict | None) -> U8:
    """(A,) see `crash_times_to_codes`, or (0,) where no oracle was asked."""
    return np.zeros(0, np.uint8) if said is None else crash_times_to_codes(said.first_s)
