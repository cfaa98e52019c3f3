"""Shared fixtures, and the time budget of each group of tests, printed at the end of a run."""

from __future__ import annotations

import gc
import signal
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples in every run: a test that fails by chance stops somebody else's work.
settings.register_profile("wcsim", derandomize=True, deadline=None)
settings.load_profile("wcsim")

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared"

BUDGET_S = {
    "api": 150,
    "agents": 390,
    "attack": 60,
    "benchmarks": 95,
    "bridge": 160,
    "config": 5,
    "core": 20,
    "drive": 185,
    "chair_check": 25,
    "cli": 175,
    "log": 20,
    "physics": 40,
    "scenes": 75,
    "server": 120,
    "supervisor": 20,
    "towns": 190,
    "users": 25,
    "view": 20,
    "wcsim": 5,
}
"""Seconds of test time of a group, for an idle machine of the reference kind: two cores, shared by three workers.

All together under ten minutes. They are printed, and no test fails by them: on another machine they say little.
"""

PROOF_TIMEOUT_S = 2400
"""A single proof may take minutes; this is for one that hangs."""


def group_of(node_id: str) -> str:
    """The folder under tests/ that a test lies in; doctests of the package count as "wcsim"."""
    parts = Path(node_id.split("::")[0]).parts
    return parts[1] if parts[0] == "tests" and len(parts) > 2 else parts[0]


def pytest_configure() -> None:
    """Hear Ctrl-C: in a shell's background it is ignored, and every process that a test starts would inherit that."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """Let the collector pass over what importing left: with thousands of tests it took an eighth of their time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    spent: dict[str, float] = {}
    counts: dict[str, int] = {}
    for reports in terminalreporter.stats.values():
        for report in reports:
            if hasattr(report, "duration") and hasattr(report, "nodeid"):
                group = group_of(report.nodeid)
                spent[group] = spent.get(group, 0.0) + report.duration
                counts[group] = counts.get(group, 0) + (report.when == "call")
    if not spent:
        return
    terminalreporter.section("time by group")
    for group in sorted(spent):
        budget = BUDGET_S.get(group, 0)
        over = "  OVER BUDGET" if spent[group] > budget else ""
        terminalreporter.write_line(f"{group:<12}{counts[group]:4d} tests {spent[group]:7.1f} s of {budget:4d} s{over}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "proof" in item.keywords and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(PROOF_TIMEOUT_S))
    if SHARED.is_dir():
        return
    skip = pytest.mark.skip(reason="needs the development material beside the checkout (../shared), which is not here")
    for item in items:
        if item.get_closest_marker("shared") is not None:  # not a folder of that name, as tests/cli/shared is
            item.add_marker(skip)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The development material beside the checkout; a test that uses it carries the marker `shared`."""
    return SHARED


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
