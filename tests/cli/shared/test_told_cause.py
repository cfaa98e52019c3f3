"""What is wrong around a command is told in a line; a fault of wcsim's own keeps its traceback."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

import wcsim
from wcsim.cli import main as cli
from wcsim.cli.main import _explain
from wcsim.cli.shared.exit_codes import ExitCode


def _run(words: str, folder: Path, **more: str) -> tuple[int, str]:
    done = subprocess.run(
        ["bash", "-c", f'wcsim() {{ "$0" -m wcsim "$@"; }}; {words}', sys.executable],
        cwd=folder,
        env={**os.environ, **more},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    "words, told",
    [
        ("wcsim --help >&-", "standard output is closed"),
        ("mkdir gone && cd gone && rmdir ../gone && wcsim town list", "the working folder does not exist"),
        ("wcsim town run helsinki --out $'r\\xff'", "argument 'r\\udcff' is not valid UTF-8"),
    ],
)
def test_a_command_in_bad_surroundings_ends_with_a_line_and_code_2(tmp_path: Path, words: str, told: str) -> None:
    package = str(Path(wcsim.__file__).parents[1])
    code, err = _run(words, tmp_path, PYTHONPATH=f"{package}:{os.environ.get('PYTHONPATH', package)}")
    assert (code, err.count("\n")) == (ExitCode.REFUSED, 1), err
    assert err.startswith(f"wcsim: {told}")


def test_help_in_a_terminal_of_two_columns_is_laid_out(tmp_path: Path) -> None:
    assert _run("wcsim snapshot --help >/dev/null", tmp_path, COLUMNS="2") == (ExitCode.DONE, "")


def _caught(raised: Exception) -> Exception:
    try:
        raise raised
    except Exception as error:
        return error


@pytest.mark.parametrize(
    "raised, code, told",
    [
        (FileNotFoundError(errno.ENOENT, "No such file", "/proc/x"), ExitCode.REFUSED, "/proc/x: No such file; choose"),
        (OSError(errno.ENAMETOOLONG, "File name too long", 5000 * "y"), ExitCode.REFUSED, "yyy: File name too long"),
        (OSError(errno.ENOSPC, "No space left"), ExitCode.FAILED, "the disk is full"),
        (FileNotFoundError(errno.ENOENT, "No such file", str(Path(wcsim.__file__).parent / "x")), ExitCode.FAILED, ""),
        (OSError(errno.EBADF, "Bad file descriptor"), ExitCode.FAILED, ""),
        (ValueError("ours"), ExitCode.FAILED, ""),
        (ModuleNotFoundError("No module", name="torch"), ExitCode.REFUSED, "pip install 'wcsim[train]'"),
        (ModuleNotFoundError("No module", name="other"), ExitCode.FAILED, ""),
    ],
)
def test_the_cause_decides_what_is_told(raised: Exception, code: ExitCode, told: str) -> None:
    line, ends = _explain(_caught(raised))
    assert ends == code
    assert told in line if told else line == ""


@pytest.mark.parametrize(
    "module, told",
    [("numba.np.ufunc.parallel", "try again after: unset NUMBA_NUM_THREADS"), ("wcsim.core.jit", "")],
)
def test_settings_that_numba_refuses_are_named(monkeypatch: pytest.MonkeyPatch, module: str, told: str) -> None:
    code = compile("raise ValueError('must be > 0')", "/home/numba/wcsim/parallel.py", "exec")
    monkeypatch.setenv("NUMBA_NUM_THREADS", "0")
    with pytest.raises(ValueError, match="must be") as refused:
        exec(code, {"__name__": module})  # noqa: S102
    line = _explain(refused.value)[0]
    assert line.endswith(told) if told else line == ""


def test_a_fault_of_ours_comes_with_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_words: list[str]) -> int:
        raise KeyError("ours")

    monkeypatch.setattr("wcsim.cli.doctor.run_cache", broken)
    with pytest.raises(KeyError):
        cli.main(["cache"])
