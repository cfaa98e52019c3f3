"""The cures that a check prints, typed as they stand."""

import re
import shlex
from pathlib import Path

from tests.cli.conftest import QUICK, Run, parsed
from tests.support.typed import printed, typed
from tests.towns.made.strangers import made
from tests.towns.made.unpaved import BEGIN_S, write_unpaved
from wcsim.towns.scenario.town import find_town, open_town


def test_a_scenario_without_pavements_is_cured_by_what_is_printed(wcsim: Run, folder: Path) -> None:
    theirs = write_unpaved(folder / "my town")
    checked = wcsim("town", "check", theirs)
    assert checked.code == 1
    words = shlex.split(printed(checked.out, "no walking areas"))
    refused = wcsim("town", "run", theirs, "--seconds", "1", *QUICK)
    assert refused.code == 2 and shlex.join(words) in " ".join(refused.err.split())
    assert words[:3] == ["wcsim", "town", "pave"]
    paved = wcsim(*words[1:], "--json", "paved.json")
    assert paved.code == 0 and "note: the demand has no pedestrians" in paved.out, paved.err
    assert "24 streets got a pavement; " in paved.out and "10 signal programs" in paved.out
    later = printed(paved.out, "create walkers")
    written = parsed("paved.json")
    assert written["walkable_largest_share"] > 0.95 and written["paved"]["streets"] == 24
    ours = find_town(written["paved"]["sumocfg"])
    (note,) = [note for note in written["notes"] if "no pedestrians" in note]
    assert shlex.split(later) == shlex.split(printed(note, "no pedestrians")), "it was for the copy"
    code, message = typed(printed(note, "no pedestrians"), folder)
    assert code == 0, message
    text = (ours.folder / "walkers.rou.xml").read_text()
    departs_s = [float(found) for found in re.findall(r'<person id="[^"]*" depart="([^"]*)"', text)]
    assert len(departs_s) > 100 and min(departs_s) >= BEGIN_S and max(departs_s) <= BEGIN_S + 600.0
    cfg = ours.sumocfg.read_text()
    ours.sumocfg.write_text(cfg.replace('"u.rou.xml"', '"u.rou.xml,walkers.rou.xml"'))
    assert wcsim("town", "check", ours.sumocfg).code == 0
    ran = wcsim("town", "run", ours.sumocfg, "--seconds", "5", "--out", "run", *QUICK)
    assert ran.code == 0, ran.err


def test_a_scenario_with_pavements_alone_is_told_what_it_has_and_what_was_added(wcsim: Run, folder: Path) -> None:
    theirs = open_town(made(folder / "own", ("--grid", "--grid.number", "3", "--sidewalks.guess"), persons=False))
    checked = wcsim("town", "check", theirs.sumocfg)
    assert checked.code == 1
    assert "has pavements beside 24 streets, but no walking areas to join them, so pedestrians" in checked.out
    assert "; add crossings and walking areas: wcsim town pave /" in checked.out
    paved = wcsim("town", "pave", theirs.sumocfg, "--out", "ours", "--json", "paved.json")
    written = parsed("paved.json")
    added = f"added {written['crossings']} crossings and {written['walkingareas']} walking areas"
    assert f"24 streets already had one; {added}" in paved.out and "got a pavement" not in paved.out
    assert written["crossings"] > 0 and written["walkingareas"] > 0 and written["paved"]["had"] == 24


def test_a_paved_copy_is_checked_where_its_files_lie_apart(wcsim: Run, folder: Path) -> None:
    theirs = write_unpaved(folder / "theirs" / "runs")
    (folder / "theirs" / "net").mkdir()
    (theirs.parent / "u.net.xml").rename(folder / "theirs" / "net" / "u.net.xml")
    theirs.write_text(theirs.read_text().replace('"u.net.xml"', '"../net/u.net.xml"'))
    result = wcsim("town", "pave", theirs, "--allow-outside", "--out", "trusted copy")
    assert result.code == 0 and "walkable area" in result.out, result.err
    assert "sumo-gui -c 'trusted copy/runs/u.sumocfg'\n" in result.out
    (folder / "theirs" / "town.toml").write_text('name = "apart"\nsplit = "test"\nsumocfg = "runs/u.sumocfg"\n')
    result = wcsim("town", "pave", folder / "theirs", "--out", "declared")
    assert result.code == 0 and "town apart" in result.out, result.err
    assert open_town(folder / "declared").net == folder / "declared" / "runs" / "../net/u.net.xml"


def test_the_place_of_a_town_toml_above_the_scenario_is_kept(wcsim: Run, folder: Path) -> None:
    theirs = write_unpaved(folder / "theirs" / "runs")
    (folder / "theirs" / "town.toml").write_text('name = "above"\nsplit = "test"\nsumocfg = "runs/u.sumocfg"\n')
    result = wcsim("town", "pave", folder / "theirs", "--out", "ours")
    assert result.code == 0, result.err
    assert open_town(folder / "ours").sumocfg.relative_to(folder / "ours") == theirs.relative_to(folder / "theirs")


def test_paving_refuses_what_it_would_spoil(wcsim: Run, folder: Path) -> None:
    theirs = write_unpaved(folder / "theirs")
    (folder / "full").mkdir()
    (folder / "full" / "x").write_text("x")
    result = wcsim("town", "pave", theirs, "--out", "full")
    assert result.code == 2 and "full already exists" in result.err
    assert wcsim("town", "pave", theirs).code == 2
    assert wcsim("town", "pave", theirs, "--out", "ours", "--max-speed", "5").code == 2
    assert not (folder / "ours").exists()
