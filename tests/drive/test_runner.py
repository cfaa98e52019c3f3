import json
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.drive.lookers import Breaks, BreaksAtOnce, Noted, as_said
from wcsim.drive import messages as m
from wcsim.drive import runner as runner_module
from wcsim.drive.driven import EventKind
from wcsim.drive.runner import DONE, JSON, LINE, PICTURES, _drive_about, _drive_state, _DriveRunner
from wcsim.drive.session import DriveSession
from wcsim.drive.starting import DriveStart
from wcsim.types import ClassId, Joystick

States = list[dict[str, Any]]
SLOW_S = 40.0  # to open a street that was never built


def received(server: Connection, wait_s: float | None = 0.0) -> list[bytes]:
    """What the server has heard by now; with None all, until the other end is closed."""
    heard = []
    while server.poll(wait_s):
        try:
            heard.append(server.recv_bytes())
        except EOFError:
            break
    return heard


def states(heard: list[bytes]) -> States:
    return [json.loads(data[1:]) for data in heard if data.startswith(JSON + b'{"say":"state"')]


@pytest.fixture
def heard_of(corner: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[bytes]]:
    """What the server hears of a drive whose page says some things while the street opens, slowly, and then ends."""
    now_s = [100.0]

    def slowly(*args: Any) -> DriveSession:
        now_s[0] += SLOW_S
        return DriveSession(*args)

    monkeypatch.setattr(runner_module, "DriveSession", slowly)

    def heard(*said: dict[str, Any], policy: str = "dwa", seed: int = 0) -> list[bytes]:
        server, pipe = Pipe()
        for message in (*said, {"say": "end"}):
            server.send(as_said(**message))
        start = DriveStart(town=str(corner), policy=policy, seed=seed)
        with ThreadPoolExecutor(1) as reads:  # a pipe holds less than a street
            found = reads.submit(received, server, None)
            _DriveRunner(pipe, start, clock=lambda: now_s[0]).run()
            pipe.close()
            return found.result()

    return heard


def test_a_street_that_opened_slowly_is_seen_before_its_first_tick_and_blames_no_page(heard_of) -> None:
    heard = heard_of({"say": "stick", "x": 0.0, "y": 0.0}, {"say": "ready"})
    first, *_, last = states(heard)
    assert (first["tick"], first["waiting"]) == (0, "")
    assert last["tick"] == 1
    kinds = [data[:1] for data in heard if data[:1] == PICTURES or b'"tick":1,' in data]
    assert kinds[:2] == [PICTURES, JSON]


def test_nobody_at_the_stick_lets_time_stand_still(heard_of) -> None:
    heard = heard_of({"say": "ready"})
    assert {state["tick"] for state in states(heard)} == {0}
    assert sum(data[:1] == PICTURES for data in heard) == 1


def test_the_street_of_a_policy_without_pictures_is_drawn(heard_of) -> None:
    heard = heard_of({"say": "ready"}, policy="tests.drive.lookers:SeesNumbers")
    assert sum(data[:1] == PICTURES for data in heard) == 1


def test_the_chair_faces_its_way_when_it_stands_in_its_street_and_the_terminal_hears_of_it(heard_of) -> None:
    """Of a seed whose way begins behind the chair."""
    heard = heard_of(seed=4)
    assert abs(states(heard)[0]["bearing_deg"]) < 45
    lines = [data[1:].decode() for data in heard if data[:1] == LINE]
    assert lines[0].endswith(", seed 4: ready to drive")


def test_an_episode_that_ends_asks_for_a_stick_at_rest(drive: _DriveRunner, monkeypatch: pytest.MonkeyPatch) -> None:
    drive._tick(100.0)
    assert not drive._watch.must_rest
    monkeypatch.setattr(DriveSession, "ended", property(lambda session: True))
    drive._tick(100.1)
    assert drive._watch.must_rest


def test_a_press_while_a_crash_is_shown_does_not_overrule_in_the_next_episode(
    drive: _DriveRunner, monkeypatch: pytest.MonkeyPatch
) -> None:
    def press() -> bool:
        for overrule in (True, False):
            drive._stick(m.Stick(x=0.0, y=0.0, overrule=overrule))
        drive._tick(100.0)
        assert drive.session.last is not None
        return drive.session.last.overruled

    assert press()
    monkeypatch.setattr(DriveSession, "ended", property(lambda session: True))
    assert not press()


def test_a_policy_that_breaks_stops_time_once(drive: _DriveRunner) -> None:
    assert drive.session is not None
    drive.session.assistance._agent.policy = Breaks()
    events = Noted()
    drive.session.add_observer(events)
    for _ in range(6):
        assert not drive.clock.paused
        drive._tick(100.0)
    assert drive.clock.paused, "whoever sits there is to know of it"
    drive._pause(m.Pause(on=False))
    for _ in range(3):
        drive._tick(100.0)
    assert not drive.clock.paused, "and drives on without it"
    drive.session.new_place()
    drive._tick(100.0)
    assert events.kinds().count(EventKind.POLICY_FAILED) == 1
    drive.session.assist(True)
    for _ in range(6):
        drive._tick(100.0)
    assert drive.clock.paused, "it is tried again, and breaks again"


@pytest.mark.parametrize("where", ["act", "reset"])
def test_a_policy_that_breaks_again_at_once_is_told_of_again(drive: _DriveRunner, where: str) -> None:
    assert drive.session is not None
    drive.session.assistance._agent.policy = BreaksAtOnce(where)
    events = Noted()
    drive.session.add_observer(events)
    if where == "reset":
        drive.session.assistance.reset(None)
    drive._tick(100.0)
    assert drive.clock.paused
    drive._assist(m.Assist(on=True))
    drive._pause(m.Pause(on=False))
    if where == "act":
        drive._tick(100.0)
        assert drive.clock.paused
    assert events.kinds().count(EventKind.POLICY_FAILED) == 2
    drive._pause(m.Pause(on=False))
    drive._tick(100.0)
    assert not drive.clock.paused, "who goes on knows of it"


class Desk:
    """A runner whose clock is set by hand, and what its server hears."""

    def __init__(self, corner: Path) -> None:
        self.now_s = 100.0
        self.server, pipe = Pipe()
        self.runner = _DriveRunner(pipe, DriveStart(town=str(corner), policy="dwa"), clock=lambda: self.now_s)
        self.runner._begin()

    def say(self, say: str, **more: object) -> None:
        self.server.send(as_said(say, **more))

    def turn(self, after_s: float = 0.0, **stick: object) -> States:
        """Let time go on, with a page that holds the stick if its message is said."""
        self.now_s += after_s
        if stick:
            self.say("stick", **{"x": 0.0, "y": 0.0, **stick})
        self.runner._turn()
        return states(received(self.server))

    def pause(self, on: bool = True) -> None:
        self.say("pause", on=on)

    @property
    def ticks(self) -> int:
        return self.runner.session.ticks


@pytest.fixture
def desk(corner: Path) -> Iterator[Desk]:
    found = Desk(corner)
    yield found
    found.runner.close()


@pytest.fixture
def drive(desk: Desk) -> _DriveRunner:
    """A drive that is open, whose stick is pushed and counts."""
    for stick in ((0.0, 0.0), (0.0, 1.0)):
        desk.runner._watch.hear(Joystick(*stick), False, 100.0)
    return desk.runner


def test_who_comes_back_while_time_is_paused_is_not_told_that_nobody_is_there(desk: Desk) -> None:
    desk.turn(x=0.0)
    desk.pause()
    assert desk.turn(0.1)[-1]["paused"]
    assert "No page is driving" in desk.turn(10.0)[-1]["waiting"]
    assert desk.turn(0.1) == [], "said once"
    assert [state["waiting"] for state in desk.turn(0.1, x=0.0)] == [""]


def test_time_that_stood_still_is_no_slow_motion(desk: Desk) -> None:
    for _ in range(3):
        desk.turn(0.1, x=0.0)
    desk.pause()
    desk.turn(60.0, x=0.0)
    desk.pause(False)
    assert [desk.turn(0.1, x=0.0)[-1]["real"] for _ in range(3)] == [1.0] * 3
    assert desk.turn(0.2, x=0.0)[-1]["real"] < 1.0


def test_a_page_that_says_its_stick_all_the_time_keeps_nothing_else_waiting(desk: Desk) -> None:
    desk.turn(x=0.0)
    desk.pause()
    assert "No page is driving" in desk.turn(10.0)[-1]["waiting"]
    enough = threading.Event()

    def hold() -> None:
        for _ in range(250):
            desk.say("stick", x=0.0, y=0.0)
            if enough.wait(0.02):
                return

    page = threading.Thread(target=hold)
    page.start()
    told: States = []
    while page.is_alive() and not told:
        told = desk.turn()
    in_between = page.is_alive()
    enough.set()
    page.join()
    assert in_between and told[-1]["waiting"] == ""


def test_a_page_that_was_left_lets_a_persons_time_stand_still(desk: Desk) -> None:
    for _ in range(10):
        desk.turn(0.5, x=0.0, away=True)
    assert desk.runner.session is not None and "in the background" in desk.runner.waiting
    ticks = desk.ticks
    for _ in range(4):
        desk.turn(0.5, x=0.0, away=True)
    assert desk.ticks == ticks
    assert desk.turn(0.5, x=0.0)[-1]["waiting"] == "" and desk.ticks > ticks
    desk.say("driveby", who="simulated")
    for _ in range(10):
        desk.turn(0.5, x=0.0, away=True)
    assert desk.runner.waiting == "" and desk.ticks > ticks + 5, "one may look on from elsewhere"
    ticks = desk.ticks
    for _ in range(3):
        desk.turn(20.0)
    assert desk.runner.waiting == "" and desk.ticks == ticks + 3, "hidden pages say little"
    desk.say("gone")
    assert "No page is driving" in desk.turn(0.1)[-1]["waiting"]


def test_help_that_is_asked_for_while_time_is_paused_is_counted_at_once(desk: Desk) -> None:
    desk.turn(x=0.0)
    desk.pause()
    desk.say("help")
    desk.say("help")
    assert desk.turn(0.1)[-1]["kpis"]["helps"] == 1, "once a tick"
    desk.runner._open(DriveStart(town=desk.runner._start.town, policy="dwa", seed=1))
    assert desk.turn(0.1, x=0.0)[-1]["kpis"]["helps"] == 0, "and in no other place"


def test_a_press_while_time_is_paused_does_not_overrule_once_it_goes_on(desk: Desk) -> None:
    def press() -> None:
        for overrule in (True, False):
            desk.say("stick", x=0.0, y=0.0, overrule=overrule)

    press()
    assert desk.turn(0.1)[-1]["overruled"]
    desk.pause()
    press()
    desk.turn(0.1)
    desk.pause(False)
    told = desk.turn(0.1)[-1]
    assert (told["paused"], told["overruled"]) == (False, False)
    assert desk.runner.session is not None and desk.ticks == 2


def test_a_slow_wish_is_told_of_when_it_is_done_also_where_it_is_refused(desk: Desk) -> None:
    received(desk.server)
    for wish in ({"say": "newplace"}, {"say": "setuser", "profile": "nobody"}, {"say": "help"}):
        desk.say(**wish)
    desk.runner._turn()
    assert received(desk.server).count(DONE) == 2


def test_a_signal_leaves_what_takes_long_but_no_end_that_is_under_way(desk: Desk) -> None:
    with pytest.raises(SystemExit):
        desk.runner.leave()
    desk.runner.leave()


def test_no_message_of_a_page_ends_the_drive(desk: Desk) -> None:
    desk.server.send(m.Open(town="\U0001f9bd" * 400, suite="a" * 390))
    desk.server.send(m.GoLive())  # of the page of a film
    desk.runner._turn()
    heard = received(desk.server)
    told = [json.loads(data[1:])["told"] for data in heard if data.startswith(JSON + b'{"say":"notice"')]
    assert len(told) == 1 and "is not one that the page offers" in told[0]
    desk.turn(0.1, x=0.0)
    assert desk.runner.session is not None and desk.ticks > 0, "the drive goes on"


def test_the_page_is_told_the_streets_seed_and_when_the_chair_is_on_the_road(drive: _DriveRunner) -> None:
    session = drive.session
    assert session is not None
    assert _drive_about(session)["seed"] == session.place.start.seed
    ground, told = session.world.street.grid, {}
    for y in range(-30, 31):
        xy = (float(session.client.plant.p_WB_m[0]), float(y))
        told.setdefault(ground.class_here(*xy), xy)
    for kind in (ClassId.ROAD, ClassId.SIDEWALK):
        session.world.put_chair(0, np.array(told[kind]), 0.0)
        drive._tick(100.0)
        assert _drive_state(session, drive.clock, "", False)["on_road"] is (kind is ClassId.ROAD)
