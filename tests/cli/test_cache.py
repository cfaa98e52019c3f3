"""`wcsim cache`: what is kept is counted, and only that is removed."""

import os
import time
from pathlib import Path

import pytest

from tests.cli.conftest import parsed
from wcsim.agents.runs.transfer import KEY_FILE
from wcsim.core.files import KERNELS
from wcsim.towns.cache.folder import WRITTEN_S
from wcsim.towns.street import load_street

KEY = "0123456789abcdef" * 2
OLD, NEW = (f".street-{KEY}.npz.{number}-0123abcd.tmp" for number in (1, 2))  # begun, and left or not
DRIVEN = ("drive-scenes/car-door-0-0123456789abcdef", "drive-towns/made-7")


@pytest.fixture
def cache(tmp_path, own_cache) -> Path:
    """A cache with two of ours, one that somebody left, one that is being written, and things of others."""
    place = own_cache / "wcsim"
    place.mkdir(parents=True)
    (place / f"street-{KEY}.npz").write_bytes(b"x" * 3_000_000)
    (place / f"net-{KEY}.ok").write_text("ok\n")
    (place / f"warm-{KEY}.xml.gz").write_bytes(b"x" * 5)
    (place / f"rows-{KEY}.json").write_bytes(b"x" * 5)
    for name in (OLD, NEW):
        (place / name).mkdir()
        (place / name / "part").write_text("12345")
    for name in (KEY_FILE, "thesis.tex", "street-mine.npz", f"net-{KEY}.ok.bak"):
        (place / name).write_text("12345")
    code = place / KERNELS / "core_0123"
    code.mkdir(parents=True)
    for name in ("boxes.f-0123.py311.nbi", "boxes.f-0123.py311.1.nbc", "notes.txt"):
        (code / name).write_text("12345")
    past_s = time.time() - 2 * WRITTEN_S
    os.utime(place / OLD, (past_s, past_s))
    (tmp_path / "elsewhere").write_text("irreplaceable")
    (place / f"scenario-{KEY}.ok").symlink_to(tmp_path / "elsewhere")
    (place / f"street-{KEY[::-1]}.npz").mkdir()
    for name in (*DRIVEN, "drive-scenes/my-own", "drive-scenes/.abcdefgh"):
        (place / name / "sumo").mkdir(parents=True)
        (place / name / "sumo" / "net.xml").write_text("12345")
    (place / "drive-towns" / "made-8").symlink_to(tmp_path)
    return place


def test_the_cache_says_where_it_is_and_what_it_holds(wcsim, cache):
    result = wcsim("cache", "--json", "c.json")
    assert (result.code, result.err) == (0, "")
    assert (
        f"{cache}: 1 street, 1 checked net or scenario, 1 state of warmed traffic, 1 block of tests, 1 kernel"
        in result.out
    )
    assert "2 generated places to drive" in result.out
    assert "1 unfinished, 3.0 MB" in result.out
    assert "wcsim cache --clear" in result.out
    assert parsed("c.json") == {
        **{"folder": str(cache), "streets": 1, "verdicts": 1, "rows": 1, "states": 1, "kernels": 1, "driven": 2},
        **{"unfinished": 1, "size_bytes": 3_000_038, "left_bytes": 3_000_038},
    }


def test_clearing_removes_what_is_ours_and_nothing_else(wcsim, cache, tmp_path):
    before = {str(path.relative_to(cache)) for path in cache.rglob("*")}
    result = wcsim("cache", "--clear", "--json", "c.json")
    assert (result.code, result.err, "removed 3.0 MB" in result.out) == (0, "", True)
    gone = before - {str(path.relative_to(cache)) for path in cache.rglob("*")}
    code = {f"{KERNELS}/core_0123/boxes.f-0123.py311.{end}" for end in ("nbi", "1.nbc")}
    driven = {f"{place}{file}" for place in DRIVEN for file in ("", "/sumo", "/sumo/net.xml")}
    assert gone == {
        f"street-{KEY}.npz",
        f"net-{KEY}.ok",
        f"warm-{KEY}.xml.gz",
        f"rows-{KEY}.json",
        OLD,
        f"{OLD}/part",
        *code,
        *driven,
    }
    assert (tmp_path / "elsewhere").read_text() == "irreplaceable"
    assert parsed("c.json")["left_bytes"] == 0
    assert "removed 0.0 MB" in wcsim("cache", "--clear").out


def test_a_cache_that_is_not_there_is_empty(wcsim, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "none"))
    result = wcsim("cache", "--clear")
    assert (result.code, "0 streets" in result.out) == (0, True)
    assert not (tmp_path / "none").exists()


def test_a_street_in_use_outlives_the_clearing(wcsim, corner_town, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "used"))
    street = load_street(corner_town)
    assert wcsim("cache", "--clear").code == 0
    assert not list((tmp_path / "used" / "wcsim").iterdir())
    again = load_street(corner_town)
    assert list((tmp_path / "used" / "wcsim").glob("street-*.npz"))
    for key in again.tiles.keys:
        assert street.tiles.mesh(key).vertices_W_m.tobytes() == again.tiles.mesh(key).vertices_W_m.tobytes()
