"""Films of what was recorded, beside the worlds that they are of."""

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.agents.evaluation.suite.lists import block_of, suite_in
from tests.support.framing import read_whole
from tests.support.journals import nudged, rewritten
from tests.view.report.results import score_anew
from wcsim.agents.evaluation.suite.result_files import read_result
from wcsim.agents.evaluation.suite.run import SuiteOrder, drive_piece, piece_of, town_addresses
from wcsim.agents.opening.list_file import write_list
from wcsim.bridge.sumo.session import world_in_this_process
from wcsim.bridge.user_drives import drawn_user, record_user
from wcsim.cli.evaluation.judged_suite import save_test_result
from wcsim.cli.recordings import replay
from wcsim.cli.recordings.episode_film import send_block_film
from wcsim.config import resolve
from wcsim.core.files import iter_unused_paths
from wcsim.drive.driven import DriverKind, happened_in
from wcsim.drive.playing.film_states import FilmAbout, FilmFrame, FilmLine, FilmNames, Said
from wcsim.drive.playing.sources.replay_source import replay_film, state_film
from wcsim.drive.playing.sources.source_process import FilmSource
from wcsim.drive.playing.tick_film import TickFilm
from wcsim.drive.recording.session_recorder import SessionRecorder
from wcsim.drive.session import DriveSession, Wish
from wcsim.drive.starting import DriveStart
from wcsim.errors import ConfigError, JournalError, TownError
from wcsim.log.drive import read_drive
from wcsim.log.reader import read_trace_states
from wcsim.log.records import Ticked
from wcsim.towns.scenario.town import Town, find_town
from wcsim.types import Joystick
from wcsim.users.profiles import find_builtin_profile


class Filmed:
    """What a source said, as it comes through a pipe."""

    def __init__(self, said: Iterable[Said] = ()) -> None:
        self.names: dict[int, str] = {}
        self.lines: list[FilmLine] = []
        self.film = TickFilm(FilmAbout(title="", town="", tick_s=0.1))
        for one in said:
            self.hear(one)

    def hear(self, said: Said) -> None:
        if isinstance(said, FilmAbout):
            self.film = TickFilm(said)
        elif isinstance(said, FilmFrame):
            self.film.add(said)
        elif isinstance(said, FilmNames):
            self.names = dict(said.names)
        else:
            self.lines.append(said)
            self.film.mark(said.kind, said.told)

    def frames(self) -> list:
        return [self.film.shot(at).frame for at in range(self.film.count)]


def test_a_journal_shows_everybody_where_they_were(run: Path, corner: Path) -> None:
    shown = Filmed(replay_film(run / "journal"))
    ticked = [record for record in read_whole(run / "journal").records if isinstance(record, Ticked)]
    frames = shown.frames()
    assert [(frame.epoch, frame.tick) for frame in frames] == [(record.epoch, record.tick) for record in ticked]
    for frame, record in zip(frames, ticked, strict=True):
        given = [(round(c.joystick.x, 4), round(c.joystick.y, 4)) for c in record.commands]
        assert [chair.commanded for chair in frame.chairs] == given
    _, records = read_trace_states(run / "beside.trace")
    for frame, record in zip(frames, records, strict=False):
        places = np.array([chair.p_WB_m for chair in frame.chairs]).reshape(-1, 3)
        assert np.allclose(places, record.plants[:, :3], atol=1e-4)
    assert shown.names == {0: "c0", 1: "c1", 2: "c2"}
    assert [line.told for line in shown.lines][-1] == "The whole journal is loaded."
    assert shown.film.about.ticks == len(ticked) and not shown.film.about.tells_who
    moment = shown.film.moment(100, 0, jumped=False)
    assert moment is not None and moment.route is not None and moment.actors
    assert any(chair.intervening for frame in frames for chair in frame.chairs)
    assert any(chair.truncated for frame in frames for chair in frame.chairs)
    assert not world_in_this_process()


@pytest.mark.proof
def test_a_journal_that_comes_out_another_way_says_so(run: Path, tmp_path: Path) -> None:
    records = read_whole(run / "journal").records
    at = next(i for i, r in enumerate(records) if isinstance(r, Ticked) and (r.epoch, r.tick) == (1, 40))
    other = rewritten(run / "journal", tmp_path / "journal", {at: nudged(records[at])})
    shown = Filmed(replay_film(other, 1, ""))
    assert {frame.epoch for frame in shown.frames()} == {1}
    assert "ticks differ: it was made" in shown.lines[-1].told


def test_a_trace_shows_places_alone(run: Path, corner: Path) -> None:
    shown = Filmed(state_film(run / "beside.trace", None, str(corner)))
    _, records = read_trace_states(run / "beside.trace")
    frames = shown.frames()
    assert len(frames) == sum(len(record.plants) > 0 for record in records)
    chair = frames[-1].chairs[0]
    assert (chair.stick, frames[-1].ways, happened_in(chair)) == (None, {}, set())
    assert chair.p_WB_m == records[-1].plants[0][:3].tolist()
    assert shown.film.about.camera == ""
    moment = shown.film.moment(len(frames) - 1, chair.seat, jumped=False)
    assert moment is not None and moment.route is None
    about = next(state_film(run / "beside.trace"))  # of a scene, whose street is built in the cache
    assert find_town(about.town).name == "pedestrian-crossing"
    with pytest.raises(TownError, match="expected the town that it was recorded in"):
        next(state_film(run / "beside.trace", None, "helsinki"))
    with pytest.raises(ConfigError, match="no wheelchair"):
        next(state_film(run / "beside.trace", 7, str(corner)))


def test_garbage_is_refused_in_a_line(run: Path, tmp_path: Path) -> None:
    garbage = tmp_path / "garbage"
    garbage.write_bytes(b"x" * 5000)
    for film in (replay_film(garbage), state_film(garbage)):
        with pytest.raises(JournalError):
            next(film)
    with pytest.raises(ConfigError):
        read_result(tmp_path)
    data = bytearray((run / "journal").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "journal").write_bytes(data)
    with pytest.raises(JournalError, match="is damaged at byte"):
        Filmed(replay_film(tmp_path / "journal", None, ""))
    assert not world_in_this_process()


def test_a_torn_journal_is_shown_up_to_its_last_whole_tick(run: Path, tmp_path: Path) -> None:
    (tmp_path / "journal").write_bytes((run / "journal").read_bytes()[:-20])
    assert Filmed(replay_film(tmp_path / "journal", 1, "")).film.count == 59


def test_a_drive_is_made_again(corner_town: Town, tmp_path: Path) -> None:
    config = resolve("quick")
    user = drawn_user(find_builtin_profile("tremor"), 3)
    record_user(tmp_path / "a.drive", corner_town, config, user, ticks=40, seed=3)
    shown = Filmed(replay_film(tmp_path / "a.drive"))
    ticks = read_drive(tmp_path / "a.drive").ticks
    frames = shown.frames()
    assert len(frames) == 40
    for frame, tick in zip(frames, ticks, strict=True):
        (chair,) = frame.chairs
        assert np.allclose(chair.p_WB_m, tick.p_WB_m, atol=1e-4)
        assert chair.stick == (round(tick.stick.x, 4), round(tick.stick.y, 4))
    assert shown.lines[-1].told == "The whole drive is loaded."
    assert json.loads(shown.film.about.camera)["name"] == config.cameras[0].name


def test_who_decided_in_a_drive_is_told(corner: Path, tmp_path: Path) -> None:
    """Before a handover the user alone; the assistance off and on; what was off before a file began is off in it."""
    files = iter_unused_paths(tmp_path / "a.drive")
    with DriveSession(DriveStart(town=str(corner), seed=4)) as session:
        session.place = replace(session.place, handover_step=4, episode="dev 0.0")
        session.add_observer(SessionRecorder(session, files, lambda _: None))
        ahead = Wish(stick=Joystick(0.0, 1.0))
        for on in (True, False, True, False):
            session.assist(on)
            for _ in range(6):
                session.tick(ahead)
        kpi1, kpi2 = session.metrics.kpi1, session.metrics.kpi2
        session.again()
        session.drive_by(DriverKind.SIMULATED)
        for _ in range(6):
            session.tick(ahead)
    shown = Filmed(replay_film(tmp_path / "a.drive"))
    ticks = [frame.chairs[0] for frame in shown.frames()]
    assert [each.alone for each in ticks] == [True] * 4 + [False] * 20
    assert [each.unaided for each in ticks] == ([False] * 6 + [True] * 6) * 2
    sums = shown.film.shot(23).sums[0]
    assert (sums.kpi1, sums.kpi2) == (pytest.approx(kpi1, abs=1e-3), kpi2)
    second = [frame.chairs[0] for frame in Filmed(replay_film(tmp_path / "a-2.drive")).frames()]
    assert all(each.unaided for each in second)
    assert not any(each.alone for each in second), "a simulated user who was told to drive"


def test_an_older_drive_in_a_town_that_tells_of_no_driver_has_no_handover(corner: Path, tmp_path: Path) -> None:
    with DriveSession(DriveStart(town=str(corner), seed=4)) as session:
        session.add_observer(SessionRecorder(session, iter_unused_paths(tmp_path / "a.drive"), lambda _: None))
        session.driver = DriverKind.SIMULATED  # without a word
        for _ in range(4):
            session.tick(Wish())
    drive = read_drive(tmp_path / "a.drive")
    assert all(tick.intent is not None for tick in drive.ticks) and "driver" not in {e.kind for e in drive.events}
    ticks = [frame.chairs[0] for frame in Filmed(replay_film(tmp_path / "a.drive")).frames()]
    assert len(ticks) == 4 and not any(each.alone for each in ticks)


def test_follow_decides_nothing_in_a_drive(corner: Path, tmp_path: Path) -> None:
    with DriveSession(DriveStart(town=str(corner), seed=4, policy="follow")) as session:
        session.add_observer(SessionRecorder(session, iter_unused_paths(tmp_path / "a.drive"), lambda _: None))
        for on in (False, True):
            session.assist(on)
            session.tick(Wish())
    shown = Filmed(replay_film(tmp_path / "a.drive"))
    assert shown.film.about.tells_who
    assert [frame.chairs[0].unaided for frame in shown.frames()] == [True, True]


@pytest.fixture(scope="module")
def tested(corner: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a test of `stop` on a block of two chairs."""
    folder = tmp_path_factory.mktemp("tested")
    suite = suite_in(corner, block_of(corner, max_steps=45, handover=5))
    write_list(suite.file, folder / "corner.json")
    order = SuiteOrder(suite=suite, out=folder, forks=0)
    piece = piece_of(order, 0, "stop", town_addresses(order), judged=False)
    save_test_result(order, str(folder / "corner.json"), {"stop": drive_piece(piece)})
    return folder


def choice(folder: Path, **changes: object) -> FilmSource:
    return FilmSource(**{"kind": "episode", "path": folder, "policy": "", "block": 0, "own": (), **changes})


def test_an_own_network_goes_with_the_episodes_of_a_test(tested: Path) -> None:
    start = replay._episode_start(replay._Options(result=tested, policy="stop", network="own_file:Own"))
    assert start.source.own == ("stop", "own_file:Own")
    with pytest.raises(ConfigError, match="is no finished test; expected"):
        replay._episode_start(replay._Options(result=tested / "none"))


def test_an_episode_of_a_test_is_driven_as_it_was(tested: Path) -> None:
    shown = Filmed()
    send_block_film(choice(tested), shown.hear)
    assert [line.kind for line in shown.lines] == ["end"], "nothing went another way"
    assert set(shown.names) == {0, 1}
    frames = shown.frames()
    kept = json.loads((tested / "episodes.json").read_text())["stop"]
    for record in kept:
        own = [chair for frame in frames for chair in frame.chairs if chair.seat == record["seat"]]
        assert len(own) == record["steps"] + 5
        assert [chair.alone for chair in own[:6]] == [True] * 5 + [False]
        assert all(chair.stick is not None and chair.commanded is not None for chair in own)
        at = max(at for at, frame in enumerate(frames) if any(chair.seat == record["seat"] for chair in frame.chairs))
        sums = shown.film.shot(at).sums[record["seat"]]
        assert sums.kpi1 == pytest.approx(record["distance_sum"] / record["steps"], abs=1e-3)
        assert sums.kpi2 == record["steps"]
    assert shown.film.about.warns and not shown.film.about.tells_unsafe
    assert shown.film.about.tells_who
    assert not any(chair.unaided for frame in frames for chair in frame.chairs)


def save_again(tested: Path, folder: Path, episodes: object) -> None:
    """A test with other episodes, and with the rows that they give."""
    for name in ("result.json", "asked.json"):
        (folder / name).write_bytes((tested / name).read_bytes())
    (folder / "episodes.json").write_text(json.dumps(episodes))
    score_anew(folder)


def test_follow_decides_nothing_in_an_episode(tested: Path, tmp_path: Path) -> None:
    save_again(tested, tmp_path, json.loads((tested / "episodes.json").read_text().replace('"stop"', '"follow"')))
    shown = Filmed()
    send_block_film(choice(tmp_path), shown.hear)
    assert all(chair.unaided for frame in shown.frames() for chair in frame.chairs)


def test_an_episode_that_goes_another_way_says_so(tested: Path, tmp_path: Path) -> None:
    episodes = json.loads((tested / "episodes.json").read_text())
    episodes["stop"][0]["m"] += 1.0
    save_again(tested, tmp_path, episodes)
    shown = Filmed()
    send_block_film(choice(tmp_path), shown.hear)
    assert any(line.kind == "bad" and "differs from the saved one" in line.told for line in shown.lines)


def test_what_is_not_in_a_test_is_refused(tested: Path) -> None:
    for changes, told in (({"block": 4}, "--block 4"), ({"policy": "dwa"}, "expected one of: stop")):
        with pytest.raises(ConfigError, match=told):
            send_block_film(choice(tested, **changes), lambda said: None)
