"""The `wcsim` command: finds the subcommand's file, loads only that, and turns expected errors into two lines."""

from __future__ import annotations

import importlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from wcsim.cli.shared.exit_codes import Exit, exit_of
from wcsim.cli.shared.told_cause import require_letters, require_streams, told_cause
from wcsim.core.reading import escaped
from wcsim.errors import WcsimError, meant


@dataclass(frozen=True, slots=True)
class Subcommand:
    """One line of the help, and the module (with a `run(arguments)`) that does the work."""

    name: str
    module: str
    says: str


SUBCOMMANDS = (
    Subcommand(
        "demo", "wcsim.cli.training.demo", "train in Helsinki, test in Monaco, print the table, all in one command"
    ),
    Subcommand("train", "wcsim.cli.training.train", "train a network in a town"),
    Subcommand("collect", "wcsim.cli.training.collect", "record driving that a network can learn from"),
    Subcommand("serve", "wcsim.cli.serve", "run a shared world that clients can join and leave"),
    Subcommand("join", "wcsim.cli.training.join", "train a network in a world started by wcsim serve"),
    Subcommand(
        "test", "wcsim.cli.evaluation.test", "test trained networks and baselines in towns that they have not seen"
    ),
    Subcommand(
        "report", "wcsim.cli.evaluation.report", "make a page of a finished test or training, with its failures"
    ),
    Subcommand("export", "wcsim.cli.training.export", "write a trained policy as an ONNX model, to use without wcsim"),
    Subcommand("town", "wcsim.cli.town.command", "import, generate, list or check a town, or run its traffic"),
    Subcommand("scene", "wcsim.cli.scene", "run short street scenes with a fixed seed, or approve their traces"),
    Subcommand("users", "wcsim.cli.recordings.command", "record a simulated user, fit the user model to recordings"),
    Subcommand("replay", "wcsim.cli.recordings.replay", "play, convert, recompute or compare a recorded run"),
    Subcommand("watch", "wcsim.cli.recordings.watch", "watch a training with several clients live on a web page"),
    Subcommand("look", "wcsim.cli.pictures.look", "make a picture and a video of a town, without training"),
    Subcommand(
        "snapshot", "wcsim.cli.pictures.snapshot", "make a picture from a chair's camera: colours, classes, depth"
    ),
    Subcommand("video", "wcsim.cli.pictures.video", "make a video from a chair's camera, with a map"),
    Subcommand("drive", "wcsim.cli.drive", "drive a wheelchair yourself in your browser"),
    Subcommand("networks", "wcsim.cli.networks", "show what each network costs: parameters, memory, time"),
    Subcommand("chair", "wcsim.cli.chair", "test wheelchairs on a yard, in the manner of ISO 7176"),
    Subcommand("cache", "wcsim.cli.cache", "show where built streets are cached, their size, or clear them"),
    Subcommand("doctor", "wcsim.cli.doctor", "check that everything wcsim needs works on this machine"),
)


class Terminated(KeyboardInterrupt):
    """Raised when somebody asks the command to end by SIGTERM."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code, see `cli/shared/exit_codes.py`."""
    return guarded(_run_command, arguments)


def guarded(work: Callable[[list[str]], int], arguments: list[str] | None) -> int:
    """Give the words of a command line to `work`, the process's own if there are none; returns the exit code."""
    try:
        with _orderly_end(own_process=arguments is None):
            code = _run(work, sys.argv[1:] if arguments is None else arguments, own_process=arguments is None)
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
    raise Terminated


def _run_command(words: list[str]) -> int:
    chosen = next((item for item in SUBCOMMANDS if words and item.name == words[0]), None)
    if chosen is None:
        return _no_subcommand(words)
    return int(importlib.import_module(chosen.module).run(words[1:]) or Exit.DONE)


def _run(work: Callable[[list[str]], int], words: list[str], own_process: bool) -> int:
    try:
        if own_process:
            require_streams()
        require_letters(words)
        return work(words)
    except WcsimError as error:
        print(f"wcsim: {printable(str(error))}", file=sys.stderr)
        return exit_of(error)
    except Terminated:
        print("wcsim: terminated", file=sys.stderr)
        return Exit.TERMINATED
    except KeyboardInterrupt as stop:
        print(f"wcsim: {str(stop) or 'interrupted'}", file=sys.stderr)
        return Exit.INTERRUPTED
    except BrokenPipeError:
        raise
    except Exception as error:
        told, code = told_cause(error)
        if not told:
            raise
        print(f"wcsim: {told}", file=sys.stderr)
        return code
    except SystemExit as leave:  # from the parser of options: 0 after --help, 2 after a mistake
        return leave.code if isinstance(leave.code, int) else Exit.REFUSED


def printable(text: str) -> str:
    """What may hold words of others, without what a terminal obeys; lines stay lines."""
    return "\n".join(escaped(line, len(line) * 10) for line in text.split("\n"))


def _end_undisturbed() -> None:
    """The process ends as it was asked to: a further signal may not change the code that says so."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _no_subcommand(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help", "help"):
        print(usage())
        return Exit.DONE
    if words[0] in ("-V", "--version"):
        from wcsim import __version__

        print(__version__)
        return Exit.DONE
    names = [item.name for item in SUBCOMMANDS]
    told = f"unknown command {words[0]!r}; expected one of: {', '.join(names)}{meant(words[0], names)}"
    print(f"wcsim: {told}", file=sys.stderr)
    return Exit.REFUSED


def usage() -> str:
    """The help page."""
    lines = [f"  {item.name:<10}{item.says}" for item in SUBCOMMANDS]
    return "\n".join(
        [
            "usage: wcsim COMMAND [options]      (details: wcsim COMMAND --help)",
            "",
            "Trains networks that help a person drive a power wheelchair through real cities.",
            "",
            *lines,
            "",
            "Exit codes: 0 done, 1 failed on the way, 2 refused: change the command,",
            "3 stopped: --resume goes on, 130 or 143 stopped by a signal, nothing to save.",
        ]
    )
