"""Makes a list of test episodes for any towns: free ways, attempts at crossings, and starts that end in a crash.

A hazard is an episode in which the user alone crashes by the chair's own fault. It is found by driving: the free ways
are driven by the user alone, those that crash are driven once more without the others of their block, and who crashes
again is taken over by the policy 10 s before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.making.draw import SEATS, DrawPlace, Wanted, crossing_blocks, free_blocks, place_of
from wcsim.agents.evaluation.suite.list_file import suite_of
from wcsim.agents.evaluation.suite.records import CRASHED, EpisodeRecord
from wcsim.agents.evaluation.suite.run import SuiteOrder, run_suite
from wcsim.agents.evaluation.suite.tight import tight_blocks
from wcsim.agents.policy_api import UNAIDED
from wcsim.config import RunConfig, resolve
from wcsim.config.suite import BlockFile, EpisodeFile, SuiteFile, TownOfSuite
from wcsim.core import seeding
from wcsim.core.reading import counted
from wcsim.errors import TownError
from wcsim.towns.scenario.town import Town, by_name, content_hash, find_town
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

Told = Callable[[str, float], object]  # a line, and the share of its part of the work that is done


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
    forks: int = 1_000_000  # episodes of the whole list whose interventions are judged, at most
    jobs: int = 1
    work: Path  # folder for what is driven meanwhile


def make_suite(order: MakeOrder, towns: Sequence[tuple[Town, int | None]], told: Told) -> SuiteFile:
    """A list for these towns, each with the seed that it was made of; drives in them to find the hazards.

    Raises TownError for one that is too small, and for two of one name.
    """
    config = resolve("quick", SETTINGS)
    by_name(town for town, _ in towns)
    listed = [listed_as(town, seed) for town, seed in towns]
    named = tuple(
        TownOfSuite(name=name, sha256=content_hash(town), made_seed=seed)
        for name, (town, seed) in zip(listed, towns, strict=True)
    )
    streets = [(name, town.name, load_street(town)) for name, (town, _) in zip(listed, towns, strict=True)]
    places = [place_of(own, street, config, name) for name, own, street in streets]
    free = [block for place in places for block in _free(place, order)]
    crossing = [block for place in places for block in _crossing(place, order)]
    drawn = f"{len(free)} block{'s' * (len(free) != 1)} of free routes and {len(crossing)} of attempts at crossings"
    told(f"drew {drawn}", 0.0)
    free = settled(order, named, free, told, "free routes", _starts_well)
    crossing = settled(order, named, crossing, told, "attempts", _starts_well)
    more = [block for place in places for block in _free(place, order, more=True)] if order.more_ways else []
    hazard = _hazards(order, named, [*free, *more], config, told) if order.hazards else []
    return SuiteFile(
        suite=order.suite,
        set=order.set,
        settings=SETTINGS,
        towns=named,
        forks=order.forks,
        blocks=(*free, *crossing, *hazard, *tight_blocks(order.tight)),
    )


def listed_as(town: Town, made_seed: int | None) -> str:
    """What a list calls a town, so that a test finds it again: its name where that leads to it, else where it lies."""
    if made_seed is None:
        with suppress(TownError):
            if find_town(town.name).sumocfg.resolve() == town.sumocfg.resolve():
                return town.name
        return town.address
    return town.name


def _free(place: DrawPlace, order: MakeOrder, more: bool = False) -> list[BlockFile]:
    wanted = Wanted(part="free", profiles=("ataxic", "ataxic", "inattentive"), settings=(USUAL_STREET,))
    if more:
        return free_blocks(place, wanted, order.more_ways, seeding.derive(order.seed, "more ways"))
    return free_blocks(place, wanted, order.free_blocks, order.seed)


def _crossing(place: DrawPlace, order: MakeOrder) -> list[BlockFile]:
    """Careful and careless users, among others who look and others who look less."""
    made: list[BlockFile] = []
    for number, settings in enumerate((USUAL_STREET, CARELESS_STREET)):
        wanted = Wanted(part="crossing", profiles=("competent", "inattentive"), settings=(settings,))
        attempts = (order.attempts + 1 - number) // 2
        if attempts:
            made += crossing_blocks(place, wanted, attempts, seeding.derive(order.seed, "crossing", number))
    return made


def _hazards(
    order: MakeOrder, towns: tuple[TownOfSuite, ...], free: Sequence[BlockFile], config: RunConfig, told: Told
) -> list[BlockFile]:
    first = _alone(order, towns, free, told, "free routes")
    candidates = [_crashing(block, first, index, config) for index, block in enumerate(free)]
    blocks = [block for block in candidates if block is not None]
    if not blocks:
        raise TownError(f"no drive of the user alone ended in an own crash; expected some: {_MORE}")
    again = _alone(order, towns, blocks, told, "hazards")
    found: list[BlockFile] = []
    left = {town.name: order.hazards for town in towns}
    for index, block in enumerate(blocks):
        taken = _crashing(block, again, index, config, taken_over=True)
        if taken is not None and left[block.town] > 0:
            episodes = taken.episodes[: left[block.town]]
            left[block.town] -= len(episodes)
            found.append(taken.model_copy(update={"episodes": episodes}))
    settled_ones = settled(order, towns, found, told, "hazards to the end", _ends_in_time)
    number = sum(len(block.episodes) for block in settled_ones)
    none = f"no hazards found: no crash of the user alone happened again without the other chairs; {_MORE}"
    told(f"found {counted(number, 'hazard')}" if number else none, 0.0)
    return settled_ones


def settled(
    order: MakeOrder,
    towns: tuple[TownOfSuite, ...],
    blocks: Sequence[BlockFile],
    told: Told,
    what: str,
    keeps: Callable[[EpisodeRecord], bool],
) -> list[BlockFile]:
    """The blocks with those episodes alone that `keeps` keeps when the user drives alone.

    Who is left out is missing in the street of the others, so that what is left is driven again, until all of it stays.
    """
    done: dict[int, BlockFile] = {}
    pending = list(enumerate(blocks))
    while pending:
        records = _alone(order, towns, [block for _, block in pending], told, what)
        changed: list[tuple[int, BlockFile]] = []
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
    order: MakeOrder, towns: tuple[TownOfSuite, ...], blocks: Sequence[BlockFile], told: Told, what: str
) -> tuple[EpisodeRecord, ...]:
    file = SuiteFile(suite=order.suite, set=order.set, settings=SETTINGS, towns=towns, blocks=tuple(blocks))
    driven = SuiteOrder(suite=suite_of(file), out=order.work, jobs=order.jobs, forks=0)
    return run_suite(driven, (UNAIDED,), lambda _, done, of: told(f"{what}: {done} of {of} blocks", done / of))[UNAIDED]


def _crashing(
    block: BlockFile, records: Sequence[EpisodeRecord], index: int, config: RunConfig, taken_over: bool = False
) -> BlockFile | None:
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


def _handed_over(episode: EpisodeFile, record: EpisodeRecord, tick_s: float) -> EpisodeFile:
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
