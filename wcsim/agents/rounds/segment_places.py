"""Where a segment is driven: streets of several towns in turn, and generated scenes of blind sides and tight places."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from wcsim.agents.policy_api import MOTION_SENSES, sense_settings
from wcsim.agents.runs.data_folder import SegmentKey
from wcsim.config import RunConfig, resolve
from wcsim.core import seeding
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.scene_folders.build import build_scene, scene_config, seat_specs
from wcsim.towns.scene_folders.families import FAMILIES, write_scene
from wcsim.types import SeatSpec

_SCENE_SEEDS: Final = 1 << 24  # those of scenes that are trained in begin here; those of tests are far below
_MOST_SCENES: Final = 12  # of a segment


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentOrder:
    """One piece of work; everything in it can be sent to another process."""

    key: SegmentKey
    towns: tuple[str, ...]  # folders or names
    config: RunConfig
    policy: str = ""  # the folder of the network that drives, "" for none


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentPlace:
    """Where a segment is driven."""

    town: Town
    config: RunConfig
    seats: tuple[SeatSpec, ...]
    ticks: int
    seed: int  # of the world


def orders_of(
    config: RunConfig, towns: tuple[str, ...], first: SegmentKey, count: int, policy: str = ""
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
        ConfigError: The chairs would not see what data is made of, or a variant cannot be used.
    """
    if config.env.observation != "compact":
        told = f"env.observation={config.env.observation}: training data consists of class ids and depth"
        raise ConfigError(f"{told}; expected compact")
    if config.eye != config.cameras[0]:
        raise ConfigError(f"env.camera={config.env.camera}: training data is of the first camera; expected no other")
    for variant in config.collect.variants:
        try:
            resolve(config, tuple(variant.split()))
        except ConfigError as error:
            raise ConfigError(
                f"collect.variants: {escaped(variant)!r} cannot be used ({error}); expected section.key=value, several "
                "separated by blanks, and no blanks within a value"
            ) from None


def _drawn_settings(config: RunConfig, key: SegmentKey) -> tuple[str, ...]:
    """What differs from segment to segment: one of the settings of `collect.variants`, drawn for each."""
    variants = config.collect.variants
    if not variants:
        return ()
    draw = seeding.generator(key.run, "collect", key.round, key.index, "variant")
    return tuple(variants[int(draw.integers(len(variants)))].split())


def _is_of_scenes(config: RunConfig, key: SegmentKey) -> bool:
    """Whether a segment is driven in generated scenes; the share of all that are is kept from the first one on.

    >>> config = resolve(RunConfig(), ("collect.scene_share=0.3",))
    >>> [_is_of_scenes(config, SegmentKey(run=0, round=0, index=k)) for k in range(10)].count(True)
    3
    """
    number = _number(config, key)
    return _scenes_before(config, number + 1) > _scenes_before(config, number)


def _town_in_turn(config: RunConfig, key: SegmentKey, towns: int) -> int:
    """Which of so many towns a segment is driven in that is not of scenes: each in turn, over all rounds.

    The first one is drawn for each run, so that many short ones leave no town out.

    >>> config = resolve(RunConfig(), ("collect.scene_share=0.5", "collect.segments=3"))
    >>> keys = [SegmentKey(run=0, round=n, index=k) for n in range(2) for k in range(3)]
    >>> sorted(_town_in_turn(config, key, 3) for key in keys if not _is_of_scenes(config, key))
    [0, 1, 2]
    """
    number, first = _number(config, key), seeding.derive(key.run, "collect", "first town")
    return (first + number - _scenes_before(config, number)) % towns


def _number(config: RunConfig, key: SegmentKey) -> int:
    """Of a segment, counted over all rounds."""
    return key.round * config.collect.segments + key.index


def _scenes_before(config: RunConfig, number: int) -> int:
    """How many of the first so many segments are driven in scenes."""
    return int(number * config.collect.scene_share + 1e-9)


def places_of(order: SegmentOrder, work: Path) -> Iterator[SegmentPlace]:
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


def _street(order: SegmentOrder, config: RunConfig) -> SegmentPlace:
    key, collect = order.key, config.collect
    rng = seeding.generator(key.run, "collect", key.round, key.index, "street")
    town = find_town(order.towns[_town_in_turn(order.config, key, len(order.towns))])
    drawn = rng.permutation(len(collect.profiles))
    who = [collect.profiles[int(drawn[seat % len(drawn)])] for seat in range(collect.chairs)]
    seats = tuple(SeatSpec(profile=profile, max_steps=collect.episode_steps) for profile in who)
    seed = seeding.derive(key.run, "collect", key.round, key.index, "world")
    return SegmentPlace(town=town, config=config, seats=seats, ticks=collect.ticks, seed=seed)


def _scenes(order: SegmentOrder, config: RunConfig, work: Path) -> Iterator[SegmentPlace]:
    key = order.key
    rng = seeding.generator(key.run, "collect", key.round, key.index, "scenes")
    for number in range(_MOST_SCENES):
        family, seed = FAMILIES[int(rng.integers(len(FAMILIES)))], _SCENE_SEEDS + int(rng.integers(1 << 24))
        folder = write_scene(family, seed, work / f"scene-{number}")
        town, scene = build_scene(folder, work / f"town-{number}")
        ticks = round(scene.duration_s / config.world.tick_s)
        seats = tuple(replace(spec, max_steps=ticks) for spec in seat_specs(folder, scene, town.file.origin_m))
        own = scene_config(scene, config)
        yield SegmentPlace(town=replace(town, passing=True), config=own, seats=seats, ticks=ticks, seed=scene.seed)
