"""Where the command line writes: results to stdout, what goes on meanwhile and what went wrong to stderr."""

from __future__ import annotations

import sys

from rich.console import Console


def stdout_console() -> Console:
    """The console of results: names are printed as they are, with no colours for numbers and no emoji for `:car:`."""
    return Console(highlight=False, emoji=False)


def stderr_console() -> Console:
    """The console of notes, bars and errors, so that a pipe receives results alone."""
    return Console(stderr=True, highlight=False, emoji=False)


def say(told: str) -> None:
    """A note on what goes on meanwhile."""
    stderr_console().print(told, style="dim", markup=False, soft_wrap=True)


def warn(told: str) -> None:
    """What went otherwise than it was meant to, and ends nothing."""
    print(f"wcsim: {told}", file=sys.stderr, flush=True)
