"""The scripts: what they say of themselves, what they refuse, and what they give."""

import re
from pathlib import Path

import pytest

from benchmarks.__main__ import PROGRAM, SCRIPTS, main
from tests.cli import conftest as cli
from tests.cli.conftest import files_in
from tests.cli.test_bad_input import joined, refused
from tests.cli.test_commands import fits, read, well

folder = cli.folder


@pytest.fixture
def measure(folder: Path, capfd: pytest.CaptureFixture[str]) -> cli.Run:
    """Run `python -m benchmarks WORDS` in this process."""
    return cli.runner(main, capfd)


def test_help_lists_exactly_the_scripts_that_exist(measure):
    told = measure("--help")
    assert re.findall(r"^  (\w+) +\w", told.out, flags=re.MULTILINE) == list(SCRIPTS)
    assert measure().out == told.out


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_script_explains_itself_and_takes_seed_town_and_file(measure, name):
    told = measure(name, "--help")
    assert (told.code, told.err) == (0, "")
    out = re.sub(r"[\s│]+", " ", told.out)
    assert f"usage: {PROGRAM} {name}" in out and "--json FILE" in out
    assert ("--seed INT" in out) == ("name, its folder, or a .sumocfg file" in out) == (name != "barrier")


OPTIONS = {
    "press": ("'press'", "tick, camera"),
    "tick --chairs two": ("'two'", "whole numbers"),
    "barrier --clients 0": ("--clients 0", "1 to 32"),
    "users --profiles drunk": ("'drunk'", "competent, slow, tremor"),
    "users --seconds 5": ("--seconds 5.0", "20.0"),
    "soak --kills 0": ("--kills: only learners use this", "--networks A,B"),
    "soak --steps 50 --slow 4 --twice --set learn.gamma=0.9": ("--steps, --slow, --twice, --set: only learners",),
    "soak --networks patch,fig6 --clients 3": ("--clients 3", "--networks"),
    "soak --networks patch,fig6 --twice --kills 2": ("--kills: --twice compares two runs without faults",),
    "tick --town atlantis": ("unknown town 'atlantis'", "helsinki, karhula, manhattan, monaco"),
}


@pytest.mark.parametrize("words", OPTIONS, ids=joined)
def test_wrong_options_are_refused_at_once(measure, folder, words):
    refused(measure(*words.split()), *OPTIONS[words])
    assert files_in(folder) == set()


def test_tick_gives_rate_and_shares(measure, corner):
    half_ticks = ("--set", "world.tick_s=0.05")
    told = measure("tick", "--town", corner, "--ticks", "20", "--chairs", "2", "--json", "b", *half_ticks)
    assert (told.code, told.err.strip()) == (0, "")
    assert fits(told.out)
    result = read("b")
    assert set(result) == {"physics_hz", "2", "rss_mb"}
    row = result["2"]
    assert result["physics_hz"] == 240 and row["ticks_per_s"] > 0.0
    assert row["ratio_vs_naive"] > 1.0
    blind = measure("tick", "--town", corner, "--ticks", "20", "--chairs", "2", "--no-naive-camera", "--json", "c")
    assert 0.0 < read("c")["2"]["ratio_vs_naive"] < row["ratio_vs_naive"], blind
    assert {"sumo", "physics", "render"} <= set(row["share"])
    assert sum(row["share"].values()) == pytest.approx(1.0, abs=0.02)


def test_camera_gives_the_ratio(measure, corner):
    words = ("--towns", corner, "--poses", "1", "--rounds", "1", "--actors", "5", "--json", "c.json")
    told = measure("camera", *words)
    well(told)
    result = read("c.json")
    assert set(result) >= {"ms_median", "ratio_vs_tiny", "embree", "tiny", "rgb_extra_ms"}
    assert result["ratio_vs_tiny"] > 5.0
    assert 0.0 < result["ms_median"] < 100.0
    for reference in (result["tiny"], result["embree"]):
        assert min(reference["class"], reference["depth"]) > 0.99
    assert len(result["towns"]) == 1


def test_rolling_compares_chairs_with_what_they_would_do_without_the_engine(measure, corner):
    told = measure("rolling", "--towns", corner, "--plants", "rwd", "--chairs", "2", "--km", "0.01", "--json", "b")
    assert told.code == 0, told.err
    (row,) = cli.parsed("b")["rows"]
    assert row["km"] >= 0.01 and row["share"] > 0.2 and row["missed"] == 0
    assert max(row["rms"][:2]) < 2.0 and row["of"][0] == "ahead_mm"
    refused(measure("rolling", "--km", "0"), "--km 0", "0.001")
