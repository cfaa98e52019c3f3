"""Writing a drive: a file that grows tick by tick and is whole after each, whatever ends the process."""

from __future__ import annotations

import os
from io import FileIO
from pathlib import Path

from wcsim.core.closing import Closing
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError, DiskFullError, JournalError, WcsimError
from wcsim.users.recording.drive_bytes import DRIVE_FILE, MOST_RECORDS, event_payload, header_payload, tick_payload
from wcsim.users.recording.drive_types import DriveHeader, RecordedEvent, RecordedTick
from wcsim.users.recording.framing import crc_of, framed


class DriveRecorder(Closing):
    """Appends to a new recording of a drive; a context manager. A killed process leaves all that it had recorded."""

    def __init__(self, path: Path, header: DriveHeader) -> None:
        """Begin a recording.

        Raises:
            ConfigError: The file is there already or cannot be made, or the header holds a number out of its bounds.
            DiskFullError: It could not be written on.
        """
        self._path = path
        first = _first_payload(header, path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW
            self._file = FileIO(os.open(path, flags, 0o644), "w")
        except OSError as error:
            reason = error.strerror or error
            raise ConfigError(f"{escaped(path)}: cannot be created ({reason}); choose the name of a new file") from None
        self._end, self._after, self._records = 0, 0, -1  # records beside the header
        try:
            self._put(first)
        except BaseException:
            self.close()
            path.unlink(missing_ok=True)
            raise

    def record(self, tick: RecordedTick) -> None:
        """Append a tick.

        Raises:
            WcsimError: A number in it is not finite or out of its bounds, or the recorder is closed.
            DiskFullError: It could not be written; the file is what it was before.
        """
        try:
            payload = tick_payload(tick)
        except ValueError:
            raise WcsimError(
                f"{escaped(self._path)}: tick {tick.tick} holds a number that is not finite or out of its bounds; "
                "expected sticks of -1 to 1, and a place in the town"
            ) from None
        self._put(payload)

    def note(self, event: RecordedEvent) -> None:
        """Append an event. Raises as `record` does."""
        self._put(event_payload(event))

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def _put(self, payload: bytes) -> None:
        """One unbuffered write; on a full disk the part that was written is taken back."""
        if self._file.closed:
            raise WcsimError(f"{escaped(self._path)}: this recording is closed; start another one")
        data = framed(payload, self._after)
        if self._records >= MOST_RECORDS or self._end + len(data) > DRIVE_FILE.limit_bytes:
            raise WcsimError(
                f"{escaped(self._path)}: is full, with {self._records} records and {self._end} bytes; start another one"
            )
        try:
            written = self._file.write(data) or 0
            reason = "" if written == len(data) else "only a part was written"
        except OSError as error:
            reason = str(error.strerror)
        if reason:
            os.ftruncate(self._file.fileno(), self._end)
            self._file.seek(self._end)
            raise DiskFullError(f"{escaped(self._path)}: a record could not be written ({reason}); make room")
        self._end += len(data)
        self._records += 1
        self._after = crc_of(data)


def _first_payload(header: DriveHeader, path: Path) -> bytes:
    """The record of a header. Raises ConfigError for one with which the whole drive could not be read again."""
    try:
        return header_payload(header)
    except (ValueError, JournalError):
        raise ConfigError(
            f"{escaped(path)}: seed {header.seed}, tick_s {header.tick_s}, max_steps {header.max_steps} or a text of "
            "its header is out of bounds; expected a seed of 0 to 2^62, a tick of 0.001 to 10 s, at least one step, "
            "and texts of at most a million letters"
        ) from None
