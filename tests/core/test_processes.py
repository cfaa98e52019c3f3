"""What becomes of commands, of work in a pool, and of a process whose parent has gone."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from wcsim.core.processes import run_command, run_in_process_pool

CHILD = """
import signal, sys, time
from pathlib import Path
from wcsim.core import processes
def asked(number, frame):
    Path(sys.argv[1], "asked").touch()
signal.signal(signal.SIGUSR1, asked)
processes._PARENT_CHECK_S = processes._ORDERLY_END_S = 0.05
processes.limit_orphan_lifetime(1.0, 9, signal.SIGUSR1)
Path(sys.argv[1], "began").touch()
time.sleep(120.0)
Path(sys.argv[1], "outlived").touch()
"""
PARENT = """
import subprocess, sys, time
from pathlib import Path
subprocess.Popen([sys.executable, "-c", sys.argv[2], sys.argv[1]])
for _ in range(3000):
    if Path(sys.argv[1], "began").exists():
        break
    time.sleep(0.02)
"""


def test_a_process_is_asked_not_to_wait_and_ended_later(tmp_path):
    """Its output is closed when it has ended."""
    words = [sys.executable, "-c", PARENT, str(tmp_path), CHILD]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as parent:
        parent.wait(60.0)
        assert parent.stdout.read() == b""
    assert (tmp_path / "asked").exists() and not (tmp_path / "outlived").exists()


def test_a_command_says_what_it_said_and_how_it_ended():
    words = ["sh", "-c", "echo one; echo two >&2; exit 3"]
    ended = run_command(words, 60.0)
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "one\n", "two\n")
    assert run_command(words, 60.0, together=True).stdout.split() == ["one", "two"]


def test_a_command_that_is_late_or_whose_watcher_fails_is_killed(tmp_path):
    words, pids = ["sleep", "600"], []
    with pytest.raises(subprocess.TimeoutExpired):
        run_command(words, 0.2, on_start=lambda child: pids.append(child.pid))

    def fails(child):
        pids.append(child.pid)
        child.send_signal(signal.SIGSTOP)
        raise KeyError

    with pytest.raises(KeyError):
        run_command(words, 60.0, on_start=fails)
    assert len(pids) == 2 and not any(Path(f"/proc/{pid}").exists() for pid in pids)


def test_a_command_that_is_not_there_is_another_fault_than_a_full_disk(tmp_path):
    with pytest.raises(ChildProcessError, match="No such file"):
        run_command([str(tmp_path / "none")], 60.0)


def test_a_pool_gives_each_piece_its_place_and_passes_on_a_fault():
    assert dict(run_in_process_pool(abs, [-3, 4, -5], 2)) == {0: 3, 1: 4, 2: 5}
    with pytest.raises(TypeError):
        list(run_in_process_pool(abs, [1, "two"], 1))


ORPHANS = """
import os, signal, sys, time
from wcsim.core.processes import run_in_process_pool
if __name__ == "__main__":
    next(run_in_process_pool(abs, [1, 2], 1))
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_processes_of_a_pool_end_with_whoever_started_them(tmp_path):
    """Their output is closed when all of them have ended."""
    (tmp_path / "orphans.py").write_text(ORPHANS)
    with subprocess.Popen([sys.executable, str(tmp_path / "orphans.py")], stdout=subprocess.PIPE) as parent:
        assert parent.communicate(timeout=60.0)[0] == b""


def test_semaphores_of_a_group_that_was_killed_go_with_the_next_pool(tmp_path):
    (tmp_path / "orphans.py").write_text(ORPHANS.replace("os.kill(os.getpid()", "os.killpg(os.getpid()"))
    killed = subprocess.Popen([sys.executable, str(tmp_path / "orphans.py")], start_new_session=True)
    killed.wait(60.0)
    left = [path for path in Path("/dev/shm").glob(f"sem.wcsim-*-{killed.pid}-*")]  # noqa: S108
    assert left, "its tracker was killed, too"
    list(run_in_process_pool(abs, [-1], 1))
    assert not any(path.exists() for path in left)
