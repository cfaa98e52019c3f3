"""What somebody reads who typed something wrong: what it is, what came, what was expected, what to do."""

import io
import re
import shlex
import shutil
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.cli.conftest import QUICK
from tests.cli.test_bad_input import refused
from tests.support.tracked import ROOT
from wcsim.drive.starting import DriveStart, open_place
from wcsim.log.framing import iter_whole_records

SMALL = ("--set", "learn.total_steps=8", "--set", "learn.phase1_steps=4", *QUICK)


def test_a_number_that_is_none_is_named_in_words(wcsim):
    for words, told in (
        ("train-q --steps 10x", "--steps: got '10x', expected a whole number"),
        ("train --seed 1.5", "--seed: got '1.5', expected a whole number"),
        ("train-clients fig6 --lease soon", "--lease: got 'soon', expected a number"),
        ("serve --max-think x", "--max-think: got 'x', expected a number"),
    ):
        result = wcsim(*words.split())
        assert result.code == 2
        assert told in " ".join(result.err.replace("│", " ").split())
        assert "{None}" not in result.err and "instantiated" not in result.err and "literal" not in result.err


@pytest.mark.parametrize("words", ["town run {}", "town check {}", "train --town {}", "test --town {}", "snapshot {}"])
def test_a_scenario_that_is_not_there_is_said_to_be_missing(wcsim, folder, words):
    told = wcsim(*words.format("run.sumocfg").split())
    refused(told, "run.sumocfg: there is no such file", str(folder), "helsinki")
    assert "unknown town" not in told.err
    refused(wcsim(*words.format("some/folder").split()), "some/folder: there is no such folder", "with a .sumocfg")


def test_an_item_that_a_list_has_not_is_named_with_those_it_has(wcsim):
    given = "train --set cameras.3.hfov_deg=90"
    refused(wcsim(*given.split()), "cameras.3: there is no such item, the list cameras has 1", "expected cameras.0;")
    refused(wcsim("train", "--set", "cameras.hfov_deg=90"), "cameras.hfov_deg: there is no such item", "[[cameras]]")
    refused(wcsim("train", "--set", "imu.p_BI_m.3=1"), "imu.p_BI_m: expected a list", "as imu.p_BI_m=[...]")


def test_a_drive_that_cannot_be_kept_is_refused_before_anything_is_loaded(wcsim, folder):
    Path("file").write_text("a file, not a folder")
    told = f"{folder / 'file'} is not a folder that can be written to"
    refused(wcsim("drive", "--record", "file/a.drive"), told, "with --record")
    refused(wcsim("drive", "--record", "file"), "--record file exists; expected the name of a new file")


def first_record(trace: bytes) -> int:
    """How long the first record of a trace is."""
    return next(iter_whole_records(io.BytesIO(trace))).end


def test_a_trace_that_was_cut_off_is_said_to_be(wcsim, corner):
    assert wcsim("town", "run", corner, "--seconds", "1", "--chairs", "0", "--out", "run").code == 0
    whole = Path("run/trace").read_bytes()
    for length, told in ((20, "or was truncated in its first record"), (first_record(whole) + 9, "no complete tick")):
        Path("run/trace").write_bytes(whole[:length])
        refused(wcsim("log", "convert", "run", "x.xml"), "run/trace: ", told, "copy it again, or record it again")
    Path("run/trace").write_bytes(whole)
    refused(wcsim("log", "convert", "run", "x.xml", "--epoch", "3"), "no tick of epoch 3", "--epoch with one of: 0")
    assert not Path("x.xml").exists()


def test_a_run_with_an_own_network_is_tested_filmed_and_driven_by_the_name_of_that(wcsim, corner):
    for name in ("own_network.py", "own_reward.py"):
        shutil.copy(ROOT / "examples" / name, name)
    words = ("--network", "own_network:OwnNet", "--out", "runs/my own", "--town", corner)
    trained = wcsim("train-q", *words, "--reward", "own_reward:Gentle", *SMALL)
    assert trained.code == 0
    hint = trained.out.rstrip().rpartition("test it: ")[2]
    assert hint == "wcsim test 'runs/my own' --network own_network:OwnNet --town monaco"
    typed = shlex.split(hint)[1:-1]
    assert wcsim(*typed, corner, "--allow-train-town", "--only", "--episodes", "1", "--max-steps", "3").code == 0
    unnamed = [word for word in typed if word not in ("--network", "own_network:OwnNet")]
    told = wcsim(*unnamed, corner, "--allow-train-town")
    unnamed_says = "if you trust it, name it: --network own_network:OwnNet"
    refused(told, "runs/my own uses the network 'own_network:OwnNet'", unnamed_says)
    assert "network=own" not in told.err
    for words in (("video", corner, "--out", "own.webm"), ("drive", corner)):
        told = wcsim(*words, "--policy", "runs/my own")
        refused(told, "runs its code; if you trust it, name it: --network own_network:OwnNet")
        told = wcsim(*words, "--policy", "follow", "--network", "own_network:OwnNet")
        refused(told, "--network own_network:OwnNet: follow does not use it; leave it out")
        assert "loading the simulator" not in told.out
    named = ("--policy", "runs/my own", "--network", "own_network:OwnNet", "--seconds", "0.3", "--width", "64")
    assert wcsim("video", corner, *named, "--out", "own.webm").code == 0 and Path("own.webm").stat().st_size
    start = DriveStart(town=str(corner), policy="runs/my own", network="own_network:OwnNet")
    with ExitStack() as held:
        assert open_place(start, held).policy.name == "runs/my own"


def test_a_run_of_wcsims_own_network_needs_no_name(wcsim, corner):
    trained = wcsim("train-q", "--out", "run", "--town", corner, *SMALL, "--set", "learn.episode_steps=3")
    assert trained.out.rstrip().endswith("test it: wcsim test run --town monaco")
    assert "note:" not in trained.err
    (last,) = re.findall("phase 2: 8/8 steps, [1-9] episodes", trained.err)
    again = wcsim("resume", "run")
    assert again.code == 0 and last in again.err
    assert "note: run is finished: all of its 8 steps are done; extend it with --steps N" in again.err
