"""The list of `wcsim demo`: ways and scenes in which the user alone often crashes, drawn once more, and free ways.

The rule looks at the user alone. No network drives before the list is written.
`python -m benchmarks.judge.demo_list FILE` writes it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.suite.draw import DrawPlace, WaySpec, free_blocks
from wcsim.agents.evaluation.suite.make import SETTINGS, scene_block
from wcsim.agents.evaluation.suite.run import SuiteOrder, run_suite
from wcsim.agents.opening.list_file import suite_from_file, write_list
from wcsim.agents.policy_api import UNAIDED
from wcsim.cli.shared.consoles import print_note
from wcsim.config import resolve
from wcsim.config.suite import SuiteBlock, SuiteFile, SuiteTown
from wcsim.core.own_folder import create_temporary_folder
from wcsim.towns.making.asked_town import made_town
from wcsim.towns.scenario.town import content_hash
from wcsim.towns.scene_folders.families import LISTED
from wcsim.towns.street import load_street

TOWN_SEED: Final = 9003  # a town of this list alone
CHOICE_SEEDS: Final = tuple(range(900, 906))  # of the draws that the rule looks at
FRESH_SEED: Final = 950  # of those that are driven
SEARCHED: Final = 6  # blocks of ways, six each
FAMILIES, WAYS, FREE = 4, 3, 7  # that are taken
_WANTED: Final = WaySpec(part="free", profiles=("ataxic",), way_m=(30.0, 70.0))
_LASTS_STEPS: Final = 1200


def demo_list(work: Path, jobs: int, told: Callable[[str], object]) -> SuiteFile:
    """Choose and draw; the scenes and ways that were taken are told, each with its crashes."""
    town = made_town(work / "towns", TOWN_SEED)
    place = DrawPlace(town.name, load_street(town), resolve("quick", SETTINGS))
    named = SuiteTown(name=town.name, sha256=content_hash(town), made_seed=TOWN_SEED)
    drawn = [_shortened(block) for block in free_blocks(place, _WANTED, SEARCHED + 2, 0)]
    ways = [block.model_copy(update={"episodes": (each,)}) for block in drawn[:SEARCHED] for each in block.episodes]

    def listed(blocks: Sequence[SuiteBlock]) -> SuiteFile:
        return SuiteFile(suite="street-help-v2", set="demo", settings=SETTINGS, towns=(named,), blocks=tuple(blocks))

    def most(number: int, tries: Sequence[Sequence[SuiteBlock]]) -> list[int]:
        """Those with the most own crashes of the user alone; among equals the first."""
        order = SuiteOrder(
            suite=suite_from_file(listed([each for one in tries for each in one])), out=work, jobs=jobs, forks=0
        )
        records = iter(run_suite(order, (UNAIDED,), lambda _, done, of: told(f"{done} of {of}"))[UNAIDED])
        own = [sum(next(records).own for _ in one) for one in tries]
        taken = sorted(range(len(own)), key=lambda place: (-own[place], place))[:number]
        for place in taken:
            told(f"{tries[place][0].town}, {place}: {own[place]} of {len(tries[place])}")
        return taken

    families = most(FAMILIES, [[scene_block(name, seed) for seed in CHOICE_SEEDS] for name in LISTED])
    chosen = most(WAYS, [[way.model_copy(update={"seed": seed}) for seed in CHOICE_SEEDS] for way in ways])
    hazards = [ways[place].model_copy(update={"part": "hazard", "seed": FRESH_SEED}) for place in chosen]
    scenes = [scene_block(LISTED[place], FRESH_SEED) for place in families]
    first, second = drawn[SEARCHED:]
    rest = second.model_copy(update={"episodes": second.episodes[: FREE - len(first.episodes)]})
    return listed([*hazards, *scenes, first, rest])


def _shortened(block: SuiteBlock) -> SuiteBlock:
    episodes = tuple(each.model_copy(update={"max_steps": _LASTS_STEPS}) for each in block.episodes)
    return block.model_copy(update={"episodes": episodes})


if __name__ == "__main__":
    with create_temporary_folder() as folder:
        write_list(demo_list(folder, 2, print_note), Path(sys.argv[1]))
