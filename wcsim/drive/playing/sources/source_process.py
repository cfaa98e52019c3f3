"""The process of a source: at the lowest priority it sends its film, and errors as lines."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final, Literal

from wcsim.drive.playing.film_states import FilmLine, Said
from wcsim.errors import WcsimError

LAST: Final = 19  # the lowest priority
_GROUP: Final = Path("/proc/self/autogroup")

SourceKind = Literal["log", "episode", "run"]


def run_at_low_priority() -> None:
    """Give this process the lowest priority: every other one gets the processor first.

    Linux shares the processor among sessions before it looks at priorities. A terminal that only
    watches would get as much as one that trains. So this process gets its own session,
    which comes last.
    """
    with suppress(OSError):  # it leads a session already
        os.setsid()
        _GROUP.write_text(str(LAST), encoding="ascii")
    os.nice(LAST)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmSource:
    """What a film is made of; everything in it can be sent."""

    kind: SourceKind
    path: Path
    epoch: int | None = None
    hook: str = ""  # named by the user
    town: str = ""  # of a trace, where it is not the named one
    policy: str = ""  # of an episode, as the two below
    block: int = -1
    own: tuple[str, ...] = ()
    # Drives an episode again.
    drive: Callable[[FilmSource, Callable[[Said], object]], object] | None = None
    gives_way: bool = False  # to every other process


def run_source(pipe: Connection, source: FilmSource) -> None:
    """Send the film of a source. This is the whole work of its process."""
    if source.gives_way:
        run_at_low_priority()

    with suppress(BrokenPipeError, ConnectionResetError):
        try:
            _film(source, pipe.send, pipe)
        except WcsimError as error:
            pipe.send(FilmLine(kind="bad", told=str(error)))
            pipe.send(FilmLine(kind="end", told="The recording ends here."))


def _film(source: FilmSource, say: Callable[[Said], object], pipe: Connection) -> None:
    """Send a film. Only the simulators of this kind of source are loaded."""
    if source.drive is not None:
        source.drive(source, say)
        return
    from wcsim.drive.playing.sources.replay_source import follow_film, replay_film, state_film
    from wcsim.log.reader import read_header

    if source.kind == "run":
        # Nobody writes into the pipe: `poll` is true only when its other end is closed.
        follow_film(source.path, source.hook, say, pipe.poll)
        return
    if read_header(source.path).kind == "trace":
        film = state_film(source.path, source.epoch, source.town)
    else:
        film = replay_film(source.path, source.epoch, source.hook)
    for said in film:
        say(said)
