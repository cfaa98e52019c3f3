"""Faults of whole runs."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.attack import faults
from tests.support.one_process import files_of_at_most
from tests.view.report.results import records_of
from wcsim.agents.evaluation.suite.run import SuiteOrder
from wcsim.agents.opening.list_file import open_suite
from wcsim.agents.policy_api import UNAIDED
from wcsim.cli.evaluation.judged_suite import save_test_result
from wcsim.cli.main import main
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.errors import DiskFullError


def told(*rows: faults.Row) -> None:
    sys.stdout.write("\n".join(["", faults.HEAD, *(row.line() for row in rows), ""]))
    assert [defect for row in rows for defect in row.defects] == []


@pytest.mark.proof
@pytest.mark.parametrize("fault, count", [(faults.storms, 20), (faults.stops, 8), (faults.full_disks, 20)])
def test_storms_of_signals_stops_and_full_disks_cost_nothing(
    tmp_path: Path, corner: Path, fault: Callable[..., faults.Row], count: int
) -> None:
    told(fault(tmp_path / "runs", corner, count, 1))


def test_nothing_waits_by_a_clock_that_may_be_set_back() -> None:
    """Times of day stand in a log, and are held against those of cached files; leases and waits are monotonic."""
    package, names = (
        faults.ROOT / "wcsim",
        re.compile(r"\btime\.time(_ns)?\(|from time import .*\btime\b|datetime\.(utc)?now\("),
    )
    found = {str(file.relative_to(package)) for file in package.rglob("*.py") if names.search(file.read_text("utf-8"))}
    assert found == {"server/launch/event_log.py", "towns/cache/folder.py"}


@pytest.mark.parametrize("room_kb", [0, 4, 8, 12, 16])
def test_a_disk_that_is_full_while_a_test_is_written_leaves_the_earlier_result_whole(
    tmp_path: Path, room_kb: int
) -> None:
    order = SuiteOrder(suite=open_suite("dev2"), out=tmp_path)
    save_test_result(order, "dev2", {UNAIDED: records_of("dwa"), "mine": records_of("dwa")})
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with files_of_at_most(room_kb << 10), pytest.raises(DiskFullError, match="could not be written"):
        save_test_result(order, "dev2", {UNAIDED: records_of("follow") * 9, "mine": records_of("net@0.25") * 9})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.proof
def test_flipped_bits_are_got_over_or_told(tmp_path: Path, corner: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def wcsim(words: list[str]) -> tuple[int, str]:
        code = main(words)
        return code, capsys.readouterr().err

    done = faults.flips_when_done(tmp_path / "done", corner, 20, 1, wcsim)
    told(done, faults.flips(tmp_path / "flips", corner, 20, 1))


@pytest.mark.proof
def test_a_disk_that_is_full_early_costs_nothing(tmp_path: Path, corner: Path) -> None:
    """Before any episode or checkpoint: what the world has done is kept, and gone on with."""
    run = tmp_path / "run"
    child = faults.train(tmp_path, corner, 60, ("bash", "-c", 'ulimit -f 200; exec "$@"', "-"))
    _, err = child.communicate(timeout=120)
    assert faults.wrong_with(run, child.returncode, err, (ExitCode.FAILED,)) == ""
    assert "wcsim resume run" in err
    assert faults.ticks_of(run) > 0
    child = faults.start(tmp_path, "resume", "run")
    _, err = child.communicate(timeout=120)
    assert faults.wrong_with(run, child.returncode, err, (ExitCode.DONE,)) == ""


def test_too_few_open_files_are_told_before_anything_is_begun(tmp_path: Path, corner: Path) -> None:
    words = ("train-clients", "patch,patch", "--town", str(corner), "--out", "run")
    command = ("bash", "-c", 'ulimit -n 24; exec "$@"', "-", sys.executable, "-m", "wcsim", *words)
    environment = {**os.environ, "PYTHONPATH": str(faults.ROOT)}
    child = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (child.returncode, "ulimit -n 1024" in child.stderr) == (ExitCode.REFUSED, True), child.stderr
    assert list(tmp_path.iterdir()) == []
