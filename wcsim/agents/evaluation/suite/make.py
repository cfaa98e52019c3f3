"""Makes lists of test episodes: free ways, attempts at crossings, hazards and tight places, or drawn ones.

A hazard is an episode in which the user alone crashes by the chair's own fault. It is found by driving: the free ways
are driven by the user alone, those that crash are driven once more without the others of their block, and who crashes
again is taken over by the policy 10 s before.
"""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.suite.draw import SEATS, DrawPlace, Wanted, crossing_blocks, free_blocks
from wcsim.agents.evaluation.suite.records import CRASHED, EpisodeRecord
from wcsim.agents.evaluation.suite.run import SuiteOrder, run_suite
from wcsim.agents.opening.list_file import SCENE, SCENE_TOWN, suite_from_file
from wcsim.agents.policy_api import UNAIDED
from wcsim.config import RunConfig, resolve
from wcsim.config.suite import SuiteBlock, SuiteEpisode, SuiteFile, SuiteTown
from wcsim.core import seeding
from wcsim.core.constants import RECORDED
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import pluralize
from wcsim.errors import TownError
from wcsim.towns.making.asked_town import refuse_held_out_town
from wcsim.towns.scenario.town import Town, by_name, content_hash, find_town
from wcsim.towns.scene_folders.build import build_scene, scene_digest, seat_specs
from wcsim.towns.scene_folders.families import LISTED, TRAINED, write_scene
from wcsim.towns.street import load_street

BAD_START_S: Final = 3.0  # who is hit before this was put where somebody came along
LEFT_S: Final = 4.0  # the user alone crashes no sooner after the handover
HANDOVER_S: Final = 10.0  # before the crash of the user alone the policy takes over
SOONEST_S: Final = 12.0  # a crash before this leaves no time for that
AFTER_S: Final = 20.0  # so long after the handover a hazard lasts
SETTINGS: Final = ("cameras.0.noise=typical", "world.action_delay_ticks=2", "env.max_steps=10000")
_MORE: Final = "search more routes (--more-ways 6), or leave hazards out (--hazards 0)"
CARELESS_STREET: Final = "world.attention_share=0.7"
USUAL_STREET: Final = "world.attention_share=0.95"
_TICK_S: Final = 0.1  # of a generated scene

Told = Callable[[str, float], object]  # a line, and the share of its part of the work that is done
_NAMED = 60  # characters of a user, in the name of a part


@dataclass(frozen=True, slots=True, kw_only=True)
class MakeOrder:
    """How large a list is; numbers are for each town."""

    suite: str  # with its version
    set: str
    seed: int
    free_blocks: int
    attempts: int
    hazards: int  # at most
    more_ways: int = 0  # blocks of free ways that are looked through for hazards alone
    tight: range  # seeds of the generated scenes, of each family
    to_choose_by: bool = False  # without what is held out
    forks: int = 1_000_000  # episodes of the whole list whose interventions are judged, at most
    jobs: int = 1
    work: Path  # folder for what is driven meanwhile


def make_suite(order: MakeOrder, towns: Sequence[tuple[Town, int | None]], told: Told) -> SuiteFile:
    """A list for these towns, each with the seed that it was made of; drives in them to find the hazards.

    Raises TownError for one that is too small, and for two of one name; ConfigError for one that is held out.
    """
    config = resolve("quick", SETTINGS)
    by_name(town for town, _ in towns)
    listed = [_listed_as(town, seed, order.to_choose_by) for town, seed in towns]
    named = tuple(
        SuiteTown(name=name, sha256=content_hash(town), made_seed=seed)
        for name, (town, seed) in zip(listed, towns, strict=True)
    )
    streets = [(name, town.name, load_street(town)) for name, (town, _) in zip(listed, towns, strict=True)]
    places = [DrawPlace(own, street, config, name) for name, own, street in streets]
    free = [block for place in places for block in _free(place, order)]
    crossing = [block for place in places for block in _crossing(place, order)]
    drawn = f"{len(free)} block{'s' * (len(free) != 1)} of free routes and {len(crossing)} of attempts at crossings"
    told(f"drew {drawn}", 0.0)
    free = _settled(order, named, free, told, "free routes", _starts_well)
    crossing = _settled(order, named, crossing, told, "attempts", _starts_well)
    more = [block for place in places for block in _free(place, order, more=True)] if order.more_ways else []
    hazard = _hazards(order, named, [*free, *more], config, told) if order.hazards else []
    return SuiteFile(
        suite=order.suite,
        set=order.set,
        settings=SETTINGS,
        towns=named,
        forks=order.forks,
        blocks=(*free, *crossing, *hazard, *_tight_blocks(order.tight, order.to_choose_by)),
    )


def _listed_as(town: Town, made_seed: int | None, to_choose_by: bool = False) -> str:
    """What a list calls a town, so that a test finds it again: its name where that leads to it, else where it lies.

    Raises ConfigError for one that is held out, for a list to choose by.
    """
    if to_choose_by:
        refuse_held_out_town(town)
    if made_seed is None:
        with suppress(TownError):
            if find_town(town.name).sumocfg.resolve() == town.sumocfg.resolve():
                return town.name
        return town.address
    return town.name


def _free(place: DrawPlace, order: MakeOrder, more: bool = False) -> list[SuiteBlock]:
    often = "tremor" if order.to_choose_by else "ataxic"
    wanted = Wanted(part="free", profiles=(often, often, "inattentive"), settings=(USUAL_STREET,))
    if more:
        return free_blocks(place, wanted, order.more_ways, seeding.derive_seed(order.seed, "more ways"))
    return free_blocks(place, wanted, order.free_blocks, order.seed)


def _crossing(place: DrawPlace, order: MakeOrder) -> list[SuiteBlock]:
    """Careful and careless users, among others who look and others who look less."""
    made: list[SuiteBlock] = []
    for number, settings in enumerate((USUAL_STREET, CARELESS_STREET)):
        wanted = Wanted(part="crossing", profiles=("competent", "inattentive"), settings=(settings,))
        attempts = (order.attempts + 1 - number) // 2
        if attempts:
            made += crossing_blocks(place, wanted, attempts, seeding.derive_seed(order.seed, "crossing", number))
    return made


def _hazards(
    order: MakeOrder, towns: tuple[SuiteTown, ...], free: Sequence[SuiteBlock], config: RunConfig, told: Told
) -> list[SuiteBlock]:
    first = _alone(order, towns, free, told, "free routes")
    candidates = [_crashing(block, first, index, config) for index, block in enumerate(free)]
    blocks = [block for block in candidates if block is not None]
    if not blocks:
        raise TownError(f"no drive of the user alone ended in an own crash; expected some: {_MORE}")
    again = _alone(order, towns, blocks, told, "hazards")
    found: list[SuiteBlock] = []
    left = {town.name: order.hazards for town in towns}
    for index, block in enumerate(blocks):
        taken = _crashing(block, again, index, config, taken_over=True)
        if taken is not None and left[block.town] > 0:
            episodes = taken.episodes[: left[block.town]]
            left[block.town] -= len(episodes)
            found.append(taken.model_copy(update={"episodes": episodes}))
    settled_ones = _settled(order, towns, found, told, "hazards to the end", _ends_in_time)
    number = sum(len(block.episodes) for block in settled_ones)
    none = f"no hazards found: no crash of the user alone happened again without the other chairs; {_MORE}"
    told(f"found {pluralize(number, 'hazard')}" if number else none, 0.0)
    return settled_ones


def _settled(
    order: MakeOrder,
    towns: tuple[SuiteTown, ...],
    blocks: Sequence[SuiteBlock],
    told: Told,
    what: str,
    keeps: Callable[[EpisodeRecord], bool],
) -> list[SuiteBlock]:
    """The blocks with those episodes alone that `keeps` keeps when the user drives alone.

    Who is left out is missing in the street of the others, so that what is left is driven again, until all of it stays.
    """
    done: dict[int, SuiteBlock] = {}
    pending = list(enumerate(blocks))
    while pending:
        records = _alone(order, towns, [block for _, block in pending], told, what)
        changed: list[tuple[int, SuiteBlock]] = []
        for place, (number, block) in enumerate(pending):
            own = {record.seat: record for record in records if record.block == place}
            kept = tuple(episode for seat, episode in enumerate(block.episodes) if keeps(own[seat]))
            if len(kept) == len(block.episodes):
                done[number] = block
            elif kept:
                changed.append((number, block.model_copy(update={"episodes": kept})))
        pending = changed
    return [done[number] for number in sorted(done)]


def _starts_well(record: EpisodeRecord) -> bool:
    return record.status != CRASHED or record.time_s >= BAD_START_S


def _ends_in_time(record: EpisodeRecord) -> bool:
    return record.own and record.time_s >= LEFT_S


def _alone(
    order: MakeOrder, towns: tuple[SuiteTown, ...], blocks: Sequence[SuiteBlock], told: Told, what: str
) -> tuple[EpisodeRecord, ...]:
    file = SuiteFile(suite=order.suite, set=order.set, settings=SETTINGS, towns=towns, blocks=tuple(blocks))
    driven = SuiteOrder(suite=suite_from_file(file), out=order.work, jobs=order.jobs, forks=0)
    return run_suite(driven, (UNAIDED,), lambda _, done, of: told(f"{what}: {done} of {of} blocks", done / of))[UNAIDED]


def _crashing(
    block: SuiteBlock, records: Sequence[EpisodeRecord], index: int, config: RunConfig, taken_over: bool = False
) -> SuiteBlock | None:
    """The block with those of its episodes alone that crash late enough; with the handover when `taken_over`."""
    tick_s = config.world.tick_s
    episodes = []
    for record in records:
        if record.block == index and record.own and record.time_s >= SOONEST_S:
            episode = block.episodes[record.seat]
            episodes.append(_handed_over(episode, record, tick_s) if taken_over else episode)
    if not episodes:
        return None
    return block.model_copy(update={"part": "hazard", "episodes": tuple(episodes[:SEATS])})


def _handed_over(episode: SuiteEpisode, record: EpisodeRecord, tick_s: float) -> SuiteEpisode:
    """An episode whose user crashes alone, with its handover 10 s before; all its way is what half the pace reaches."""
    handover = record.steps - round(HANDOVER_S / tick_s)
    lasts_s = HANDOVER_S + AFTER_S
    before_m = record.done_m * handover / record.steps
    pace_mps = episode.route_m / episode.reference_s
    way_m = min(episode.route_m - before_m, 0.5 * lasts_s * pace_mps)
    return episode.model_copy(
        update={
            "handover_step": handover,
            "max_steps": handover + round(lasts_s / tick_s),
            "route_m": round(before_m + way_m, 3),
            "reference_s": round(lasts_s * (before_m + way_m) / way_m, 2) if way_m > 0.0 else episode.reference_s,
        }
    )


def _tight_blocks(seeds: Sequence[int], to_choose_by: bool = False) -> list[SuiteBlock]:
    """A block for each listed family of scenes and each seed."""
    families = TRAINED if to_choose_by else LISTED
    return [tight_block(family, seed) for family in families for seed in seeds]


def tight_block(family: str, seed: int) -> SuiteBlock:
    """A block in a generated scene. Raises TownError for one without a start."""
    with create_temporary_folder() as work:
        folder = write_scene(family, seed, work / SCENE)
        town, scene = build_scene(folder, work / SCENE_TOWN)
        (spec,) = seat_specs(folder, scene, town.file.origin_m)
        start = spec.start
        if start is None:
            raise TownError(f"scene {family} {seed} has no start; expected one")
        user = spec.profile
        if user.startswith(RECORDED):
            user = f"{RECORDED}{Path(user.removeprefix(RECORDED)).name}"
        return SuiteBlock(
            part="tight",
            town=family,
            scene_sha256=scene_digest(folder),
            seed=seed,
            episodes=(
                SuiteEpisode(
                    start_m=(round(start.p_W_m[0], 4), round(start.p_W_m[1], 4)),
                    heading_rad=round(start.yaw_rad, 6),
                    goal_m=(round(start.goal_W_m[0], 4), round(start.goal_W_m[1], 4)),
                    profile=user,
                    max_steps=round(scene.duration_s / _TICK_S),
                    route_m=0.0,  # what counts is to come through
                    reference_s=scene.duration_s,
                ),
            ),
        )


def town_list(
    towns: Sequence[Town],
    profiles: Sequence[str],
    episodes: int,
    max_steps: int,
    seed: int,
    settings: tuple[str, ...] = (),
    chairs: int = 1,
) -> SuiteFile:
    """As many episodes for each town and user, of so many chairs; a part of the list is one user in one town.

    An episode goes on from goal to goal until a crash or its last step. The first one's world has the seed itself.
    """
    listed = [_listed_as(town, None) for town in towns]
    blocks = []
    for (town, name), (place, profile) in product(zip(towns, listed, strict=True), enumerate(profiles)):
        user = re.sub(r"[^A-Za-z0-9.-]+", " ", profile).strip()[-_NAMED:].strip()
        again = f" {place + 1}" if len(profiles) > 1 and user != profile else ""  # two files may be called alike
        for number in range(episodes):
            drawn = SuiteEpisode(
                start_m=None,
                heading_rad=0.0,
                goal_m=None,
                profile=profile,
                max_steps=max_steps,
                route_m=0.0,  # what counts is to come through
                reference_s=float(max_steps),
            )
            blocks.append(
                SuiteBlock(
                    part=f"{_word(town.name)}, {user} user{again}",
                    town=name,
                    seed=seeding.derive_seed(seed, "episode", number) if number else seed % (1 << 31),
                    episodes=(drawn,) * chairs,
                )
            )
    named = tuple(SuiteTown(name=name, sha256=content_hash(town)) for town, name in zip(towns, listed, strict=True))
    suite = "-".join(_word(town.name).lower() for town in towns)[:_NAMED].strip("-")
    return SuiteFile(suite=suite, set=f"seed-{seed}", settings=settings, towns=named, forks=0, blocks=tuple(blocks))


def _word(name: str) -> str:
    """A town's name as a list may have it."""
    return re.sub(r"[^A-Za-z0-9-]+", "-", name).strip("-") or "town"
