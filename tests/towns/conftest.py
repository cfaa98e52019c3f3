"""Streets that the tests of this package share."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from tests.support.tracked import ROOT
from tests.towns.made import hostile
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.scene_folders.build import build_scene, find_scene
from wcsim.towns.street import load_street
from wcsim.towns.sumo.tools import run_tool
from wcsim.types import Street

WriteScenario = Callable[..., Path]


def bytes_in(folder: Path) -> dict[str, bytes]:
    """What all files of a folder hold."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def tool_output(tool: str, options: list[str], folder: Path) -> str:
    """What a tool of SUMO says that runs in a folder and does not fail."""
    run = run_tool(tool, options, folder)
    assert run.returncode == 0, run.output
    return run.output


def run_in_sumo(sumocfg: Path, end_s: float, folder: Path, *options: str) -> str:
    """What SUMO says of a scenario that it runs without an error."""
    output = tool_output("sumo", ["-c", str(sumocfg), "--end", str(end_s), "--no-step-log", *options], folder)
    assert "Error" not in output, output
    return output


@pytest.fixture(autouse=True)
def each_own_cache(own_cache: Path) -> None:
    """Every test here has a cache of its own."""


@pytest.fixture(scope="session")
def corner_town(tmp_path_factory: pytest.TempPathFactory) -> Town:
    """A hand-written crossroads with pavements and four zebra crossings."""
    return build_scene(find_scene("pedestrian-crossing"), tmp_path_factory.mktemp("corner"))[0]


@pytest.fixture
def write_theirs(corner_town: Town, tmp_path: Path) -> WriteScenario:
    """Writes a stranger's scenario on the corner's streets into `theirs`; see `hostile.scenario`."""
    return partial(hostile.scenario, corner_town, tmp_path / "theirs")


@pytest.fixture(scope="session")
def lane(corner_town: Town) -> str:
    """A lane of the corner for cars."""
    return hostile.lane_of(corner_town)


@pytest.fixture(scope="session")
def corner(corner_town: Town) -> Street:
    return unpack_street(build_street(corner_town))


@pytest.fixture(scope="session")
def manhattan_town() -> Town:
    return find_town(str(ROOT / "scenarios" / "sumo" / "manhattan"))


@pytest.fixture(scope="session")
def kept_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that all workers of a session share."""
    own = tmp_path_factory.getbasetemp()
    return (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "cache"


@pytest.fixture(scope="session")
def manhattan(manhattan_town: Town, kept_cache: Path) -> Street:
    """Built once a session, by the worker that comes first."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(kept_cache))
        return load_street(manhattan_town)
