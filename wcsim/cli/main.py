"""The `wcsim` command: loads the subcommand it is given, and turns expected errors into a line."""

import errno
import importlib
import io
import os
import shutil
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from types import FrameType
from typing import Final

from wcsim.cli.shared.exit_codes import ExitCode, exit_code_from_error
from wcsim.core.reading import escape, has_surrogates
from wcsim.errors import ConfigError, WcsimError, meant

_PATH_ERRORS: Final = frozenset(
    {
        *(errno.ENOENT, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EISDIR),
        *(errno.EEXIST, errno.ENAMETOOLONG, errno.ELOOP, errno.ENXIO, errno.ENODEV, errno.ESTALE),
    }
)
_NULL_DEVICE: Final = Path(os.devnull)
# In a narrower terminal the help is laid out for minutes.
_LEAST_COLUMNS: Final = 40
_TRAIN_PACKAGES: Final = ("torch", "stable_baselines3", "onnx")
_PACKAGE: Final = Path(__file__).parents[1]
# Command and option of version 0.1, and what to type instead.
_FORMER: Final = {
    "train --network": "wcsim train-q --network NAME",
    "train --reward": "wcsim train-q --reward module:Class",
    "train --resume": "wcsim resume RUN",
    "replay --verify": "wcsim log verify LOG",
    "replay --first-difference": "wcsim log compare LOG LOG",
    "replay --mcap": "wcsim log convert LOG FILE.mcap",
    "replay --fcd": "wcsim log convert LOG FILE.xml",
    "bench chair": "wcsim chair check",
    "bench ": "python -m benchmarks NAME, in a checkout",
}


@dataclass(frozen=True, slots=True)
class _Subcommand:
    """One line of the help, and the module with `run(words)`, or `module:function`."""

    name: str
    module: str  # below wcsim.cli
    task: str  # the group of the help that it belongs to
    summary: str


SUBCOMMANDS: Final = (
    _Subcommand(
        "demo", "training.demo", "learn", "train a network, and see what its help is worth"
    ),
    _Subcommand("train", "training.train", "learn", "train a danger network, in rounds of driving"),
    _Subcommand("train-q", "training.train:run_train_q", "learn", "train a network by Q-learning"),
    _Subcommand(
        "train-clients",
        "training.train_clients",
        "learn",
        "train several networks at once in one world",
    ),
    _Subcommand("resume", "training.resume", "learn", "continue a training"),
    _Subcommand(
        "collect", "training.collect", "learn", "record driving that a network can learn from"
    ),
    _Subcommand(
        "export", "training.export", "learn", "write a policy as an ONNX model, without wcsim"
    ),
    _Subcommand(
        "test", "evaluation.test", "test", "test policies and baselines in towns new to them"
    ),
    _Subcommand(
        "report", "evaluation.report", "test", "make a page of a test or training, with failures"
    ),
    _Subcommand(
        "networks", "networks", "test", "show what networks cost: parameters, memory, time"
    ),
    _Subcommand("chair", "chair", "test", "test wheelchairs on a yard, as ISO 7176 does"),
    _Subcommand("look", "pictures:run_look", "look", "make a picture and a video of a town"),
    _Subcommand(
        "snapshot",
        "pictures:run_snapshot",
        "look",
        "make a picture from a camera: colours, classes, depth",
    ),
    _Subcommand(
        "video", "pictures:run_video", "look", "make a video from a chair's camera, with a map"
    ),
    _Subcommand(
        "watch",
        "recordings.replay:run_watch",
        "look",
        "watch a training of several clients on a web page",
    ),
    _Subcommand("log", "recordings.log", "look", "play, verify, compare or convert a recording"),
    _Subcommand(
        "replay", "recordings.replay", "look", "drive an episode of a test again on a web page"
    ),
    _Subcommand(
        "town", "town.command", "towns", "import, make, list, check or pave a town, or run it"
    ),
    _Subcommand("scene", "scene", "towns", "run short street scenes with a fixed seed"),
    _Subcommand("drive", "drive", "people", "drive a wheelchair yourself in your browser"),
    _Subcommand(
        "users", "recordings.users", "people", "record a simulated user, fit a user to recordings"
    ),
    _Subcommand("serve", "serve", "machines", "run a shared world that clients can join and leave"),
    _Subcommand(
        "join", "training.join", "machines", "train a network in a world started by wcsim serve"
    ),
    _Subcommand(
        "cache", "doctor:run_cache", "machines", "show the cache of built streets, or clear it"
    ),
    _Subcommand("doctor", "doctor", "machines", "check that all that wcsim needs works here"),
)


class _Terminated(KeyboardInterrupt):
    """Raised in the main thread by SIGTERM."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code, see `cli/shared/exit_codes.py`."""
    return run_with_exit_code(_run_command, arguments)


def run_with_exit_code(work: Callable[[list[str]], int], arguments: list[str] | None) -> int:
    """Run `work` on the words of a command line, by default the process's own.

    Returns:
        The exit code; errors that are expected end with a line on standard error.
    """
    own_process = arguments is None
    words = sys.argv[1:] if arguments is None else arguments
    try:
        with _sigterm_interrupts(own_process):
            code = _run(work, words, own_process)
            stopped = code in (ExitCode.STOPPED, ExitCode.INTERRUPTED, ExitCode.TERMINATED)
            if own_process and stopped and _in_main_thread():
                # A further signal may not change the code of a process that ends as requested.
                for number in (signal.SIGINT, signal.SIGTERM):
                    signal.signal(number, signal.SIG_IGN)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # The reader of the output, such as `head`, has closed it: nothing may be flushed at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.BROKEN_PIPE


@contextmanager
def _sigterm_interrupts(own_process: bool) -> Iterator[None]:
    """While open, a first SIGTERM ends the command as Ctrl-C does, so that nothing half-done stays.

    Signals that are ignored in the end stay ignored if the process ends with the command.
    """
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    default = before[signal.SIGTERM] is signal.SIG_DFL
    if not default or not _in_main_thread():
        yield
        return
    signal.signal(signal.SIGTERM, _raise_terminated)
    try:
        yield
    finally:
        for number, handler in before.items():
            if not own_process or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handler)


def _raise_terminated(_number: int, _frame: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    raise _Terminated


def _in_main_thread() -> bool:
    """Whether this thread may set signal handlers."""
    return threading.current_thread() is threading.main_thread()


def _run(work: Callable[[list[str]], int], words: list[str], own_process: bool) -> int:
    """Run `work`; the exit code of its result or of the error that it raised."""
    try:
        if own_process:
            _prepare_streams()
        for word in filter(has_surrogates, words):
            # No record of a run could hold it.
            raise ConfigError(
                f"argument '{escape(word)}' is not valid UTF-8; "
                "rename that file, or set LANG=C.UTF-8"
            )
        try:
            return work(words)
        except RuntimeError as error:
            # Python 3.11 wraps what a signal raises while a class is being made.
            if isinstance(error.__cause__, KeyboardInterrupt):
                raise error.__cause__ from None
            raise
    except WcsimError as error:
        print(f"wcsim: {_printable(str(error))}", file=sys.stderr)
        return exit_code_from_error(error)
    except _Terminated:
        print("wcsim: terminated", file=sys.stderr)
        return ExitCode.TERMINATED
    except KeyboardInterrupt as stop:
        print(f"wcsim: {str(stop) or 'interrupted'}", file=sys.stderr)
        return ExitCode.INTERRUPTED
    except BrokenPipeError:
        raise
    except Exception as error:
        message, code = _explain(error)
        if not message:
            raise
        print(f"wcsim: {message}", file=sys.stderr)
        return code
    except SystemExit as leave:
        # From the parser of options: 0 after --help, 2 after a mistake.
        return leave.code if isinstance(leave.code, int) else ExitCode.REFUSED


def _prepare_streams() -> None:
    """Open the null device for each closed standard stream, and widen a narrow terminal.

    Otherwise the next file that is opened would become the closed stream.

    Raises:
        ConfigError: Standard output is closed.
    """
    if shutil.get_terminal_size().columns < _LEAST_COLUMNS:
        os.environ["COLUMNS"] = str(_LEAST_COLUMNS)
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # It gets the lowest free number, which is this one.
            os.open(_NULL_DEVICE, os.O_RDWR)
    sys.stdin = sys.stdin or _NULL_DEVICE.open(encoding="utf-8")
    sys.stderr = sys.stderr or _NULL_DEVICE.open("w", encoding="utf-8")
    if sys.stdout is None:
        sys.stdout = _NULL_DEVICE.open("w", encoding="utf-8")
        raise ConfigError("standard output is closed; if you do not need it, add: > /dev/null")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A terminal may know few characters.
            stream.reconfigure(errors="backslashreplace")


def _run_command(words: list[str]) -> int:
    for option in (*words[1:], ""):
        former = f"{' '.join(words[:1])} {option.partition('=')[0]}"
        if former in _FORMER:
            raise ConfigError(
                f"wcsim {former.strip()} is of version 0.1; type instead: {_FORMER[former]}"
            )
    command = words[0] if words else "--help"
    if command in ("-h", "--help", "help"):
        print(_usage())
        return ExitCode.DONE
    if command in ("-V", "--version"):
        from wcsim import __version__

        print(__version__)
        return ExitCode.DONE
    modules = {item.name: item.module for item in SUBCOMMANDS}
    if command not in modules:
        expected = f"expected one of: {', '.join(modules)}{meant(command, [*modules])}"
        print(f"wcsim: unknown command {command!r}; {expected}", file=sys.stderr)
        return ExitCode.REFUSED
    module, _, function = modules[command].partition(":")
    work = getattr(importlib.import_module(f"wcsim.cli.{module}"), function or "run")
    return int(work(words[1:]) or ExitCode.DONE)


def _usage() -> str:
    """The help page, with the commands by task."""
    lines = ["usage: wcsim COMMAND [options]                (details: wcsim COMMAND --help)"]
    for _, group in groupby(SUBCOMMANDS, lambda item: item.task):
        for number, item in enumerate(group):
            lines.append(f"{'' if number else item.task:<10}{item.name:<15}{item.summary}")
    lines.append("Ends with 0 done, 1 failed, 2 refused: change the command, 3 stopped: resume it,")
    lines.append("130 or 143 stopped by a signal with nothing to save.")
    return "\n".join(lines)


def _printable(text: str) -> str:
    """Text of others without control characters, which a terminal would obey; lines stay lines."""
    return "\n".join(escape(line, len(line) * 10) for line in text.split("\n"))


def _explain(error: Exception) -> tuple[str, ExitCode]:
    """What to do about an error caused outside wcsim, and its code; "" for a fault of wcsim."""
    from wcsim.server.protocol.limits import explain_resource_limit_error  # rarely needed

    limit = explain_resource_limit_error(error)
    if limit:
        return limit, ExitCode.FAILED
    if isinstance(error, ModuleNotFoundError) and error.name in _TRAIN_PACKAGES:
        needs = f"to train and to load networks this needs {error.name}, which is not installed"
        return f"{needs}: pip install 'wcsim[train]'", ExitCode.REFUSED
    last = [frame for frame, _ in traceback.walk_tb(error.__traceback__)][-1:]
    variables = [name for name in os.environ if name.startswith("NUMBA_")]
    in_numba = any(frame.f_globals["__name__"].startswith("numba.") for frame in last)
    if isinstance(error, ValueError) and variables and in_numba:
        refused = f"numba refuses its settings ({escape(error)})"
        return f"{refused}; try again after: unset {' '.join(variables)}", ExitCode.REFUSED
    # A program that wcsim itself starts and that is missing is no path of the user.
    in_subprocess = any(frame.f_code.co_name == "_execute_child" for frame in last)
    if isinstance(error, OSError) and error.errno in _PATH_ERRORS and not in_subprocess:
        message = _explain_path(error)
        if message:
            return message, ExitCode.REFUSED
    return "", ExitCode.FAILED


def _explain_path(error: OSError) -> str:
    """What to do about a path that cannot be used; "" for one of the package."""
    try:
        Path.cwd()
    except OSError:
        return "the working folder does not exist any more; change to another one: cd"
    path = error.filename2 or error.filename
    if not isinstance(path, str | bytes) or _PACKAGE in Path(os.fsdecode(path)).parents:
        return ""
    reason = f"{escape(os.fsdecode(path))}: {error.strerror}"
    return f"{reason}; choose another path, or make this one usable"
