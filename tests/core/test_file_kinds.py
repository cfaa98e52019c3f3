"""What a text may do to the process that reads it: at most 128 MiB and 10 s, whatever is in it."""

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.attack.files.damage import CHEAP
from wcsim.core import reading
from wcsim.core.reading import FileSpec, read_json, read_lines, read_text, read_toml
from wcsim.errors import FileError

MOST_MIB, MOST_S = 128, 10


def all_lines(path: Path, kind: FileSpec) -> None:
    """All lines, one after the other."""
    for _ in read_lines(path, kind):
        pass


READERS: dict[str, tuple[Callable[[Path, FileSpec], object], FileSpec]] = {
    "json": (read_json, reading.RESULT),
    "toml": (read_toml, reading.SETTINGS),
    "text": (read_text, reading.RESULT),
    "lines": (all_lines, reading.STICK),
}
STREAMS = {"LOG", "PICTURES", "EXTRACT", "XML", "SCENARIO", "HEIGHTS", "SEGMENT", "ARRAYS", "WEIGHTS", "WHOLE_LOG"}


def most_mib() -> float:
    """The most memory that this process has had."""
    return int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) / 1024


def read_them(reader: str, path: Path, shares: list[float]) -> None:
    """A line for each damage, read by a child, as large as it is read at all: MiB, seconds of the processor."""
    read, kind = READERS[reader]
    for name, text in CHEAP.items():
        for share in shares:
            path.write_text(text(int(share * kind.limit_bytes) - 100))
            if not (child := os.fork()):
                had_mib, begun_s, said = most_mib(), time.process_time(), "read"
                try:
                    read(path, kind)
                except FileError as error:
                    said = "too much" if "would take more" in str(error) else "refused"
                sys.stdout.write(f"{name}\t{most_mib() - had_mib:.0f}\t{time.process_time() - begun_s:.2f}\t{said}\n")
                sys.stdout.flush()
                os._exit(said == "too much")
            if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0:
                break


def assert_bounded(reader: str, folder: Path, *shares: float, most_s: float = math.inf) -> None:
    code = f"import pathlib, {__name__} as t; t.read_them({reader!r}, pathlib.Path({str(folder / 'x')!r}), {shares!r})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    rows = [line.split("\t") for line in run.stdout.splitlines()]
    assert {row[0] for row in rows} == set(CHEAP)
    assert [row for row in rows if float(row[1]) > MOST_MIB or float(row[2]) > most_s] == [], run.stdout


@pytest.mark.parametrize("reader", READERS)
def test_a_small_bomb_is_bounded(tmp_path: Path, reader: str) -> None:
    assert_bounded(reader, tmp_path, 0.02)


@pytest.mark.proof
@pytest.mark.parametrize("reader", READERS)
def test_a_bomb_of_the_largest_size_is_bounded(tmp_path: Path, reader: str) -> None:
    assert_bounded(reader, tmp_path, *(0.85**k for k in range(30)), most_s=MOST_S)


def test_no_text_may_be_larger_than_what_was_tried() -> None:
    kinds = {name: kind for name, kind in vars(reading).items() if isinstance(kind, FileSpec)}
    most = max(kind.limit_bytes for _, kind in READERS.values())
    assert set(kinds) >= STREAMS
    assert [name for name, kind in kinds.items() if kind.limit_bytes > most and name not in STREAMS] == []


def test_a_sparse_file_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    path.touch()
    os.truncate(path, 1 << 42)
    for read, kind in READERS.values():
        with pytest.raises(FileError):
            read(path, kind)
