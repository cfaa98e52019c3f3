import gzip
import re
import shutil
from pathlib import Path

import pytest

from wcsim.errors import TownError
from wcsim.towns.scenario.town import Town, content_hash, find_town, list_towns, open_town


def test_shipped_towns_are_found_by_name_with_disjoint_splits() -> None:
    towns = {town.name: town for town in list_towns()}
    assert {"helsinki", "monaco", "manhattan"} <= set(towns)
    assert towns["helsinki"].split == "train"
    assert {towns["monaco"].split, towns["manhattan"].split} == {"test"}
    assert len({content_hash(towns[name]) for name in ("helsinki", "monaco", "manhattan")}) == 3


def test_shipped_towns_carry_licence_and_extract(manhattan_town: Town) -> None:
    notice = (manhattan_town.folder / "LICENSE-DATA").read_text()
    assert "(c) OpenStreetMap contributors" in notice and "ODbL" in notice
    assert (manhattan_town.folder / "osm" / "manhattan.osm.xml.gz").is_file()
    assert manhattan_town.file.attribution.startswith("(c) OpenStreetMap contributors")


def test_unknown_town_says_which_are_known() -> None:
    with pytest.raises(TownError, match=r"unknown town 'atlantis'.*helsinki.*manhattan.*monaco"):
        find_town("atlantis")
    with pytest.raises(TownError, match="is empty"):
        find_town("")


def test_a_town_of_the_current_folder_comes_first(
    manhattan_town: Town, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = tmp_path / "scenarios" / "sumo" / "manhattan"
    shutil.copytree(manhattan_town.folder, mine)
    monkeypatch.chdir(tmp_path)
    assert find_town("manhattan").folder == mine


@pytest.mark.parametrize("text", ["", "<sumoConfiguration", "<sumoConfiguration/>", "<!DOCTYPE x><sumoConfiguration/>"])
def test_broken_sumocfg_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "x.sumocfg").write_text(text)
    with pytest.raises(TownError, match="sumocfg"):
        open_town(tmp_path)


@pytest.mark.parametrize("east_m", [4_000, 386_000])
def test_a_short_town_toml_leaves_the_origin_to_a_far_net(corner_town: Town, tmp_path: Path, east_m: int) -> None:
    folder = tmp_path / "far"
    shutil.copytree(corner_town.folder, folder)
    net = folder / corner_town.net.name
    text = gzip.decompress(net.read_bytes())
    net.write_bytes(re.sub(rb'convBoundary="[^"]*"', b'convBoundary="%d,0,%d,100"' % (east_m, east_m + 100), text))
    (folder / "town.toml").write_text('name = "far"\nsplit = "test"\n')
    assert open_town(folder).file.origin_m == ((386_050, 50) if east_m > 10_000 else (0, 0))
    (folder / "town.toml").write_text('name = "far"\nsplit = "test"\norigin_m = [7, 8]\n')
    assert open_town(folder).file.origin_m == (7, 8)


def test_hash_ignores_comments_packing_and_names_but_not_content(corner_town: Town, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(corner_town.folder, folder)
    net = folder / corner_town.net.name
    text = gzip.decompress(net.read_bytes())
    net.write_bytes(gzip.compress(text.replace(b"<net ", b"<!-- generated today -->\n<net ", 1)))
    assert content_hash(open_town(folder)) == content_hash(corner_town)
    net.write_bytes(text.replace(b'speed="11.11"', b'speed="11.12"'))
    assert content_hash(open_town(folder)) != content_hash(corner_town)
