"""A drive: the log of one chair and the person at its joystick, as a whole (docs/recordings.md)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Final

from wcsim.core.reading import escaped
from wcsim.errors import JournalError
from wcsim.log.reader import scan_in_memory
from wcsim.log.records import DriveHeader, DriveTick, Header, Note, Ticked
from wcsim.log.writer import MOST_RECORDS

_SAME_MOTION: Final = ("0.1.0",)
"""Earlier versions in which a stick moves a chair as it does in this one."""


def wcsim_version() -> str:
    """The version that a header names."""
    return version("wcsim")


def moves_as_here(made_by: str) -> bool:
    """Whether a stick moved a chair in that version of wcsim as it does in this one."""
    return made_by in (wcsim_version(), *_SAME_MOTION)


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveRecording:
    """A whole recording; see `read_drive`."""

    name: str  # of the file
    header: Header
    ticks: tuple[DriveTick, ...]
    events: tuple[Note, ...]
    torn: bool  # something that is no whole record followed the last one

    @property
    def about(self) -> DriveHeader:
        """Who drove, as the header says. Raises JournalError for the header of another log."""
        if self.header.drive is None:
            raise JournalError(f"{escaped(self.name)}: is not a drive; record it again")
        return self.header.drive

    @cached_property
    def episodes(self) -> tuple[tuple[DriveTick, ...], ...]:
        """The ticks of each episode, in order."""
        found: list[list[DriveTick]] = []
        for tick in self.ticks:
            if not found or found[-1][-1].episode != tick.episode:
                found.append([])
            found[-1].append(tick)
        return tuple(tuple(part) for part in found)

    def tick_of(self, record: Ticked) -> DriveTick:
        """The tick that a replay of this drive has reached."""
        return self.ticks[record.tick - self.ticks[0].tick]

    @property
    def knows_intents(self) -> bool:
        """Whether what the person wanted is known of every tick."""
        return bool(self.ticks) and all(tick.intent is not None for tick in self.ticks)


def read_drive(path: Path) -> DriveRecording:
    """Read a recording; a torn last record is left out.

    Raises:
        JournalError: The file is none, is of another version, what it says cannot be, or there is damage in it.
    """
    scan = scan_in_memory(path, "drive")
    ticks: list[DriveTick] = []
    events: list[Note] = []
    for record in scan.records():
        if isinstance(record, Note):
            events.append(record)
        elif not isinstance(record, DriveTick):
            raise JournalError(f"{escaped(path)}: has a record that belongs in no drive; record it again")
        elif ticks and not _follows(ticks[-1], record):
            raise JournalError(
                f"{escaped(path)}: tick {record.tick} does not follow tick {ticks[-1].tick}; record it again"
            )
        else:
            ticks.append(record)
        if len(ticks) + len(events) > MOST_RECORDS:
            raise JournalError(f"{escaped(path)}: more than {MOST_RECORDS} records; expected a drive of a day at most")
    return DriveRecording(
        name=str(path),
        header=scan.header,
        ticks=tuple(ticks),
        events=tuple(events),
        torn=scan.torn_bytes > 0,
    )


def _follows(before: DriveTick, tick: DriveTick) -> bool:
    return tick.tick == before.tick + 1 and tick.time_s > before.time_s and tick.episode >= before.episode
