"""The events of a run, read again."""

from pathlib import Path
from typing import Any

from wcsim.core.reading import FileSpec, escape, parse_json, read_bytes
from wcsim.errors import JournalError
from wcsim.server.launch.event_log import EVENTS

_KIND = FileSpec(what="the events of a run", limit_bytes=1 << 30, error=JournalError)


def read_events(folder: Path) -> list[dict[str, Any]]:
    """All whole lines of a run's events; empty when there are none.

    A line that is no event, as one that was torn, is the event "damaged" with its text: none is left out.

    Raises:
        JournalError: The file cannot be read.
    """
    path = folder / EVENTS
    if not path.exists():
        return []
    lines = read_bytes(path, _KIND).split(b"\n")[:-1]
    return [_event(line.decode("utf-8", errors="replace")) for line in lines]


def _event(line: str) -> dict[str, Any]:
    try:
        event = parse_json(line, EVENTS, _KIND)
    except JournalError:
        event = {}
    return event if isinstance(event.get("event"), str) else {"event": "damaged", "line": escape(line)}
