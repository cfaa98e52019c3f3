"""Exit codes tell done, stopped, refused and failed apart."""

import errno
import signal
import subprocess
import sys
import types
from pathlib import Path

import pytest

from wcsim import errors
from wcsim.cli import main as cli
from wcsim.cli.shared.exit_codes import ExitCode, NothingSavedInterrupt, exit_code_from_error

CODES = {
    errors.InterruptedRunError: ExitCode.STOPPED,
    errors.DiskFullError: ExitCode.FAILED,
    errors.UnwritableError: ExitCode.REFUSED,
    errors.ServerGoneError: ExitCode.FAILED,
    errors.PhysicsError: ExitCode.FAILED,
    errors.ConfigError: ExitCode.REFUSED,
    errors.PolicyError: ExitCode.REFUSED,
    errors.JournalError: ExitCode.REFUSED,
    errors.WorldFullError: ExitCode.REFUSED,
}


@pytest.mark.parametrize("kind", CODES, ids=lambda kind: kind.__name__)
def test_every_error_has_a_code(kind):
    assert exit_code_from_error(kind("x")) == CODES[kind]


@pytest.mark.parametrize(
    "error, code, told",
    [
        (NothingSavedInterrupt("nothing is kept"), ExitCode.INTERRUPTED, "nothing is kept"),
        (KeyboardInterrupt(), ExitCode.INTERRUPTED, "interrupted"),
        (OSError(errno.ENOSPC, "No space left on device"), ExitCode.FAILED, "make room"),
        (OSError(errno.EMFILE, "Too many open files"), ExitCode.FAILED, "ulimit -n 1024"),
        (errors.DiskFullError("x: no room"), ExitCode.FAILED, "no room"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_ends_a_command_is_told_in_a_line(monkeypatch, capsys, error, code, told):
    def fails(words):
        raise error

    monkeypatch.setitem(sys.modules, "wcsim.cli.doctor", types.SimpleNamespace(run=fails))
    assert cli.main(["doctor"]) == code
    err = capsys.readouterr().err
    assert (err.count("\n"), told in err) == (1, True), err


def test_an_interrupt_while_a_class_is_made_is_one(monkeypatch, capsys):
    """Python 3.11 wraps what is raised in `__set_name__`; pydantic has many."""

    class Field:
        def __set_name__(self, owner, name):
            raise KeyboardInterrupt

    work = types.SimpleNamespace(run=lambda words: type("Model", (), {"field": Field()}))
    monkeypatch.setitem(sys.modules, "wcsim.cli.doctor", work)
    assert cli.main(["doctor"]) == ExitCode.INTERRUPTED
    assert capsys.readouterr().err == "wcsim: interrupted\n"


def test_other_errors_of_the_system_stay_what_they_are(monkeypatch):
    def fails(words):
        raise PermissionError(errno.EPERM, "no")

    monkeypatch.setitem(sys.modules, "wcsim.cli.doctor", types.SimpleNamespace(run=fails))
    with pytest.raises(PermissionError):
        cli.main(["doctor"])


STORM = """
import sys, types, time
from wcsim.cli import main as cli
from wcsim.errors import InterruptedRunError
from wcsim.core.processes import StopSignalCounter
def run(words):
    with StopSignalCounter() as signals:
        print("ready", flush=True)
        while signals.count < 3:
            time.sleep(0.01)
        raise InterruptedRunError("stopped")
sys.modules["wcsim.cli.doctor"] = types.SimpleNamespace(run=run)
sys.argv = ["wcsim", "doctor"]
raise SystemExit(cli.main())
"""


def test_the_code_of_a_stopped_run_survives_a_storm_of_signals():
    for _ in range(3):
        command = [sys.executable, "-c", STORM]
        child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[3])
        assert child.stdout.readline() == "ready\n"
        while child.poll() is None:
            child.send_signal(signal.SIGTERM)
        child.communicate(timeout=10)
        assert child.returncode == ExitCode.STOPPED
