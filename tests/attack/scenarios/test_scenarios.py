"""No scenario writes outside of its run, or makes anything be read that was not looked at."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.attack.outcomes import Outcome, Tally
from tests.attack.scenarios.scenarios import cases, started
from tests.towns.made import hostile
from wcsim.towns.scene_folders.build import build_scene, find_scene
from wcsim.towns.sumo.xml_io import read_bytes

SEED = 11


@pytest.fixture(scope="module")
def streets(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, str]:
    """A net with a crossing, and a lane of it for cars."""
    town = build_scene(find_scene("pedestrian-crossing"), tmp_path_factory.mktemp("streets"))[0]
    return read_bytes(town.net), hostile.lane_of(town)


def attacked(tally: Tally) -> None:
    sys.stdout.write(f"\n{tally.table()}\n")
    assert tally.defects == [], "\n".join(tally.defects[:5])


def test_a_sample_of_scenarios(tmp_path: Path) -> None:
    tally = Tally().run(cases(400, SEED, tmp_path))
    attacked(tally)
    assert tally.counts["scenarios", Outcome.HARMLESS] > 40 and tally.counts["scenarios", Outcome.REFUSED] > 100
    assert not list(tmp_path.iterdir())


def test_a_few_that_sumo_runs(tmp_path: Path, streets: tuple[bytes, str]) -> None:
    tally = Tally().run(started(10, SEED, tmp_path, *streets))
    attacked(tally)
    assert tally.counts["scenarios, SUMO started", Outcome.HARMLESS] >= 2
    assert not list(tmp_path.iterdir())


@pytest.mark.proof
@pytest.mark.timeout(900)
def test_twenty_thousand_scenarios(tmp_path: Path) -> None:
    attacked(Tally().run(cases(20_000, SEED + 1, tmp_path)))


@pytest.mark.proof
@pytest.mark.timeout(900)
def test_five_hundred_that_sumo_runs(tmp_path: Path, streets: tuple[bytes, str]) -> None:
    tally = Tally().run(started(500, SEED + 1, tmp_path, *streets))
    attacked(tally)
    assert tally.counts["scenarios, SUMO started", Outcome.HARMLESS] >= 100
