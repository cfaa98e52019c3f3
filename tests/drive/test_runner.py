from __future__ import annotations

import json
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import pytest

from wcsim.drive import runner as runner_module
from wcsim.drive.runner import JSON, PICTURES, DriveRunner
from wcsim.drive.session import DriveSession
from wcsim.drive.starting import DriveStart

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
