"""Small lists in the street corner of `tests/conftest.py`, and policies that do something wrong."""

import time
from functools import cache
from pathlib import Path

from tests.support.worlds import QUICK
from wcsim.agents.evaluation.suite.draw import DrawPlace, WaySpec, free_blocks
from wcsim.agents.evaluation.suite.drive import Piece
from wcsim.agents.opening.list_file import BlockSetup, HashedSuite, suite_from_file, write_list
from wcsim.config import RunConfig, resolve
from wcsim.config.suite import SuiteBlock, SuiteEpisode, SuiteFile, SuiteTown
from wcsim.supervisor.actions import action_set
from wcsim.towns.scenario.town import content_hash, find_town
from wcsim.towns.street import load_street

POINTS = action_set("square81")


def config() -> RunConfig:
    return resolve("quick", QUICK)


@cache
def drawn_in(corner: Path) -> tuple[SuiteBlock, ...]:
    """Two blocks of one episode each: the ways are too near each other for one block of a list."""
    town = find_town(str(corner))
    place = DrawPlace(town.name, load_street(town), config())
    wanted = WaySpec(part="free", profiles=("inattentive",), way_m=(15.0, 40.0))
    return tuple(free_blocks(place, wanted, 1, seed)[0] for seed in (3, 4))


def block_of(corner: Path, max_steps: int = 60, handover: int = 0) -> SuiteBlock:
    drawn = drawn_in(corner)
    cut = {"max_steps": max_steps, "handover_step": handover}
    episodes = tuple(block.episodes[0].model_copy(update=cut) for block in drawn)
    return drawn[0].model_copy(update={"episodes": episodes})


def order_of(corner: Path, block: SuiteBlock, judged: bool = False, late_s: float = 10.0) -> tuple[Piece, BlockSetup]:
    piece = Piece(index=0, block=block, judged=judged, late_s=late_s)
    return piece, BlockSetup(town=find_town(str(corner)), config=config(), seed=block.seed)


def suite_in(corner: Path, *blocks: SuiteBlock) -> HashedSuite:
    town = find_town(str(corner))
    named = (SuiteTown(name=str(corner), sha256=content_hash(town)),)
    placed = tuple(block.model_copy(update={"town": str(corner)}) for block in blocks)
    return suite_from_file(SuiteFile(suite="corner-v1", set="try", settings=QUICK, towns=named, blocks=placed))


def written_list(corner: Path, folder: Path, max_steps: int) -> Path:
    """A file with a list of one block."""
    path = folder / "corner.json"
    write_list(suite_in(corner, block_of(corner, max_steps=max_steps)).file, path)
    return path


def episode(**changes: object) -> SuiteEpisode:
    plain = {
        "start_m": (0.0, 0.0), "heading_rad": 0.0, "goal_m": (9.0, 0.0), "profile": "competent", "max_steps": 50,
        "route_m": 9.0, "reference_s": 6.0,
    }  # fmt: skip
    return SuiteEpisode(**{**plain, **changes})


class Held:
    """Holds one stick."""

    name = "held"

    def __init__(self, x: float = 0.0, y: float = 1.0) -> None:
        self.action = POINTS.nearest((x, y))

    def begin(self) -> None:
        """Nothing is remembered."""

    def reset(self) -> None:
        """Nothing is remembered."""

    def act(self, observation: object) -> int:
        return self.action


class Dies(Held):
    """Dies after some steps."""

    left = 5

    def act(self, observation: object) -> int:
        self.left -= 1
        if self.left < 0:
            raise RuntimeError("no more")
        return self.action


class OutOfTheGrid(Held):
    def act(self, observation: object) -> int:
        return 81


class NoNumber(Held):
    def act(self, observation: object) -> float:
        return float("nan")


class Sleeps(Held):
    """Its first answer takes longer than it may think later, its second one too long."""

    steps = 0

    def act(self, observation: object) -> int:
        self.steps += 1
        time.sleep(0.4 if self.steps == 1 else 5.0)
        return self.action


class Waits(Held):
    """Each answer takes longer by the wall clock than it may by the processor's."""

    def act(self, observation: object) -> int:
        time.sleep(0.3)
        return self.action


class Starts(Held):
    """Is never ready."""

    def begin(self) -> None:
        time.sleep(5.0)


class Levels(Held):
    """Stands still, and notes its level of each step."""

    levels, level = (0.0, 2.0), 1.0

    def reset(self) -> None:
        self.noted: list[float] = []

    def act(self, observation: object) -> int:
        self.noted.append(self.level)
        return self.action

    def set_level(self, level: float) -> None:
        self.level = level


class WarnsAlways(Held):
    """Follows nothing and warns all the time."""

    warning = True
