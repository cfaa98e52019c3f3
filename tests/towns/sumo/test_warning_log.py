"""A file of warnings that is read while it grows."""

from pathlib import Path

import pytest

from wcsim.towns.sumo import warning_log
from wcsim.towns.sumo.warning_log import WarningLog


def test_a_flood_in_blocks_is_counted_by_lines_and_its_file_stays_small(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(warning_log, "_MOST_BYTES", 500)
    path = tmp_path / "w.log"
    log = WarningLog(str(path))
    with path.open("w") as file:  # which goes on where it was, in blocks, as SUMO does
        for number in range(300):
            kind = "is jammed" if number < 50 else "x" * number
            print(f"Warning: Person '{number};\x1b[2J' {kind} at {number}.\n more\nError: no edge.", file=file)
            log.read()
    log.read()
    first = [*log.first.values()]
    assert (log.count, len(first), path.stat().st_size) == (300, 20, 500)
    assert first[0] == "Person '0;\\x1b[2J' is jammed at 0." and " xxxxxxxxxx" in first[1]
    path.unlink()
    log.read()
    assert log.count == 300
