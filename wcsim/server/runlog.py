"""events.jsonl of a run with several processes: what started, died, was started again and recovered, and when."""

from __future__ import annotations

import contextlib
import json
import time
from datetime import UTC, datetime
from pathlib import Path

EVENTS = "events.jsonl"


class RunLog:
    """Appends one line an event; a killed process loses nothing, and a full disk loses lines alone."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / EVENTS
        self._begun_s = time.monotonic()

    def add(self, event: str, **values: str | int | float) -> None:
        """Write a line: the time of day, seconds since this log was opened, the event and its values."""
        line = {
            "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "elapsed_s": round(time.monotonic() - self._begun_s, 3),
            "event": event,
            **values,
        }
        # Who keeps processes alive must not end because a line about them cannot be written.
        with contextlib.suppress(OSError), self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line, allow_nan=False) + "\n")


def read_events(folder: Path) -> list[dict[str, str | int | float]]:
    """All whole lines of a run's events; empty when there are none."""
    path = folder / EVENTS
    if not path.is_file():
        return []
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    return [json.loads(line) for line in lines if line.endswith("\n")]
