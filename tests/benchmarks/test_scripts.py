"""The scripts: what they say of themselves, what they refuse, and what they give."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.__main__ import PROGRAM, SCRIPTS, main
from tests.cli import conftest as cli
from tests.cli.conftest import QUICK, files_in
from tests.cli.test_bad_input import refused
from tests.cli.test_commands import fits, read

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
    "crashes --set env.profile=slow": ("env.profile", "--profile NAME"),
    "tick --chairs two": ("'two'", "whole numbers"),
    "barrier --clients 0": ("--clients 0", "1 to 32"),
    "users --profiles drunk": ("'drunk'", "competent, slow, tremor"),
    "users --seconds 5": ("--seconds 5.0", "20.0"),
    "crashes --policy runs/demo": ("'runs/demo'", "follow, random, zero, stop, dwa, oracle"),
    "crashes --profile drunk": ("'drunk'", "competent, slow, tremor"),
    "crashes --noise loud": ("'loud'", "typical or none"),
    "crashes --delay 11": ("action_delay_ticks", "11"),
    "soak --kills 0": ("--kills: only learners use this", "--networks A,B"),
    "soak --steps 50 --slow 4 --twice --set learn.gamma=0.9": ("--steps, --slow, --twice, --set: only learners",),
    "soak --networks patch,fig6 --clients 3": ("--clients 3", "--networks"),
    "soak --networks patch,fig6 --twice --kills 2": ("--kills: --twice compares two runs without faults",),
    "tick --town atlantis": ("unknown town 'atlantis'", "helsinki, manhattan, monaco"),
}


@pytest.mark.parametrize("words", OPTIONS, ids=lambda words: words.replace(" ", "_"))
def test_wrong_options_are_refused_at_once(measure, folder, words):
    refused(measure(*words.split()), *OPTIONS[words])
    assert files_in(folder) == set()


def test_tick_gives_rate_and_shares(measure, folder, corner):
    told = measure("tick", "--town", corner, "--ticks", "20", "--chairs", "2", "--json", "b")
    assert (told.code, told.err.strip()) == (0, "")
    assert fits(told.out)
    result = read("b")
    assert set(result) == {"physics_hz", "2", "rss_mb"}
    row = result["2"]
    assert row["ticks_per_s"] > 0.0
    assert row["ratio_vs_naive"] > 1.0
    assert {"sumo", "physics", "render"} <= set(row["share"])
    assert sum(row["share"].values()) == pytest.approx(1.0, abs=0.02)


def test_crashes_gives_classes_and_lost_control(measure, folder, corner):
    words = ("--policy", "follow,random", "--steps", "240", "--chairs", "2", "--seed", "3", *QUICK)
    told = measure("crashes", "--town", corner, *words, "--out", "found", "--json", "all.json")
    assert (told.code, told.err.strip()) == (0, "note: made the folder found")
    assert fits("\n".join(line for line in told.out.splitlines() if " seat " not in line))
    assert "kilometres" in told.out and "lost control" in told.out and "240" in told.out
    result = read("all.json")
    assert [(row["policy"], row["steps"]) for row in result] == [("follow", 240), ("random", 240)]
    for row in result:
        assert read(f"found/{row['town']}-{row['policy']}.json") == row
        assert sum(row["classes"].values()) == len(row["crashes"])
        assert row["lost_per_steps"]["8000"] == pytest.approx(len(row["lost"]) * 8000 / 240)
    starts = [[item["start_W_m"] for item in row["episodes"] if item["episode"] == 0] for row in result]
    assert starts[0] == starts[1]


def test_camera_gives_the_ratio(measure, folder, corner):
    words = ("--towns", corner, "--poses", "1", "--rounds", "1", "--actors", "5", "--json", "c.json")
    told = measure("camera", *words)
    assert (told.code, told.err) == (0, "")
    assert fits(told.out)
    result = read("c.json")
    assert set(result) >= {"ms_median", "ratio_vs_tiny", "embree", "tiny", "rgb_extra_ms"}
    assert result["ratio_vs_tiny"] > 5.0
    assert 0.0 < result["ms_median"] < 100.0
    for reference in (result["tiny"], result["embree"]):
        assert min(reference["class"], reference["depth"]) > 0.99
    (town,) = result["towns"].values()
    assert town["six_cameras"]["gain"] > 0.0 and "6 cameras in" in told.out
