from __future__ import annotations

import json
from collections.abc import Iterator
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import pytest

from tests.drive.lookers import Breaks, Noted
from wcsim.drive import messages as m
from wcsim.drive import runner as runner_module
from wcsim.drive.driven import EventKind
from wcsim.drive.runner import JSON, PICTURES, DriveRunner
from wcsim.drive.session import DriveSession
from wcsim.drive.starting import DriveStart
from wcsim.types import Joystick

SLOW_S = 40.0  # to open a street that was never built


def heard_of(start: DriveStart, monkeypatch: pytest.MonkeyPatch, *said: dict[str, Any]) -> list[tuple[bytes, bytes]]:
    """What the server hears of a drive whose page says some things while the street opens, slowly, and then ends."""
    now_s = [100.0]

    def slowly(*args: Any) -> DriveSession:
        now_s[0] += SLOW_S
        return DriveSession(*args)

    monkeypatch.setattr(runner_module, "DriveSession", slowly)
    server, pipe = Pipe()
    for message in (*said, {"say": "end"}):
        server.send_bytes(json.dumps(message).encode())
    DriveRunner(pipe, start, clock=lambda: now_s[0]).run()
    pipe.close()
    heard = []
    while server.poll():
        try:
            data = server.recv_bytes()
        except EOFError:
            break
        heard.append((data[:1], data[1:]))
    return heard


def test_a_street_that_opened_slowly_is_seen_before_its_first_tick_and_blames_no_page(
    corner: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = DriveStart(town=str(corner), policy="dwa")
    heard = heard_of(start, monkeypatch, {"say": "stick", "x": 0.0, "y": 0.0}, {"say": "ready"})
    states = [json.loads(data) for kind, data in heard if kind == JSON]
    states = [state for state in states if state["say"] == "state"]
    assert (states[0]["tick"], states[0]["waiting"]) == (0, "")
    assert states[-1]["tick"] == 1
    kinds = [kind for kind, data in heard if kind == PICTURES or b'"tick":1,' in data]
    assert kinds[:2] == [PICTURES, JSON]


def test_nobody_at_the_stick_lets_time_stand_still(corner: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard = heard_of(DriveStart(town=str(corner), policy="dwa"), monkeypatch, {"say": "ready"})
    states = [json.loads(data) for kind, data in heard if kind == JSON and b'"say":"state"' in data]
    assert {state["tick"] for state in states} == {0}
    assert sum(kind == PICTURES for kind, _ in heard) == 1


@pytest.fixture
def drive(corner: Path) -> Iterator[DriveRunner]:
    """A drive that is open, whose stick is pushed and counts."""
    server, pipe = Pipe()
    runner = DriveRunner(pipe, DriveStart(town=str(corner), policy="dwa"), clock=lambda: 100.0)
    runner._begin()
    for stick in ((0.0, 0.0), (0.0, 1.0)):
        runner._watch.hear(Joystick(*stick), False, 100.0)
    yield runner
    runner.close()
    server.close()
    pipe.close()


def test_an_episode_that_ends_asks_for_a_stick_at_rest(drive: DriveRunner, monkeypatch: pytest.MonkeyPatch) -> None:
    drive._tick(100.0)
    assert not drive.must_rest
    monkeypatch.setattr(DriveSession, "ended", property(lambda session: True))
    drive._tick(100.1)
    assert drive.must_rest


def test_a_policy_that_breaks_stops_time_once(drive: DriveRunner) -> None:
    assert drive.session is not None
    drive.session.assistance._policy = Breaks(None)
    events = Noted()
    drive.session.look_on(events)
    for _ in range(6):
        assert not drive.paused
        drive._tick(100.0)
    assert drive.paused, "whoever sits there is to know of it"
    drive._pause(m.Pause(on=False))
    for _ in range(3):
        drive._tick(100.0)
    assert not drive.paused, "and drives on without it"
    drive.session.new_place()
    drive._tick(100.0)
    assert events.kinds().count(EventKind.POLICY_FAILED) == 1
    drive.session.assist(True)
    for _ in range(6):
        drive._tick(100.0)
    assert drive.paused, "it is tried again, and breaks again"
