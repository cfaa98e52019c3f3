"""The player's process without a server: a pipe, and a source in a process of its own."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest

from tests.drive.lookers import as_said
from wcsim.drive.playing import play_runner
from wcsim.drive.playing.play_runner import PlayStart, _PlayRunner
from wcsim.drive.playing.sources.source_process import FilmSource
from wcsim.drive.runner import DONE

PATIENCE_S = 400.0  # on a busy machine; nothing is asserted of how long it takes


class Desk:
    """Says what a page would, and reads what it would hear."""

    def __init__(self, source: FilmSource) -> None:
        self.pipe, theirs = Pipe()
        self._thread = threading.Thread(target=self._run, args=(theirs, PlayStart(source=source)), daemon=True)
        self._thread.start()

    def say(self, say: str, **more: object) -> None:
        self.pipe.send(as_said(say, **more))

    def until(self, wanted: Callable[[bytes, Any], bool]) -> Any:
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            if self.pipe.poll(0.2):
                data = self.pipe.recv_bytes()
                said = json.loads(data[1:]) if data[:1] == b"J" else data
                if wanted(data[:1], said):
                    return said
        raise AssertionError("never")

    def state(self, wanted: Callable[[Any], bool] = lambda state: True) -> Any:
        return self.until(lambda kind, said: kind == b"J" and said["say"] == "state" and wanted(said))

    def said(self, say: str) -> Any:
        return self.until(lambda kind, said: kind == b"J" and said["say"] == say)

    def close(self) -> None:
        self.say("end")
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def _run(self, pipe: Connection, start: PlayStart) -> None:
        _PlayRunner(pipe, start).run()


@pytest.fixture
def desk(run: Path) -> Iterator[Desk]:
    found = Desk(FilmSource(kind="log", path=run / "journal"))
    yield found
    found.close()


def test_a_film_begins_without_the_marks_of_the_one_before(desk: Desk) -> None:
    """Who comes later is told the newest line of each kind, so that of the film before is not to stay."""
    assert desk.said("marks") == {"say": "marks", "marks": []}


def test_no_message_of_a_page_ends_the_film(desk: Desk) -> None:
    desk.say("openepisode", policy="\U0001f9bd" * 400, block=0, seat=0)
    assert "not of a suite" in desk.said("notice")["told"]
    desk.say("newplace")  # of the page of a drive
    desk.until(lambda kind, said: kind == DONE)
    desk.state()


def test_what_cannot_be_read_is_told_of(tmp_path: Path) -> None:
    (tmp_path / "journal").write_bytes(b"nothing of the kind")
    desk = Desk(FilmSource(kind="log", path=tmp_path / "journal"))
    told = desk.said("notice")
    assert told["kind"] == "bad" and "is not a log" in told["told"]
    assert desk.said("busy")["told"] == "The recording ends here."
    desk.close()


def test_who_waits_for_a_run_is_told_why_it_may_take_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(play_runner, "start_piped_process", lambda *_, **__: (MagicMock(), MagicMock()))
    for gives_way in (True, False):
        ours, theirs = Pipe()
        source = FilmSource(kind="run", path=Path("run"), gives_way=gives_way)
        _PlayRunner(theirs, PlayStart(source=source))._open(source)
        said = json.loads(ours.recv_bytes()[1:])
        assert (said["say"], "it takes longer while the training uses the CPU" in said["told"]) == ("busy", gives_way)
