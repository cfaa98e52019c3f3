"""A run that goes on as a film: its journal is read as it grows, and its world made again a moment behind.

The run itself does nothing for it and does not know of it. Where the film is slower than the run, it goes over to the
newest epoch as soon as one begins, and says by how much it is behind till then.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Final

from wcsim.bridge.replay.player import LogPlayer
from wcsim.bridge.replay.replayed import worlds_of
from wcsim.bridge.world import World
from wcsim.drive.playing.film_states import FilmLine, FilmNames, Said
from wcsim.drive.playing.sources.replay_source import RecordScene, replay_about
from wcsim.log.reader import LogTail
from wcsim.log.records import Ended, EpochBegun, Header, Input, Ticked
from wcsim.log.writer import JOURNAL
from wcsim.server.host.opening import EPOCH_OVER

SKIPS_TICKS: Final = 100  # a newer epoch is gone over to at once where more ticks than this are left of the old one
_MOST_WAITING: Final = 200_000  # records
_POLL_S: Final = 0.05
_TOLD_S: Final = 0.5
_QUIET_S: Final = 3.0  # without a tick, before something is said of it
_BEHIND: Final = 10  # ticks from which on they are told of
_LAST_BYTES: Final = 4096
_STEP_DIGITS: Final = 15

Gone = Callable[[float], bool]  # waits so many seconds; whether nobody listens any more
Clock = Callable[[], float]


def follow_film(run: Path, hook: str, say: Callable[[Said], object], gone: Gone, clock: Clock = time.monotonic) -> None:
    """Follow a run until nobody listens any more.

    Args:
        run: Its folder.
        hook: The step hook that it was started with, which a journal alone does not load.
        say: Hears the film.
        gone: See `Gone`.
        clock: Monotonic seconds.

    Raises:
        JournalError: The journal is none, or damaged.
        TownError, ConfigError: Its world cannot be made here.
        WcsimError: Its records do not follow from each other.
    """
    with LogTail(run / JOURNAL) as tail:
        first = tail.read()
        while tail.header is None:
            say(FilmLine(kind="now", told="The run has not started yet."))
            if gone(_TOLD_S):
                return
            first = tail.read()
        say(replay_about(tail.header, 0, live=True))
        following = _Following(run, tail.header, hook, say)
        try:
            following.hear(first)
            while following.turn(tail, gone, clock):
                pass
        finally:
            following.close()


class _Following:
    """What has come and was not done again yet, and the world in which it will be."""

    def __init__(self, run: Path, header: Header, hook: str, say: Callable[[Said], object]) -> None:
        self._run, self._say = run, say
        self._player = LogPlayer[World](worlds_of(header, hook), header.seats)
        self._scene = RecordScene()
        self._queue = deque[Input]()
        self._ended = ""
        self._heard_s = self._told_s = self._asked_s = 0.0
        self._told, self._differed = "", False
        self._names, self._named = dict[int, str](), dict[int, str]()

    @property
    def waiting(self) -> int:
        """Records that were not done again yet."""
        return len(self._queue)

    def hear(self, records: list[Input]) -> None:
        """These have come; what an epoch makes needless is left out."""
        self._queue.extend(records)
        begun = [number for number, record in enumerate(self._queue) if isinstance(record, EpochBegun)]
        left = sum(isinstance(record, Ticked) for record in list(self._queue)[: begun[-1]]) if begun else 0
        if left > SKIPS_TICKS:
            for _ in range(begun[-1]):
                self._player.seats.note(self._queue.popleft())
            self._say(FilmLine(kind="mark", told=f"{left} ticks were skipped to reach the newest world."))

    def turn(self, tail: LogTail, gone: Gone, clock: Clock) -> bool:
        """Do the next record again, or wait for one; False when nobody listens any more."""
        now_s = clock()
        if not self._queue or now_s - self._asked_s > _POLL_S:
            self._asked_s = now_s
            while self.waiting < _MOST_WAITING and (records := tail.read()):
                self._heard_s = now_s
                self.hear(records)
        if self._queue:
            self._do(self._queue.popleft())
        if now_s - self._told_s > _TOLD_S:
            self._told_s = now_s
            self._tell(self._status(tail, now_s))
        return not gone(0.0 if self._queue else _POLL_S)

    def close(self) -> None:
        """End the world."""
        self._player.close()

    def _do(self, record: Input) -> None:
        self._ended = record.reason if isinstance(record, Ended) else ""
        world = self._player.play(record)
        for said in self._scene.said(world, record):
            if isinstance(said, FilmNames):
                self._names = dict(said.names)
            self._say(said)
        if self._scene.differs and not self._differed:
            self._differed = True
            self._say(FilmLine(kind="bad", told="The film differs from the run: its version or machine is another."))

    def _status(self, tail: LogTail, now_s: float) -> str:
        """What goes on with the run."""
        behind = sum(isinstance(record, Ticked) for record in self._queue)
        if behind > _BEHIND:
            return f"{behind} ticks behind the run"
        if self._ended.startswith(EPOCH_OVER):
            return "This world has ended; the next one is starting."
        if self._ended:
            return f"The run has ended ({self._ended}). This page continues when the run is resumed."
        quiet_s = now_s - self._heard_s
        if quiet_s < _QUIET_S:
            return "live"
        if tail.is_written() is False:
            return "No process runs this world now: the run was killed, or its world is restarting."
        return f"No tick for {quiet_s:.0f} s: the world waits for a client."

    def _tell(self, told: str) -> None:
        if told != self._told:
            self._told = told
            self._say(FilmLine(kind="now", told=told))
        named = {seat: _with_step(self._run, name) for seat, name in self._names.items()}
        if named != self._named:
            self._named = named
            self._say(FilmNames(names=named))


def _with_step(run: Path, name: str) -> str:
    """A client with the step that its learner was at when its last episode ended, where its folder says it."""
    try:
        with (run / name / "metrics.csv").open("rb") as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - _LAST_BYTES))
            lines = file.read(_LAST_BYTES).split(b"\n")
    except OSError:
        return name
    step = lines[-2].split(b",")[0] if len(lines) > 1 else b""
    return f"{name}, step {int(step)}" if step.isdigit() and len(step) <= _STEP_DIGITS else name
