"""A drive, read as a whole: the log of one chair and the person at its joystick."""

from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import Final

from wcsim.core.reading import escape
from wcsim.errors import JournalError
from wcsim.log.reader import scan_small_log
from wcsim.log.records import DriveHeader, DriveTick, Ended, Header, Input, Note, Ticked
from wcsim.log.writer import MOST_RECORDS

# Earlier versions in which a stick moves a chair as in this one.
_SAME_MOTION: Final = ("0.1.0",)


def read_wcsim_version() -> str:
    """The version that a header names."""
    return version("wcsim")


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveRecording:
    """A whole recording; see `read_drive`."""

    name: str  # of the file
    header: Header
    records: tuple[Input | Note, ...]
    has_truncated_end: bool  # something that is no whole record followed the last one

    @property
    def about(self) -> DriveHeader:
        """The driver, as in the header. Raises JournalError for the header of another log."""
        if self.header.drive is None:
            raise JournalError(f"{escape(self.name)}: is not a drive; record it again")
        return self.header.drive

    @property
    def moves_as_here(self) -> bool:
        """Whether a stick moved the chair, in the version that recorded it, as in this one."""
        return self.about.wcsim in (read_wcsim_version(), *_SAME_MOTION)

    @cached_property
    def ticks(self) -> tuple[DriveTick, ...]:
        """Its ticks."""
        return tuple(record for record in self.records if isinstance(record, DriveTick))

    @cached_property
    def events(self) -> tuple[Note, ...]:
        """What happened beside the ticks."""
        return tuple(record for record in self.records if isinstance(record, Note))

    @cached_property
    def episodes(self) -> tuple[tuple[DriveTick, ...], ...]:
        """The ticks of each episode, in order."""
        return tuple(tuple(part) for _, part in groupby(self.ticks, key=lambda tick: tick.episode))

    @property
    def by_driver(self) -> tuple[DriveTick, ...]:
        """The ticks of its driver: the simulated user beside a person may have driven at times."""
        return tuple(tick for tick in self.ticks if self.about.profile or tick.by_person)

    @property
    def knows_intents(self) -> bool:
        """Whether the intent of the person is known of every tick."""
        return bool(self.ticks) and all(tick.intent is not None for tick in self.ticks)


def read_drive(path: Path) -> DriveRecording:
    """Read a recording; a truncated last record is left out.

    Raises:
        JournalError: The file is no drive, of another version or damaged, or its values cannot be.
    """
    scan = scan_small_log(path, "drive")
    records: list[Input | Note] = []
    before: DriveTick | None = None
    for record in scan.records():
        if isinstance(record, Ticked | Ended) or not isinstance(record, Input | Note):
            raise JournalError(
                f"{escape(path)}: has a record that belongs in no drive; record it again"
            )
        if isinstance(record, DriveTick):
            if before is not None and not (
                record.tick == before.tick + 1
                and record.time_s > before.time_s
                and record.episode >= before.episode
            ):
                raise JournalError(
                    f"{escape(path)}: tick {record.tick} does not follow tick {before.tick}; "
                    "record it again"
                )
            before = record
        records.append(record)
        if len(records) > MOST_RECORDS:
            raise JournalError(
                f"{escape(path)}: more than {MOST_RECORDS} records; expected a drive of a day at "
                "most"
            )
    return DriveRecording(
        name=str(path),
        header=scan.header,
        records=tuple(records),
        has_truncated_end=scan.truncated_bytes > 0,
    )
