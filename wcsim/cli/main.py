"""The `wcsim` command: finds the subcommand's file, loads only that, and turns expected errors into two lines."""

from __future__ import annotations

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

from wcsim.cli.shared.exit_codes import Exit, exit_of
from wcsim.core.reading import escaped, has_surrogates
from wcsim.errors import ConfigError, WcsimError, meant

_PATHS: Final = frozenset(
    {
        *(errno.ENOENT, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EISDIR),
        *(errno.EEXIST, errno.ENAMETOOLONG, errno.ELOOP, errno.ENXIO, errno.ENODEV, errno.ESTALE),
    }
)
_NOTHING: Final = Path(os.devnull)
_LEAST_COLUMNS: Final = 40
_TRAINS: Final = ("torch", "stable_baselines3", "onnx")
_PACKAGE: Final = Path(__file__).parents[1]


def _require_streams() -> None:
    """Put the empty device in the place of a stream that is closed, else the next file that is opened would be it.

    A terminal of a few columns counts as one of 40: in less the help is laid out for minutes.

    Raises:
        ConfigError: Standard output is closed.
    """
    if shutil.get_terminal_size().columns < _LEAST_COLUMNS:
        os.environ["COLUMNS"] = str(_LEAST_COLUMNS)
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(_NOTHING, os.O_RDWR)  # the lowest number that is free
    sys.stdin = sys.stdin or _NOTHING.open(encoding="utf-8")
    sys.stderr = sys.stderr or _NOTHING.open("w", encoding="utf-8")
    if sys.stdout is None:
        sys.stdout = _NOTHING.open("w", encoding="utf-8")
        raise ConfigError("standard output is closed; if you do not need it, add: > /dev/null")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal may know few letters


def _told_cause(error: Exception) -> tuple[str, Exit]:
    """What to do about an error whose cause is around the command, and how that ends; "" for a fault of ours."""
    from wcsim.server.protocol.limits import limit_message  # as seldom wanted as this is

    limit = limit_message(error)
    if limit:
        return limit, Exit.FAILED
    if isinstance(error, ModuleNotFoundError) and error.name in _TRAINS:
        needs = f"to train and to load networks this needs {error.name}, which is not installed"
        return f"{needs}: pip install 'wcsim[train]'", Exit.REFUSED
    last = [frame for frame, _ in traceback.walk_tb(error.__traceback__)][-1:]
    variables = [name for name in os.environ if name.startswith("NUMBA_")]
    of_numba = any(frame.f_globals["__name__"].startswith("numba.") for frame in last)
    if isinstance(error, ValueError) and variables and of_numba:
        return (
            f"numba refuses its settings ({escaped(error)}); try again after: unset {' '.join(variables)}",
            Exit.REFUSED,
        )
    told = _told_path(error) if isinstance(error, OSError) and error.errno in _PATHS else ""
    ours = any(
        frame.f_code.co_name == "_execute_child" for frame in last
    )  # of subprocess: a program that we want
    return (told, Exit.REFUSED) if told and not ours else ("", Exit.FAILED)


def _told_path(error: OSError) -> str:
    """What to do about a path that cannot be used; "" for one of the package."""
    try:
        Path.cwd()
    except OSError:
        return "the working folder does not exist any more; change to another one: cd"
    path = error.filename2 or error.filename
    if not isinstance(path, str | bytes) or _PACKAGE in Path(os.fsdecode(path)).parents:
        return ""
    told = f"{escaped(os.fsdecode(path))}: {error.strerror}"
    return f"{told}; choose another path, or make this one usable"


@dataclass(frozen=True, slots=True)
class _Subcommand:
    """One line of the help, and the module that does the work with `run(arguments)`, or with the function it names."""

    name: str
    module: str  # below wcsim.cli
    task: str  # what it is for: the group that it stands in
    says: str


SUBCOMMANDS = (
    _Subcommand(
        "demo", "training.demo", "learn", "train a network, and see what its help is worth"
    ),
    _Subcommand("train", "training.train", "learn", "train a danger network, in rounds of driving"),
    _Subcommand("train-q", "training.train:run_q", "learn", "train a network by Q-learning"),
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
    _Subcommand("look", "pictures:look", "look", "make a picture and a video of a town"),
    _Subcommand(
        "snapshot",
        "pictures:snapshot",
        "look",
        "make a picture from a camera: colours, classes, depth",
    ),
    _Subcommand(
        "video", "pictures:video", "look", "make a video from a chair's camera, with a map"
    ),
    _Subcommand(
        "watch",
        "recordings.replay:watch",
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
        "cache", "doctor:cache", "machines", "show the cache of built streets, or clear it"
    ),
    _Subcommand("doctor", "doctor", "machines", "check that all that wcsim needs works here"),
)


FORMER = {  # command and option of version 0.1, and what to type instead
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


class _Terminated(KeyboardInterrupt):
    """Raised when somebody asks the command to end by SIGTERM."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code, see `cli/shared/exit_codes.py`."""
    return guarded(_run_command, arguments)


def guarded(work: Callable[[list[str]], int], arguments: list[str] | None) -> int:
    """Give the words of a command line to `work`, the process's own if there are none; returns the exit code."""
    try:
        with _orderly_end(own_process=arguments is None):
            code = _run(
                work,
                sys.argv[1:] if arguments is None else arguments,
                own_process=arguments is None,
            )
            if arguments is None and code in (Exit.STOPPED, Exit.INTERRUPTED, Exit.TERMINATED):
                _end_undisturbed()
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # whoever read the output, as `head` does, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.BROKEN_PIPE


@contextmanager
def _orderly_end(own_process: bool) -> Iterator[None]:
    """While open, a first SIGTERM ends the command as Ctrl-C does, so that nothing half-done stays behind.

    What is ignored at the end stays so if the process ends with the command.
    """
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    default = before[signal.SIGTERM] is signal.SIG_DFL
    if not default or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        for number, handler in before.items():
            if not own_process or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handler)


def _terminate(_number: int, _frame: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    raise _Terminated


def _run_command(words: list[str]) -> int:
    for said in (f"{' '.join(words[:1])} {word.partition('=')[0]}" for word in (*words[1:], "")):
        if said in FORMER:
            raise ConfigError(
                f"wcsim {said.strip()} is of version 0.1; type instead: {FORMER[said]}"
            )
    chosen = next((item for item in SUBCOMMANDS if words and item.name == words[0]), None)
    if chosen is None:
        return _no_subcommand(words)
    module, _, work = chosen.module.partition(":")
    return int(
        getattr(importlib.import_module(f"wcsim.cli.{module}"), work or "run")(words[1:])
        or Exit.DONE
    )


def _run(work: Callable[[list[str]], int], words: list[str], own_process: bool) -> int:
    try:
        if own_process:
            _require_streams()
        for word in filter(has_surrogates, words):  # no record of ours could name it
            raise ConfigError(
                f"argument '{escaped(word)}' is not valid UTF-8; rename that file, or set LANG=C.UTF-8"
            )
        return work(words)
    except WcsimError as error:
        print(f"wcsim: {_printable(str(error))}", file=sys.stderr)
        return exit_of(error)
    except _Terminated:
        print("wcsim: terminated", file=sys.stderr)
        return Exit.TERMINATED
    except KeyboardInterrupt as stop:
        print(f"wcsim: {str(stop) or 'interrupted'}", file=sys.stderr)
        return Exit.INTERRUPTED
    except BrokenPipeError:
        raise
    except Exception as error:
        told, code = _told_cause(error)
        if not told:
            raise
        print(f"wcsim: {told}", file=sys.stderr)
        return code
    except SystemExit as leave:  # from the parser of options: 0 after --help, 2 after a mistake
        return leave.code if isinstance(leave.code, int) else Exit.REFUSED


def _printable(text: str) -> str:
    """What may hold words of others, without what a terminal obeys; lines stay lines."""
    return "\n".join(escaped(line, len(line) * 10) for line in text.split("\n"))


def _end_undisturbed() -> None:
    """The process ends as it was asked to: a further signal may not change the code that says so."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _no_subcommand(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help", "help"):
        print(_usage())
        return Exit.DONE
    if words[0] in ("-V", "--version"):
        from wcsim import __version__

        print(__version__)
        return Exit.DONE
    names = [item.name for item in SUBCOMMANDS]
    told = (
        f"unknown command {words[0]!r}; expected one of: {', '.join(names)}{meant(words[0], names)}"
    )
    print(f"wcsim: {told}", file=sys.stderr)
    return Exit.REFUSED


def _usage() -> str:
    """The help page, with the commands by task."""
    lines = ["usage: wcsim COMMAND [options]                (details: wcsim COMMAND --help)"]
    for _, group in groupby(SUBCOMMANDS, lambda item: item.task):
        for number, item in enumerate(group):
            lines.append(f"{'' if number else item.task:<10}{item.name:<15}{item.says}")
    ends = "Ends with 0 done, 1 failed, 2 refused: change the command, 3 stopped: resume it,"
    return "\n".join([*lines, ends, "130 or 143 stopped by a signal with nothing to save."])
