"""Whole towns without a map: the same bytes again, other ones for another seed, sound, and drivable."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely.errors import GEOSException

from tests.towns.checks.test_faults import FINE
from tests.towns.conftest import bytes_in
from wcsim.bridge.town_run import RecordOrder, record_town
from wcsim.config import resolve
from wcsim.errors import TownError
from wcsim.towns.checks.check import _no_walkers, check_town
from wcsim.towns.ground.relief import steepest_grade
from wcsim.towns.importing import demand
from wcsim.towns.importing.demand import CLASSES
from wcsim.towns.making import maker
from wcsim.towns.making.asked_town import KINDS, Wishes
from wcsim.towns.making.maker import make_town
from wcsim.towns.scenario.town import Town, open_town, own_work, streets_hash
from wcsim.towns.sumo.net import LaneKind, Net, read_net
from wcsim.towns.sumo.xml_io import read_root

SMALL = Wishes(size_m=320.0, kind="grid", hill_m=40.0)
LEVEL = replace(SMALL, hill_m=0.0, traffic=0.0)
ELSEWHERE = """
import sys
from pathlib import Path
from wcsim.towns.importing import demand
from wcsim.towns.making.maker import make_town
from wcsim.towns.making.asked_town import Wishes
demand.TRIAL_S = 20
make_town(Path(sys.argv[1]), 3, Wishes(size_m=320.0, kind="grid", hill_m=40.0), name="small")
"""
SMALL_CAMERAS = ("world.warmup_s=60", "cameras.0.width_px=32", "cameras.0.height_px=24")


@pytest.fixture(autouse=True)
def _short_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demand, "TRIAL_S", 20)


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Town:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demand, "TRIAL_S", 20)
        return make_town(tmp_path_factory.mktemp("towns") / "small", 3, SMALL)


@pytest.fixture(scope="module")
def level(tmp_path_factory: pytest.TempPathFactory) -> Town:
    """The same streets without hills and traffic."""
    return make_town(tmp_path_factory.mktemp("level") / "small", 3, LEVEL)


def test_the_same_seed_gives_the_same_bytes_in_another_process_and_folder(town: Town, tmp_path: Path) -> None:
    there = tmp_path / "elsewhere" / "copy"
    words = [sys.executable, "-c", ELSEWHERE, str(there)]
    subprocess.run(words, check=True, env={**os.environ, "PYTHONHASHSEED": "7"}, cwd=Path(__file__).parents[3])
    assert bytes_in(there) == bytes_in(town.folder)
    assert {path.name for path in there.parent.iterdir()} == {"copy"}
    assert own_work(there) == ()


def test_another_seed_is_another_town(level: Town, tmp_path: Path) -> None:
    towns = [level, make_town(tmp_path / "small", 4, LEVEL)]
    assert len({streets_hash(town) for town in towns}) == 2
    assert len({town.poly.read_bytes() for town in towns if town.poly is not None}) == 2


def test_a_made_town_passes_the_check_of_an_import(town: Town) -> None:
    report = check_town(town)
    assert report.faults == ()
    assert report.notes == ()
    assert report.unroutable == 0
    assert set(CLASSES) - {"tram"} <= set(report.classes)


def test_a_made_town_without_people_is_told_how_to_get_them(level: Town) -> None:
    (note,) = _no_walkers(level, read_net(level.net), replace(FINE, classes=()))
    assert note.startswith("the demand has no pedestrians")
    assert "wcsim town make small" in note and "--traffic 1" in note


@pytest.mark.proof
@pytest.mark.parametrize("kind", KINDS)
def test_small_towns_of_every_kind_can_be_made(kind: str, tmp_path: Path) -> None:
    """Seed 4 makes a grid in which no corner of a junction is left to the pavement."""
    town = make_town(tmp_path / "tiny", 4, Wishes(size_m=300.0, kind=kind, traffic=0.0))
    assert check_town(town).faults == ()


def test_streets_whose_ground_cannot_be_built_are_drawn_anew(
    level: Town, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, real = [], maker.walkable_parts

    def fails_once(net: Net, chair_ways: tuple[str, ...]) -> list[shapely.Polygon]:
        calls.append(net)
        if len(calls) == 1:
            raise GEOSException("side location conflict")
        return real(net, chair_ways)

    monkeypatch.setattr(maker, "walkable_parts", fails_once)
    second = make_town(tmp_path / "small", 3, LEVEL)
    assert len(calls) == 2
    assert streets_hash(second) != streets_hash(level)


def test_streets_have_what_a_city_has(town: Town) -> None:
    net = read_net(town.net, town.file.origin_m)
    pavements_m = {lane.width_m for lane in net.lanes(LaneKind.SIDEWALK)}
    assert max(pavements_m) - min(pavements_m) > 0.8
    heights_m = np.concatenate([lane.z_m for edge in net.edges for lane in edge.lanes])
    assert 3.0 < np.ptp(heights_m) <= 40.1
    assert 0.01 < steepest_grade(net) <= 0.12
    signalled = {name for link in net.connections if link.tls_id for name in (link.start, link.end)}
    crossings = {lane.edge_id for lane in net.lanes(LaneKind.CROSSING)}
    assert crossings & signalled and crossings - signalled
    kinds = {item.get("type", "") for path in town.additional for item in read_root(path)}
    assert {"building.yes", "natural.tree", "highway.street_lamp", "amenity.bench", "highway.bus_stop"} <= kinds
    assert {"kerb.flush", "kerb.lowered"} <= kinds
    tags = {item.tag for path in town.additional for item in read_root(path)}
    assert "busStop" in tags


@pytest.mark.proof
def test_chairs_drive_in_it(town: Town, tmp_path: Path) -> None:
    config = resolve(resolve("quick"), SMALL_CAMERAS)
    order = RecordOrder(seconds=20.0, seed=1, chairs=2, folder=tmp_path / "run")
    order.folder.mkdir()
    facts = record_town(town, config, order, lambda scenario: None)
    assert facts.ticks == 200
    assert facts.vehicles > 0 and facts.persons > 0 and facts.mirrored > 0


def test_what_somebody_did_there_is_not_lost(level: Town, tmp_path: Path) -> None:
    shutil.copytree(level.folder, tmp_path / "small")
    mine = open_town(tmp_path / "small")
    (mine.folder / "notes.txt").write_text("mine")
    with pytest.raises(TownError, match=r"notes\.txt"):
        make_town(mine.folder, 6, SMALL)
    assert bytes_in(mine.folder)["notes.txt"] == b"mine"
    (mine.folder / "notes.txt").unlink()
    toml = mine.folder / "town.toml"
    toml.write_text(toml.read_text().replace("town make", "town import"))
    with pytest.raises(TownError, match="contains an imported town"):
        make_town(mine.folder, 6, SMALL)
    (mine.folder / "notes.txt").write_text("mine")
    make_town(mine.folder, 6, LEVEL, overwrite=True)
    assert "notes.txt" not in bytes_in(mine.folder)


def test_what_cannot_be_made_is_refused_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    (tmp_path / "file").touch()
    cases = [
        ("full", SMALL, "not a town"),
        ("file", SMALL, "is a file"),
        ("x", replace(SMALL, kind="star"), "unknown kind 'star'"),
        ("x", replace(SMALL, split="both"), "unknown split"),
    ]
    for name, wishes, reason in cases:
        with pytest.raises(TownError, match=reason):
            make_town(tmp_path / name, 1, wishes)
    monkeypatch.setattr(maker, "_LEAST_CROSSINGS", 100_000)
    monkeypatch.setattr(maker, "_ATTEMPTS", 2)
    with pytest.raises(TownError, match="2 attempts; use another seed"):
        make_town(tmp_path / "x", 1, SMALL)
    assert {path.name for path in tmp_path.iterdir()} - {"cache"} == {"full", "file"}
    assert (tmp_path / "full" / "thesis.txt").read_text() == "mine"


@pytest.mark.proof
@pytest.mark.parametrize("seed", range(1, 51))
def test_fifty_towns_are_sound(seed: int, tmp_path: Path) -> None:
    report = check_town(make_town(tmp_path / f"t{seed}", seed))
    assert report.faults == ()
    assert report.walkable_largest_share > 0.97
    assert set(CLASSES) - {"tram"} <= set(report.classes)
