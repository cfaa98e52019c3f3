"""Makes lists of test episodes: free ways, hazards of real streets, and generated scenes.

Or drawn ones.

Which draws a list takes depends on the user alone, who drives all of them before any policy does.
A way is left out where somebody hits him at once. A hazard is a way on which he crashes by his own
fault; the policy takes over 10 s before.
A hazard or scene is left out where no copy of the world shows that his crash could be survived;
those are counted.
What has a town, family or user that is held out of training is in a part of its own.
"""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.suite.draw import SEATS, DrawPlace, WaySpec, free_blocks
from wcsim.agents.evaluation.suite.records import CRASHED, EpisodeRecord
from wcsim.agents.evaluation.suite.run import SuiteOrder, run_suite
from wcsim.agents.opening.list_file import SCENE, SCENE_TOWN, suite_from_file
from wcsim.agents.policy_api import UNAIDED
from wcsim.config import resolve
from wcsim.config.held_out import HELD_OUT
from wcsim.config.suite import SuiteBlock, SuiteEpisode, SuiteFile, SuiteRecipe, SuiteTown
from wcsim.core import seeding
from wcsim.core.constants import RECORDED
from wcsim.core.own_folder import create_temporary_folder
from wcsim.errors import TownError
from wcsim.towns.scenario.town import Town, by_name, content_hash, find_town
from wcsim.towns.scene_folders.build import build_scene, scene_digest, seat_specs
from wcsim.towns.scene_folders.families import write_scene
from wcsim.towns.street import load_street

BAD_START_S: Final = 3.0  # who is hit before this was put where somebody came along
HANDOVER_S: Final = 10.0  # before the crash of the user alone the policy takes over
SOONEST_S: Final = 12.0  # a crash before this leaves no time for that
AFTER_S: Final = 20.0  # so long after the handover a hazard lasts
SETTINGS: Final = ("cameras.0.noise=typical", "world.action_delay_ticks=2", "env.max_steps=10000")
_ROUNDS: Final = 20  # of draws, until a list gives up
_WAYS: Final = 6  # that are looked through for each hazard that is missing
_TICK_S: Final = 0.1  # of a generated scene

Report = Callable[
    [str, float], object
]  # a line, and the share of its part of the work that is done
_NAMED = 60  # characters of a user, in the name of a part


def make_suite(
    recipe: SuiteRecipe,
    towns: Sequence[tuple[Town, int | None]],
    report: Report,
    *,
    named: str,
    seed: int,
    work: Path,
    jobs: int = 1,
) -> SuiteFile:
    """A list for these towns, each with the seed that it was made of.

    The user drives all draws alone.

    Args:
        recipe: What is drawn.
        towns: Where.
        report: Hears how far it is.
        named: The list's set.
        seed: Of all draws.
        work: Folder for what is driven meanwhile.
        jobs: Parallel processes.

    Raises TownError for one that is too small, and for two of one name.
    """
    config = resolve("quick", SETTINGS)
    by_name(town for town, _ in towns)
    listed = [_listed_as(town, made_seed) for town, made_seed in towns]
    there = tuple(
        SuiteTown(name=name, sha256=content_hash(town), made_seed=made_seed)
        for name, (town, made_seed) in zip(listed, towns, strict=True)
    )
    places = [
        DrawPlace(town.name, load_street(town), config, name)
        for name, (town, _) in zip(listed, towns, strict=True)
    ]
    maker = _Maker(
        recipe=recipe, set=named, seed=seed, work=work, jobs=jobs, towns=there, report=report
    )
    # First what a recipe may name wrongly.
    scenes = maker.scenes()
    ways = (("free", recipe.free, 0.0), ("crossing", recipe.crossings, 1.0))
    free = [block for place in places for each in ways for block in maker.ways(place, *each)]
    hazards = [block for place in places for block in maker.hazards(place)]
    blocks = [*scenes, *hazards]
    for number, block in enumerate(blocks):
        met = {
            "family": [block.town],
            "town": [block.town],
            "profile": [each.profile for each in block.episodes],
        }
        if any(name in HELD_OUT[kind] for kind, names in met.items() for name in names):
            blocks[number] = block.model_copy(update={"part": "held-out"})
    return maker.listed((*free, *sorted(blocks, key=lambda block: block.part == "held-out")))


def _listed_as(town: Town, made_seed: int | None) -> str:
    """What a list calls a town, so that a test finds it again.

    Its name where that leads to it, else where it lies.
    """
    if made_seed is None:
        with suppress(TownError):
            if find_town(town.name).sumocfg.resolve() == town.sumocfg.resolve():
                return town.name
        return town.address
    return town.name


@dataclass(frozen=True, slots=True, kw_only=True)
class _Maker:
    """Draws blocks, and lets the user drive them."""

    recipe: SuiteRecipe
    set: str
    seed: int
    work: Path
    jobs: int
    towns: tuple[SuiteTown, ...]
    report: Report

    def listed(self, blocks: Sequence[SuiteBlock]) -> SuiteFile:
        """A list of these blocks."""
        return SuiteFile(
            suite=self.recipe.suite,
            set=self.set,
            settings=SETTINGS,
            towns=self.towns,
            blocks=tuple(blocks),
        )

    def ways(
        self, place: DrawPlace, part: str, blocks: int, crossing_share: float
    ) -> list[SuiteBlock]:
        """Blocks of ways whose users start well.

        Who is left out is missing in the street of the others: what is left is driven again,
        until all of it stays.
        """
        spec = WaySpec(
            part=part,
            profiles=self.recipe.profiles,
            crossing_share=crossing_share,
        )
        pending = list(enumerate(free_blocks(place, spec, blocks, self.seed)))
        done: dict[int, SuiteBlock] = {}
        while pending:
            records = self._alone([block for _, block in pending], f"{place.name}, {part}", forks=0)
            changed = []
            for index, (number, block) in enumerate(pending):
                own = [record for record in records if record.block == index]
                staying = [
                    episode
                    for episode, record in zip(block.episodes, own, strict=True)
                    if record.status != CRASHED or record.time_s >= BAD_START_S
                ]
                block = block.model_copy(update={"episodes": tuple(staying)})
                if len(staying) == len(own):
                    done[number] = block
                elif staying:
                    changed.append((number, block))
            pending = changed
        return [done[number] for number in sorted(done)]

    def hazards(self, place: DrawPlace) -> list[SuiteBlock]:
        """Ways of one chair each, drawn until enough end in a crash that could be survived."""
        spec = WaySpec(part="streets", profiles=self.recipe.profiles)
        found: list[SuiteBlock] = []
        left_out = 0
        for turn in range(_ROUNDS):
            missing = self.recipe.hazards - len(found)
            if missing <= 0:
                break
            seed = seeding.derive_seed(self.seed, "hazards", turn)
            drawn = free_blocks(place, spec, missing * _WAYS // SEATS + 1, seed)
            ways = [
                block.model_copy(update={"episodes": (each,)})
                for block in drawn
                for each in block.episodes
            ]
            records = self._alone(ways, f"{place.name}, hazards")
            for way, record in zip(ways, records, strict=True):
                if not record.own or record.time_s < SOONEST_S:
                    continue
                if record.last_moment_s is None:
                    left_out += 1
                elif len(found) < self.recipe.hazards:
                    found.append(
                        way.model_copy(
                            update={"episodes": (_handed_over(way.episodes[0], record),)}
                        )
                    )
        self.report(f"{place.name}, hazards: {len(found)} found, {left_out} left out", 1.0)
        return found

    def scenes(self) -> list[SuiteBlock]:
        """Draws of each family as they fall, less crashes that no copy of the world survived."""
        numbers = {family: number for family, number in self.recipe.scenes.items() if number}
        # So that lists of other towns have other scenes.
        towns = [town.name for town in self.towns]
        found: dict[str, list[SuiteBlock]] = {family: [] for family in numbers}
        drawn, left_out = Counter[str](), Counter[str]()
        for _ in range(_ROUNDS):
            blocks = []
            for family, number in numbers.items():
                for _ in range(number - len(found[family])):
                    seed = seeding.derive_seed(self.seed, "scenes", *towns, family, drawn[family])
                    blocks.append(scene_block(family, seed))
                    drawn[family] += 1
            if not blocks:
                break
            for block, record in zip(blocks, self._alone(blocks, "scenes"), strict=True):
                if record.status == CRASHED and record.last_moment_s is None:
                    left_out[block.town] += 1
                else:
                    found[block.town].append(block)
        for family in numbers:
            self.report(f"{family}: {drawn[family]} drawn, {left_out[family]} left out", 1.0)
        return [block for blocks in found.values() for block in blocks]

    def _alone(
        self, blocks: Sequence[SuiteBlock], what: str, forks: int = 1_000_000
    ) -> tuple[EpisodeRecord, ...]:
        """The user's records; with forks, each crash has its last moment."""
        driven = SuiteOrder(
            suite=suite_from_file(self.listed(blocks)),
            out=self.work,
            jobs=self.jobs,
            forks=forks,
            shared=True,
        )
        return run_suite(
            driven,
            (UNAIDED,),
            lambda _, done, of: self.report(f"{what}: {done} of {of} blocks", done / of),
        )[UNAIDED]


def _handed_over(episode: SuiteEpisode, record: EpisodeRecord) -> SuiteEpisode:
    """An episode whose user crashes alone, with its handover 10 s before."""
    tick_s = record.time_s / record.steps
    handover = record.steps - round(HANDOVER_S / tick_s)
    last = handover + round((HANDOVER_S + AFTER_S) / tick_s)
    return episode.model_copy(update={"handover_step": handover, "max_steps": last})


def scene_block(family: str, seed: int) -> SuiteBlock:
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
            part="scenes",
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
    """As many episodes for each town and user, of so many chairs.

    A part of the list is one user in one town.

    An episode goes on from goal to goal until a crash or its last step. The first one's world has
    the seed itself.
    """
    listed = [_listed_as(town, None) for town in towns]
    blocks = []
    for (town, name), (place, profile) in product(
        zip(towns, listed, strict=True), enumerate(profiles)
    ):
        user = re.sub(r"[^A-Za-z0-9.-]+", " ", profile).strip()[-_NAMED:].strip()
        # two files may be called alike
        again = f" {place + 1}" if len(profiles) > 1 and user != profile else ""
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
                    seed=seeding.derive_seed(seed, "episode", number)
                    if number
                    else seed % (1 << 31),
                    episodes=(drawn,) * chairs,
                )
            )
    named = tuple(
        SuiteTown(name=name, sha256=content_hash(town))
        for town, name in zip(towns, listed, strict=True)
    )
    suite = "-".join(_word(town.name).lower() for town in towns)[:_NAMED].strip("-")
    return SuiteFile(
        suite=suite,
        set=f"seed-{seed}",
        settings=settings,
        towns=named,
        forks=0,
        blocks=tuple(blocks),
    )


def _word(name: str) -> str:
    """A town's name as a list may have it."""
    return re.sub(r"[^A-Za-z0-9-]+", "-", name).strip("-") or "town"
