"""events.jsonl: what is written can be read, and what cannot be written ends nothing."""

from tests.support.events import read_events
from wcsim.server.launch.event_log import EVENTS, EventLogWriter


def test_events_are_read_back(tmp_path):
    EventLogWriter(tmp_path).add("death", who="a", code=-9)
    (event,) = read_events(tmp_path)
    assert (event["event"], event["who"], event["code"]) == ("death", "a", -9)


def test_a_full_disk_loses_lines_alone(tmp_path):
    log = EventLogWriter(tmp_path)
    (tmp_path / EVENTS).symlink_to("/dev/full")
    log.add("death", who="a")
    (tmp_path / EVENTS).unlink()
    log.add("restart", who="a")
    assert [event["event"] for event in read_events(tmp_path)] == ["restart"]
