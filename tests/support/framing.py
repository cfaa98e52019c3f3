"""Files of records made by hand, as no writer would make them; and whole logs in memory."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from wcsim.log.framing import crc_from_record, frame_payload, iter_whole_records
from wcsim.log.reader import LogScan, list_log_parts
from wcsim.log.records import Header, LogRecord
from wcsim.log.writer import LogWriter


@dataclass(frozen=True, slots=True, kw_only=True)
class WholeLog:
    """A log; `torn` when something that is no whole record follows the last one."""

    header: Header
    records: tuple[LogRecord, ...]
    torn: bool


def read_whole(path: Path) -> WholeLog:
    """A log with all its parts."""
    scans = [LogScan(part) for part in list_log_parts(path) or (path,)]
    records = tuple(record for scan in scans for record in scan.records())
    return WholeLog(header=scans[0].header, records=records, torn=scans[-1].truncated_bytes > 0)


def write_log(path: Path, header: Header, records: Iterable[LogRecord]) -> Path:
    """A log of these records, as its writer makes it."""
    with LogWriter(path, header) as writer:
        for record in records:
            writer.append(record)
    return path


def chained(payloads: Iterable[bytes], after: int = 0) -> bytes:
    """Payloads as the records of a log."""
    records = []
    for payload in payloads:
        records.append(frame_payload(payload, after))
        after = crc_from_record(records[-1])
    return b"".join(records)


def payloads_of(path: Path) -> list[bytes]:
    """The payloads of a log."""
    with path.open("rb") as file:
        return [record.payload for record in iter_whole_records(file)]


def last_crc(path: Path) -> int:
    """The CRC of the last record of a log."""
    with path.open("rb") as file:
        return [record.crc for record in iter_whole_records(file)][-1]


def record_ends(path: Path) -> list[int]:
    """Where the records of a log end."""
    with path.open("rb") as file:
        return [record.end for record in iter_whole_records(file)]


def pieces(path: Path) -> list[bytes]:
    """The records of a file as they lie there."""
    data = path.read_bytes()
    return [data[begin:end] for begin, end in pairwise([0, *record_ends(path)])]
