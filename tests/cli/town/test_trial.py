"""A check ends with SUMO itself, which opens the whole scenario."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Run, files_in
from tests.towns.made import hostile
from wcsim.towns.checks.check import check_town
from wcsim.towns.scenario.town import find_town, open_town

LOOP = '<inductionLoop id="loop" lane="nowhere_0" pos="5" period="5" file="loop.xml"/>'


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.parametrize(
    ("options", "more", "culprit", "said"),
    [
        ("", LOOP, "a.add.xml", "nowhere"),
        ("<default.carfollowmodel value='fly'/>", "", "a.sumocfg", "'fly'"),
    ],
)
def test_what_only_sumo_refuses_is_a_fault_in_its_words(wcsim: Run, folder: Path, corner, options, more, culprit, said):
    sound = hostile.scenario(find_town(str(corner)), folder / "sound")
    broken = hostile.scenario(find_town(str(corner)), folder / "broken", options, more)
    assert len(check_town(open_town(broken)).faults) == len(check_town(open_town(sound)).faults)
    before = files_in(folder)
    told = wcsim("town", "check", broken, "--json", "check.json")
    assert told.code == 1
    (fault,) = [fault for fault in json.loads(Path("check.json").read_text())["faults"] if "SUMO cannot run" in fault]
    assert fault in told.out and f"/{culprit}: SUMO cannot run this scenario" in fault
    assert "Error: " in fault and said in fault and fault.endswith(f"sumo -c {broken.resolve()}")
    assert files_in(folder) == before | {"check.json"}
    assert "SUMO cannot run" not in wcsim("town", "check", sound).out


def test_an_import_says_it_too(wcsim: Run, folder: Path, corner) -> None:
    broken = hostile.scenario(find_town(str(corner)), folder / "broken", "", LOOP)
    told = wcsim("town", "import", "--sumocfg", broken, "--name", "mine")
    assert told.code == 0 and "letting SUMO run its first steps" in told.err
    assert "a.add.xml: SUMO cannot run this scenario" in told.out and "nowhere" in told.out
