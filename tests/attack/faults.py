"""Faults of whole runs: full disks, storms of SIGTERM, flipped bits. Afterwards wcsim resume works, or says why."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from tests.attack.files.damage import flipped
from tests.attack.scenarios.twists import draws, pick
from tests.support.tracked import ROOT
from wcsim.agents.clients.group_run import open_group_run_folder
from wcsim.agents.clients.paid_times import GroupRunTimes
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.cli.training.clients import _report_of, _TickRate
from wcsim.errors import WcsimError
from wcsim.log.reader import iter_journal_inputs
from wcsim.log.records import Ticked

QUICK = (
    *("--set", "world.warmup_s=0", "--set", "cameras.0.width_px=40", "--set", "cameras.0.height_px=36"),
    *("--set", "learn.batch_size=4", "--set", "learn.learning_starts=8", "--set", "learn.episode_steps=15"),
    *("--set", "learn.checkpoint_every=10", "--set", "learn.phase1_steps=20"),
)
FOREVER = 100_000  # steps
AT_ONCE = (-signal.SIGTERM, ExitCode.TERMINATED, ExitCode.INTERRUPTED)  # before anything was begun


@dataclass(slots=True, kw_only=True)
class Row:
    """What came of one kind of fault."""

    what: str
    codes: Counter[int] = field(default_factory=Counter)
    defects: list[str] = field(default_factory=list)
    begin_s: float = field(default_factory=time.monotonic)
    seconds: float = 0.0

    def end(self) -> None:
        """All of these faults are over."""
        self.seconds = time.monotonic() - self.begin_s

    def note(self, wrong: str, words: str) -> None:
        """A defect, where there is one."""
        if wrong:
            self.defects.append(f"{self.what}: {words}: {wrong}")

    def line(self) -> str:
        """As a row of a table."""
        codes = ", ".join(f"{code}: {count}" for code, count in sorted(self.codes.items()))
        return f"| {self.what} | {sum(self.codes.values())} | {codes} | {len(self.defects)} | {self.seconds:.0f} |"


HEAD = "| fault | runs | exit codes | defects | s |\n| --- | --- | --- | --- | --- |"


def start(folder: Path, *words: object, before: Sequence[str] = ()) -> subprocess.Popen[str]:
    """`wcsim WORDS` as a process of its own."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [*before, sys.executable, "-m", "wcsim", *map(str, words)],
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "100", "PYTHONPATH": path},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def train(folder: Path, corner: Path, steps: int = FOREVER, before: Sequence[str] = ()) -> subprocess.Popen[str]:
    """A run of two clients in `folder/run`, as a process of its own."""
    words = ("train-clients", "patch,patch", "--town", corner, "--steps", steps, "--out", "run", *QUICK)
    return start(folder, *words, before=before)


def ticks_of(run: Path) -> int:
    """Ticks that a world has done, by its journal."""
    with contextlib.suppress(WcsimError):
        return sum(isinstance(record, Ticked) for record in iter_journal_inputs(run / "journal"))
    return 0


def go_on(child: subprocess.Popen[str], run: Path, ticks: int, limit_s: float = float("inf")) -> None:
    """Let a command go on until its world has done so many ticks more."""
    until, deadline_s = ticks_of(run) + ticks, time.monotonic() + limit_s
    while child.poll() is None and ticks_of(run) < until and time.monotonic() < deadline_s:
        time.sleep(0.2)


def stopped(child: subprocess.Popen[str]) -> tuple[int, str]:
    """Ask a command to end, and wait for that."""
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=120.0)
    return child.returncode, err


def begun(folder: Path, corner: Path, steps: int = FOREVER) -> Path:
    """An interrupted run of two clients in `folder/run`."""
    folder.mkdir(parents=True, exist_ok=True)
    child = train(folder, corner, steps)
    go_on(child, folder / "run", 25, 120.0)
    code, err = stopped(child)
    assert code == ExitCode.STOPPED, err
    return folder / "run"


def wrong_with(run: Path, code: int, err: str, allowed: Sequence[int]) -> str:
    """What is not as it should be after a command has ended, "" when all is."""
    if "Traceback" in err:
        return f"a traceback: {err[-1500:]}"
    if code not in allowed:
        return f"exit code {code}, expected one of {sorted(allowed)}: {err[-500:]}"
    if (
        code == ExitCode.REFUSED
        and not 1 <= len([line for line in err.splitlines() if line.startswith("wcsim: ")]) <= 4
    ):
        return f"not a line: {err[-500:]}"
    return "" if code == ExitCode.REFUSED else audited(run)


def note_end(
    row: Row, run: Path, child: subprocess.Popen[str], allowed: Sequence[int], what: str, limit_s: float = 120.0
) -> None:
    """Count how a command ends, and note what is not as it should be."""
    _, err = child.communicate(timeout=limit_s)
    row.codes[child.returncode] += 1
    row.note(wrong_with(run, child.returncode, err, allowed), what)


def audited(run: Path) -> str:
    """What journal and ledgers tell, "" when every step was seen once."""
    if not (run / "manifest.json").is_file():
        return f"{run} is gone"
    try:
        report = _report_of(open_group_run_folder(run), 0, _TickRate(), GroupRunTimes(clients={}, waited_s={}))
    except WcsimError as error:
        return str(error)
    bad = [client for client in report["clients"] if client["missing"] or client["duplicated"]]
    return f"lost or doubled: {bad}" if bad else ""


def storms(folder: Path, corner: Path, count: int, seed: int) -> Row:
    """Three to twenty SIGTERM at any moment, each storm in a command that goes on with the run of the one before."""
    row, run = Row(what="storms of SIGTERM"), begun(folder, corner)
    for number, rng in draws(count, seed):
        child = start(folder, "resume", "run")
        time.sleep(float(rng.uniform(0.05, 9.0)))
        spacing_s = float(pick(rng, (0.0, 0.002, 0.05, 0.3)))
        for _ in range(int(rng.integers(3, 21))):
            if child.poll() is None:
                child.send_signal(signal.SIGTERM)
            time.sleep(spacing_s)
        note_end(row, run, child, (ExitCode.STOPPED, *AT_ONCE), f"storm {number}")
    _went_on(row, folder)
    return row


def full_disks(folder: Path, corner: Path, count: int, seed: int) -> Row:
    """A disk that becomes full some time after the start, and has room again afterwards."""
    row = Row(what="full disks")
    folder.mkdir()
    with _disk(folder) as limit:
        run = begun(folder, corner)
        for number, rng in draws(count, seed):
            before = limit(int(rng.integers(0, 24)))
            child = start(folder, "resume", "run", before=before)
            try:
                _, err = child.communicate(timeout=120)
            except subprocess.TimeoutExpired:
                _, err = stopped(child)
            limit(-1)
            row.codes[child.returncode] += 1
            row.note(wrong_with(run, child.returncode, err, (ExitCode.FAILED,)), f"disk {number}")
        _went_on(row, folder)
    return row


def stops(folder: Path, corner: Path, count: int, seed: int) -> Row:
    """A client or the world that stands still for up to 20 s, as with SIGSTOP, and goes on; nobody loses a tick."""
    row, run = Row(what="SIGSTOP and SIGCONT"), folder / "run"
    folder.mkdir()
    child = train(folder, corner)
    for _, rng in draws(count, seed):
        go_on(child, run, 10)
        chosen = pick(rng, psutil.Process(child.pid).children(recursive=True))
        row.codes[0] += 1
        with contextlib.suppress(psutil.NoSuchProcess):
            chosen.suspend()
            time.sleep(float(pick(rng, (0.3, 3.0, 20.0))))
            chosen.resume()
    go_on(child, run, 10)
    row.note(wrong_with(run, *stopped(child), (ExitCode.STOPPED,)), f"after {count} stops")
    row.end()
    return row


def flips(folder: Path, corner: Path, count: int, seed: int) -> Row:
    """A bit of any file of a run folder; each in a copy of the same run, of which little is left to do."""
    row, run = Row(what="flipped bits"), begun(folder, corner, steps=40)
    shutil.copytree(run, folder / "sound")
    names = sorted(str(path.relative_to(run)) for path in run.rglob("*") if path.is_file() and path.stat().st_size)
    for number, rng in draws(count, seed):
        shutil.rmtree(run)
        shutil.copytree(folder / "sound", run)
        name = names[(number * 7) % len(names)]
        (run / name).write_bytes(flipped((run / name).read_bytes(), rng))
        child = start(folder, "resume", "run")
        note_end(row, run, child, (ExitCode.DONE, ExitCode.REFUSED), f"flip {number} in {name}", limit_s=200.0)
    row.end()
    return row


def flips_when_done(
    folder: Path, corner: Path, each: int, seed: int, wcsim: Callable[[list[str]], tuple[int, str]]
) -> Row:
    """So many bits of each file that is read when a finished run is asked for again, by `wcsim` in this process."""
    row = Row(what="flipped bits, finished run")
    folder.mkdir()
    _, err = train(folder, corner, 30).communicate(timeout=200)
    run = folder / "run"
    assert not audited(run), err
    files = [path for path in run.rglob("*") if path.is_file() and path.stat().st_size]
    names = [path for path in files if "checkpoints" not in path.parts and "policies" not in path.parts]
    for path in sorted(names):
        whole = path.read_bytes()
        for number, rng in draws(each, seed):
            path.write_bytes(flipped(whole, rng))
            code, err = wcsim(["resume", str(run)])
            row.codes[code] += 1
            found = wrong_with(run, code, err, (ExitCode.DONE, ExitCode.REFUSED))
            row.note(found, f"{path.relative_to(run)}, {number}")
            path.write_bytes(whole)
        for kept in (*run.glob("journal.torn*"), *run.glob("ledgers/*.torn*")):
            kept.unlink()
    row.end()
    return row


def _went_on(row: Row, folder: Path) -> None:
    """After all faults the run goes on, and can be stopped."""
    child, run = start(folder, "resume", "run"), folder / "run"
    go_on(child, run, 15, 120.0)
    row.note(wrong_with(run, *stopped(child), (ExitCode.STOPPED,)), "after the last one")
    row.end()


@contextlib.contextmanager
def _disk(folder: Path) -> Iterator[Callable[[int], Sequence[str]]]:
    """A disk of its own where that is allowed; its limit is set to so many kB more than it holds, -1 for enough.

    Elsewhere the limit is one of the size of each file, by the words before the command that are returned.
    """
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=512m", "none", str(folder)], check=False, capture_output=True
    )
    if mounted.returncode:
        yield lambda room_kb: () if room_kb < 0 else ("bash", "-c", f'ulimit -f {20 + room_kb}; exec "$@"', "-")
        return

    def limit(room_kb: int) -> Sequence[str]:
        used_kb = (shutil.disk_usage(folder).used >> 10) + room_kb
        size = "512m" if room_kb < 0 else f"{used_kb}k"
        subprocess.run(["mount", "-o", f"remount,size={size}", str(folder)], check=True, capture_output=True)
        return ()

    try:
        yield limit
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True, capture_output=True)
