"""`wcsim log`: a recorded run made again in a process of its own, compared, and written for SUMO's tools."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.test_bad_input import refused
from tests.cli.test_commands import read
from tests.support.framing import chained, read_whole
from tests.support.journals import eventful_run, nudged, rewritten
from wcsim.log.reader import iter_journal_inputs, read_header
from wcsim.log.records import Ticked, header_to_bytes, record_to_bytes
from wcsim.log.records import with_fields as with_fields


@pytest.fixture(scope="module")
def journaled(corner, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "one"
    eventful_run(corner, folder)
    return folder


@pytest.fixture(scope="module")
def changed(journaled, tmp_path_factory) -> Path:
    """The same run with another command in tick 50 of epoch 0."""
    folder = tmp_path_factory.mktemp("runs") / "other"
    records = read_whole(journaled / "journal").records
    at = next(i for i, record in enumerate(records) if isinstance(record, Ticked) and record.tick == 50)
    rewritten(journaled / "journal", folder / "journal", {at: nudged(records[at])})
    return folder


def test_a_run_is_verified_in_a_fresh_process(journaled, tmp_path):
    words = ["log", "verify", str(journaled), "--json", str(tmp_path / "told.json")]
    done = subprocess.run([sys.executable, "-m", "wcsim", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "150 ticks compared, all equal (" in done.stdout
    assert "ticks/s)" in done.stdout
    assert done.stderr == ""
    assert read(tmp_path / "told.json") == {"ticks": 150, "mismatches": 0, "first_mismatch": None}


def test_a_changed_command_is_found_at_its_tick(wcsim, changed):
    result = wcsim("log", "verify", changed, "--epoch", 0, "--from", 11, "--to", 60, "--json", "told.json")
    written = read("told.json")
    assert result.code == 1, result
    assert written["ticks"] == 50
    assert 1 <= written["mismatches"] <= 11
    assert written["first_mismatch"] == {"epoch": 0, "tick": 50}
    assert wcsim("log", "verify", changed / "journal", "--epoch", 0, "--to", 49).code == 0


def test_a_journal_of_other_versions_says_so(wcsim, journaled):
    header = read_header(journaled / "journal")
    records = map(record_to_bytes, iter_journal_inputs(journaled / "journal"))
    Path("journal").write_bytes(chained([header_to_bytes(with_fields(header, fingerprint="numpy-0")), *records]))
    result = wcsim("log", "verify", "journal", "--to", 1, "--epoch", 1)
    assert result.code == 0
    assert "other versions, so results may differ: numpy-0" in result.err


def test_the_first_difference_of_two_runs(wcsim, journaled, changed):
    result = wcsim("log", "compare", journaled, changed, "--json", "told.json")
    assert result.code == 1
    assert result.out.startswith("Ticked (epoch 0, tick 50): seat 0 is commanded (")
    written = read("told.json")
    assert written == {"equal": False, "first_difference": result.out.strip()}
    assert wcsim("log", "compare", journaled, journaled / "journal", "--json", "told.json").code == 0
    assert read("told.json") == {"equal": True, "first_difference": ""}
    trace = journaled / "beside.trace"
    assert wcsim("log", "compare", trace, trace).code == 0


def test_a_run_is_written_from_its_trace_or_else_from_its_journal(wcsim, journaled):
    shutil.copy(journaled / "beside.trace", "trace")
    assert wcsim("log", "convert", "trace", "a.xml").out == "wrote a.xml: 90 time steps\n"
    result = wcsim("log", "convert", journaled, "b.xml", "--json", "told.json")
    assert result.code == 0, result
    assert Path("a.xml").read_bytes() == Path("b.xml").read_bytes()
    assert read("told.json")["steps"] == 90
    assert wcsim("log", "convert", journaled, "c.xml", "--epoch", 1).out == "wrote c.xml: 60 time steps\n"


def test_a_journal_is_written_for_ros_with_all_that_its_chairs_sensed(wcsim, journaled):
    result = wcsim("log", "convert", journaled, "a.mcap", "--epoch", 1, "--json", "told.json")
    assert result.code == 0, result
    counts = read("told.json")["messages"]
    chairs = {topic.split("/")[1] for topic in counts if topic.startswith("/chair_")}
    for chair in chairs:
        ticks = counts[f"/{chair}/odom"]
        assert ticks == counts[f"/{chair}/imu/data"] == counts[f"/{chair}/joy"] == counts[f"/{chair}/joy_command"]
        assert ticks == counts[f"/{chair}/camera/front/depth/image_raw"] == counts[f"/{chair}/camera/front/camera_info"]
    assert len(chairs) > 1 and max(counts[f"/{chair}/odom"] for chair in chairs) == 60
    assert wcsim("log", "convert", journaled / "beside.trace", "b.mcap").code == 0
    assert Path("b.mcap").stat().st_size < Path("a.mcap").stat().st_size


def test_a_drive_is_recorded_made_again_and_written_for_ros(wcsim, corner):
    words = ("users", "record", corner, "--minutes", 0.05, "--seed", 4, "--set", "world.warmup_s=0")
    slow = (*words, "--profile", "slow", "--out", "a.drive")
    assert wcsim(*slow).out.startswith("wrote a.drive: 30 ticks of a slow user in ")
    refused(wcsim(*slow), "--out a.drive exists", "a new file")
    refused(wcsim(*words, "--profile", "recorded:a.drive", "--out", "b.drive"), "is a recording")
    result = wcsim("log", "verify", "a.drive", "--json", "told.json")
    assert (result.code, result.err) == (0, "")
    assert "30 ticks compared, all equal, at most 0 m apart" in result.out
    written = read("told.json")
    assert written == {"ticks": 30, "mismatches": 0, "first_mismatch": None, "farthest_m": 0.0}
    written = wcsim("log", "convert", "a.drive", "a.mcap").out
    assert "151 messages on /joy, /joy_command, /joy_intent, /odom" in written
    refused(wcsim("log", "convert", "a.drive", "a.xml"), "is a drive, which holds no traffic")
    assert wcsim("log", "verify", "a.drive", "--epoch", 0, "--to", 9).out.startswith("a.drive: 9 ticks compared")
    refused(wcsim("log", "verify", "a.drive", "--epoch", 1), "no epoch 1", "[0]")
    assert wcsim("log", "compare", "a.drive", "a.drive").code == 0
    for task in (("play", "a.drive"), ("verify", "a.drive"), ("convert", "a.drive", "b.mcap")):
        refused(wcsim("log", *task, "--hook", "own:Step"), "made with the step hook 'none', got 'own:Step'")
    refused(wcsim("log", "convert", "a.drive", "b.mcap", "--epoch", 1), "no epoch 1")
    assert not Path("b.mcap").exists()


def test_what_cannot_be_replayed_is_refused(wcsim, journaled):
    Path("empty").mkdir()
    Path("notes").write_text("hello")
    shutil.copy(journaled / "beside.trace", "trace")
    before = sorted(Path().iterdir())
    for words, message in (
        (("verify", "empty"), ("empty: has no trace and no journal", "run folder")),
        (("verify", "trace"), ("trace: is not a journal but a trace",)),
        (("play", "notes"), ("notes: is not a log",)),
        (("convert", "notes", "x.mcap"), ("not a log",)),
        (("convert", "notes", "x.xml"), ("not a log",)),
        (("convert", "trace", "x.xml", "--hook", "own:Step"), ("the trace was made with the step hook 'none'",)),
        (("play", "trace", "--hook", "own:Step"), ("the trace was made with the step hook 'none'",)),
        (("compare", "trace", journaled), ("is a trace and", "expected two of a kind")),
        (("verify", journaled, "--epoch", 5), ("no epoch 5", "[0, 1]")),
        (("verify", journaled, "--from", 9, "--to", 5), ("--from 9: expected 0 to 5",)),
        (("convert", journaled, "x.xml", "--epoch", 5), ("no epoch 5", "[0, 1]")),
        (("verify", journaled, "--epoch", 1, "--from", 61), ("no tick in that range",)),
    ):
        refused(wcsim("log", *words), *message)
    assert sorted(Path().iterdir()) == before
