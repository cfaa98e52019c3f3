"""`wcsim town make`: a town from a seed, made again by the command that its folder holds."""

import shlex
from pathlib import Path

import pytest

from tests.cli.conftest import Run, files_in, parsed
from wcsim.towns.scenario.town import find_town

SMALL = ("--size", "300", "--kind", "grid", "--hill", "5", "--parked", "1", "--traffic", "0.5")


pytestmark = pytest.mark.usefixtures("own_cache")


def test_a_town_is_made_checked_found_by_name_and_made_again_by_its_own_command(
    wcsim: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = wcsim("town", "make", "mine", "--seed", "9", *SMALL, "--split", "test", "--json", "made.json")
    assert made.code == 0, made.err
    written = parsed("made.json")
    assert written["faults"] == [] and written["crossings"] > 5
    assert "drawing the streets" in made.err
    place = folder / "scenarios" / "sumo" / "mine"
    town = find_town("mine")
    assert (town.folder, town.name, town.split) == (place, "mine", "test")
    before = {path.name: path.read_bytes() for path in place.iterdir()}
    monkeypatch.chdir(place)
    again = wcsim(*shlex.split(town.file.rebuild)[1:])
    assert again.code == 0, again.err
    assert {path.name: path.read_bytes() for path in place.iterdir()} == before


@pytest.mark.proof
def test_a_town_that_somebody_changed_is_left_as_it_is(wcsim: Run, folder: Path) -> None:
    assert wcsim("town", "make", "mine", "--seed", "9", *SMALL).code == 0
    config = folder / "scenarios" / "sumo" / "mine" / "mine.sumocfg"
    config.write_text(config.read_text().replace('"300"', '"60"'))
    before = files_in(folder)
    refused = wcsim("town", "make", "mine", "--seed", "10", *SMALL)
    assert refused.code == 2 and "mine.sumocfg" in refused.err and "--replace" in refused.err
    assert files_in(folder) == before and '"60"' in config.read_text()
    assert wcsim("town", "make", "mine", "--seed", "10", *SMALL, "--replace").code == 0
    assert '"60"' not in config.read_text()
