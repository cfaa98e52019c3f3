"""Shared fixtures, and the time of each group of tests, printed at the end of a run."""

import gc
import os
import signal
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples in every run: a test that fails by chance stops somebody else's work.
settings.register_profile("wcsim", derandomize=True, deadline=None)
settings.load_profile("wcsim")

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared"

LONGEST_TMPDIR = 24

PROOF_TIMEOUT_S = 2400
"""A single proof may take minutes; this is for one that hangs."""

WAITING = ("tests/server/", "tests/drive/page/", "tests/drive/serving/", "tests/attack/peers/")
"""Where tests mostly wait, for leases, for processes and for the pace of a drive."""


def file_of(item: pytest.Item) -> str:
    """The file that a test stands in; its location may be that of a class that it inherits from."""
    return item.nodeid.partition("::")[0]


def group_of(node_id: str) -> str:
    """The folder under tests/ that a test lies in; doctests of the package count as "wcsim"."""
    parts = Path(node_id.split("::")[0]).parts
    return parts[1] if parts[0] == "tests" and len(parts) > 2 else parts[0]


def pytest_configure() -> None:
    """Hear Ctrl-C: in a shell's background it is ignored, and every process that a test starts would inherit that.

    Tests open sockets in their folders, whose paths then end at 107 bytes; so the folders lie where paths are short.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if len(tempfile.gettempdir()) > LONGEST_TMPDIR:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", "/tmp")  # noqa: S108 - pytest's folder in it is its owner's alone


def pytest_collection_finish() -> None:
    """Let the collector pass over what importing left: with thousands of tests it took an eighth of their time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    spent, counts = Counter[str](), Counter[str]()
    for report in (each for reports in terminalreporter.stats.values() for each in reports):
        if hasattr(report, "duration") and hasattr(report, "nodeid"):
            spent[group_of(report.nodeid)] += report.duration
            counts[group_of(report.nodeid)] += report.when == "call"
    terminalreporter.section("time by group")
    for group in sorted(spent):
        terminalreporter.write_line(f"{group:<12}{counts[group]:4d} tests {spent[group]:7.1f} s")


def places(files: Iterable[str]) -> dict[str, float]:
    """Where each file of tests runs, by number: those that wait evenly between the others, which use the cores then."""
    kinds = {file: file.startswith(WAITING) for file in files}
    counts, found = Counter(kinds.values()), dict[str, float]()
    for waits in counts:
        own = [file for file, kind in kinds.items() if kind is waits]
        found |= {file: (number + 0.5) / counts[waits] for number, file in enumerate(own)}
    return found


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    at = places(map(file_of, items))
    items.sort(key=lambda item: at[file_of(item)])
    for item in items:
        if "proof" in item.keywords and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(PROOF_TIMEOUT_S))
    if (SHARED / "towns" / "README.md").is_file():  # anybody may have a folder of that name beside the checkout
        return
    skip = pytest.mark.skip(reason="needs the development material beside the checkout (../shared), which is not here")
    for item in items:
        if item.get_closest_marker("shared") is not None:  # not a folder of that name, as tests/cli/shared is
            item.add_marker(skip)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The development material beside the checkout; a test that uses it carries the marker `shared`."""
    return SHARED


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a cache that this test alone has."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="session")
def corner(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A town of one street corner with a little traffic, built from a hand-written scene; starts in no time."""
    from wcsim.towns.scene_folders.build import build_scene, find_scene

    work = tmp_path_factory.mktemp("corner")
    from wcsim.towns.scenario.town import find_town
    from wcsim.towns.street import load_street

    build_scene(find_scene(str(ROOT / "scenarios" / "sumo" / "scenes" / "pedestrian-crossing")), work)
    load_street(find_town(str(work)))  # once, for all commands
    return work


@pytest.fixture(scope="session")
def corner_town(corner: Path) -> object:
    """The town in the folder `corner`."""
    from wcsim.towns.scenario.town import find_town

    return find_town(str(corner))
