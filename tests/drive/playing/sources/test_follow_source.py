"""A run that is watched: its journal grows, tears, is put aside and begun anew while somebody follows it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest

from tests.support.framing import write_log
from tests.support.journals import JournaledWorld
from wcsim.bridge.sumo.session import world_in_this_process
from wcsim.drive.playing.film_states import FilmAbout, FilmFrame, FilmLine, FilmNames, Said
from wcsim.drive.playing.sources import replay_source
from wcsim.drive.playing.sources.replay_source import follow_film
from wcsim.errors import ConfigError, JournalError
from wcsim.log.reader import LogFollower, iter_journal_part_inputs, read_header, rotate_log
from wcsim.log.records import Ended, EpochBegun, Ticked, with_fields
from wcsim.log.writer import LogWriter
from wcsim.server.host.opening import EPOCH_OVER


@pytest.fixture(scope="module")
def whole(corner: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A journal of two epochs of 30 ticks, of two chairs."""
    run = tmp_path_factory.mktemp("whole")
    with JournaledWorld(corner, run, seats=2) as it:
        for seat in (0, 1):
            it.admit(seat)
        it.tick(30)
        it.rebuild(9)
        it.tick(30)
    return (run / "journal").read_bytes()


@pytest.fixture
def kept(whole: bytes, tmp_path: Path) -> Path:
    """The whole journal beside the run that is watched."""
    (tmp_path / "all").write_bytes(whole)
    return tmp_path / "all"


class Watched:
    """A run folder whose journal grows by what a script says, whenever the follower waits for more."""

    def __init__(self, run: Path, script: Iterator[object]) -> None:
        self.run, self._script = run, script
        self.said: list[Said] = []
        self._clock = count()

    def follow(self) -> Watched:
        follow_film(self.run, "", self.said.append, self.gone, lambda: 0.3 * next(self._clock))
        return self

    def gone(self, wait_s: float) -> bool:
        """Nobody listens any more once the script is over."""
        return wait_s > 0.0 and next(self._script, "over") == "over"

    @property
    def ticks(self) -> list[tuple[int, int]]:
        return [(said.epoch, said.tick) for said in self.said if isinstance(said, FilmFrame)]

    def told(self, kind: str = "now") -> list[str]:
        return [said.told for said in self.said if isinstance(said, FilmLine) and said.kind == kind]


def pieces(run: Path, whole: bytes, cuts: list[int]) -> Iterator[None]:
    """The journal comes in these pieces, wherever they tear a record; a writer begins with a whole header."""
    yield from (None for _ in range(3))
    for start, end in zip([0, *cuts], [*cuts, len(whole)], strict=True):
        with (run / "journal").open("ab") as file:
            file.write(whole[start:end])
        yield from (None for _ in range(4))
    yield from (None for _ in range(20))


def test_it_shows_all_ticks_as_they_come_and_nothing_twice(whole: bytes, tmp_path: Path) -> None:
    cuts = sorted((2500, len(whole) // 2, len(whole) // 2 + 11, len(whole) - 5))
    watched = Watched(tmp_path, pieces(tmp_path, whole, cuts)).follow()
    assert watched.ticks == [(epoch, tick) for epoch in (0, 1) for tick in range(1, 31)]
    about = next(said for said in watched.said if isinstance(said, FilmAbout))
    assert about.live
    names = [said.names for said in watched.said if isinstance(said, FilmNames)]
    assert names[-1] == {0: "c0", 1: "c1"}
    told = watched.told()
    assert told[0] == "The run has not started yet."
    assert "live" in told
    assert told[-1].startswith("No process runs this world now")
    assert watched.told("bad") == []
    assert (tmp_path / "journal").read_bytes() == whole, "the run is not touched"
    assert not world_in_this_process()


def test_it_goes_over_to_the_newest_epoch_when_it_is_far_behind(
    whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay_source, "SKIPS_TICKS", 5)
    (tmp_path / "journal").write_bytes(whole)
    watched = Watched(tmp_path, iter([None])).follow()
    assert watched.ticks == [(1, tick) for tick in range(1, 31)]
    assert "30 ticks were skipped to reach the newest world." in watched.told("mark")
    assert any(line.endswith("ticks behind the run") for line in watched.told())
    (frame, *_) = [said for said in watched.said if isinstance(said, FilmFrame)]
    assert [chair.seat for chair in frame.chairs] == [0, 1], "who sat there before sits there still"


def test_a_part_that_is_put_aside_is_read_to_its_end(kept: Path, tmp_path: Path) -> None:
    journal = tmp_path / "journal"
    records = list(iter_journal_part_inputs(kept))
    second = next(
        number for number, record in enumerate(records) if isinstance(record, EpochBegun) and record.epoch == 1
    )

    def script() -> Iterator[None]:
        write_log(journal, read_header(kept), [*records[:second], Ended(reason=f"{EPOCH_OVER}: tick 30")])
        yield from (None for _ in range(8))
        rotate_log(journal)
        yield
        with LogWriter(journal, read_header(kept)) as writer:
            for record in records[second:]:
                writer.append(record)
            yield from (None for _ in range(40))
            writer.append(Ended(reason="asked to end"))
        yield from (None for _ in range(4))

    watched = Watched(tmp_path, script()).follow()
    assert len(watched.ticks) == 60
    told = watched.told()
    assert "This world has ended; the next one is starting." in told
    assert any(line.startswith("No tick for") and "waits for a client" in line for line in told)
    assert told[-1] == "The run has ended (asked to end). This page continues when the run is resumed."


def test_damage_and_garbage_end_it_in_a_line(whole: bytes, tmp_path: Path) -> None:
    for name, data in (("garbage", b"x" * 300), ("damaged", bytes(damaged(whole)))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "journal").write_bytes(data)
        with pytest.raises(JournalError, match=r"is not a log|is damaged at"):
            Watched(tmp_path / name, iter([None] * 4)).follow()
    assert not world_in_this_process()


def damaged(whole: bytes) -> bytearray:
    data = bytearray(whole)
    data[len(data) // 4] ^= 0xFF
    return data


def test_a_hook_is_not_loaded_because_a_journal_names_it(kept: Path, tmp_path: Path) -> None:
    write_log(tmp_path / "journal", with_fields(read_header(kept), hook="own:Hook"), ())
    with pytest.raises(ConfigError, match="a hook is code"):
        Watched(tmp_path, iter([None])).follow()


def test_a_tail_says_who_writes(kept: Path, tmp_path: Path) -> None:
    records = [record for record in iter_journal_part_inputs(kept) if not isinstance(record, Ticked)]
    with LogFollower(tmp_path / "journal") as tail:
        assert tail.read() == []
        assert tail.is_written() is None
        with LogWriter(tmp_path / "journal", read_header(kept)) as writer:
            for record in records:
                writer.append(record)
            assert tail.read(2) == records[:2]
            assert tail.read() == records[2:]
            assert tail.is_written() in (True, None)  # None where /proc/locks cannot be read
        assert not tail.is_written()


def test_what_is_written_between_two_looks_at_a_part_that_ends_is_read(
    kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A watcher has the lowest priority: it may stand between any two of its lines for as long as an epoch needs."""
    journal = tmp_path / "journal"
    records = list(iter_journal_part_inputs(kept))
    header, is_over, late = read_header(kept), LogFollower._is_rotated, [records[3:]]

    def stood_meanwhile(tail: LogFollower) -> bool:
        if late:
            with LogWriter.append_to(journal) as writer:
                for record in late.pop():
                    writer.append(record)
            rotate_log(journal)
            write_log(journal, header, ())
        return is_over(tail)

    write_log(journal, header, records[:3])
    monkeypatch.setattr(LogFollower, "_is_rotated", stood_meanwhile)
    with LogFollower(journal) as tail:
        assert tail.read() == records[:3]
        assert tail.read() == records[3:]
        assert tail.read() == []
