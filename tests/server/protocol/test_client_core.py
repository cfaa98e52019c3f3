"""The client core: what its driver gets, when it asks again, when it gives up."""

import math
from itertools import count

import msgspec
import pytest

from wcsim.errors import BadActionError, ProtocolError, WcsimError
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import (
    ClientCore,
    ClientPhase,
    JoinSettings,
    Outcome,
    Patience,
    ReceivedFrame,
)
from wcsim.types import Joystick, SeatSpec

AHEAD = Joystick(0.0, 1.0)


def client(seat: int = m.ANY_SEAT) -> ClientCore:
    numbers = count(1)
    patience = Patience(resend_s=2.0, reconnect_s=90.0, tick_s=300.0)
    ask = JoinSettings(claim=b"mine", name="me", spec=SeatSpec(), seat=seat)
    return ClientCore(ask, patience, lambda: bytes([next(numbers)]) * m.SESSION_BYTES)


def frame(tick: int, epoch: int = 0, life: int = 0) -> m.Frame:
    return m.Frame(epoch, tick, life, None)


def seen(tick: int, epoch: int = 0, stepped: bool = False) -> ReceivedFrame:
    return ReceivedFrame(epoch, tick, None, -1, stepped)


def welcome(core: ClientCore, epoch: int = 0, tick: int = 0) -> m.Welcome:
    return m.Welcome(core.session, epoch, tick, 0, 0)


def welcomed(tick: int = 0) -> ClientCore:
    core = client()
    core.join(0.0)
    core.handle(welcome(core, tick=tick), 0.0)
    return core


def thinking(tick: int = 0) -> ClientCore:
    core = welcomed(tick)
    core.handle(frame(tick), 0.0)
    assert core.phase is ClientPhase.THINK
    return core


def waiting(tick: int = 0) -> ClientCore:
    core = thinking(tick)
    core.act(tick, AHEAD, 0.0)
    return core


def failure(core: ClientCore, name: str) -> m.Failure:
    return m.Failure(name, "told so", core.session)


def said(outcomes: list[Outcome]) -> list[m.Request]:
    return [outcome for outcome in outcomes if isinstance(outcome, m.Request)]


def error_in(outcomes: list[Outcome]) -> WcsimError:
    (error,) = [outcome for outcome in outcomes if isinstance(outcome, WcsimError)]
    return error


@pytest.mark.parametrize("call", ["act", "respawn", "rebuild"])
def test_calls_out_of_turn_are_refused(call: str) -> None:
    core = waiting()
    with pytest.raises(ProtocolError, match="wait tick"):
        {"act": lambda: core.act(0, AHEAD, 1.0), "respawn": lambda: core.respawn(1.0)}.get(
            call, lambda: core.rebuild(1, 1.0)
        )()


@pytest.mark.parametrize("x", [1.5, math.nan])
def test_bad_action_is_refused_before_it_is_sent(x: float) -> None:
    core = thinking()
    with pytest.raises(BadActionError, match=str(x)):
        core.act(0, Joystick(x, 0.0), 0.0)
    assert core.phase is ClientPhase.THINK


@pytest.mark.parametrize("lost", [(), ("done",)])
def test_what_was_lost_is_asked_for_again(lost: tuple[str, ...]) -> None:
    core = waiting()
    if lost:  # only the word of the tick is lost: its frame is no lost step
        assert core.handle(frame(1), 0.5) == []
    assert core.clock(1.0) == []
    assert said(core.clock(3.0)) == [m.Act(core.session, 0, 0, 0, 0.0, 1.0)]
    assert core.clock(4.0) == []
    core.handle(m.TickDone(0, 1, 0), 5.0)
    core.handle(m.TickDone(0, 1, 0), 5.0)
    assert core.handle(frame(1), 5.0) == [seen(1, stepped=True)]
    assert core.handle(frame(1), 5.0) == []


def test_a_lost_first_frame_is_asked_for_by_joining_again_and_cuts_nothing() -> None:
    core = welcomed()
    (join,) = said(core.clock(3.0))
    assert isinstance(join, m.Join) and join.session == core.session
    core.handle(welcome(core), 3.0)
    assert core.handle(frame(0), 3.0) == [seen(0)]


def test_a_step_that_is_left_out_or_comes_uncalled_ends_the_client() -> None:
    done = m.TickDone(0, 1, 0), m.TickDone(0, 2, 0)
    for core, message in ((waiting(), frame(2)), (waiting(), done[1]), (thinking(), done[0])):
        error = error_in(core.handle(message, 1.0))
        assert isinstance(error, ProtocolError) and "lost or doubled" in str(error)
        assert core.phase is ClientPhase.GONE


def test_a_session_that_is_not_known_when_it_joins_is_left_for_a_new_one() -> None:
    core = client()
    (join,) = said(core.join(0.0))
    (again,) = said(core.handle(failure(core, "StaleSessionError"), 1.0))
    assert again == msgspec.structs.replace(join, session=core.session) != join
    assert core.phase is ClientPhase.JOINING


def test_world_restarted_by_another_server() -> None:
    core = waiting(tick=4)
    old = core.session
    (join,) = said(core.handle(failure(core, "StaleSessionError"), 1.0))
    assert isinstance(join, m.Join) and join.session != old
    assert said(core.handle(welcome(core, epoch=1), 1.0)) == [], "the action was for the world before"
    shown, failed = core.handle(frame(0, epoch=1), 1.0)
    assert shown == seen(0, epoch=1)
    assert type(failed).__name__ == "WorldRestartedError" and "epoch 1" in str(failed)


def test_world_restarted_by_somebody_else_but_not_by_oneself() -> None:
    core = waiting(tick=4)
    core.handle(m.Restarted(1, "with seed 3"), 1.0)
    error = error_in(core.handle(frame(0, epoch=1), 1.0))
    assert type(error).__name__ == "WorldRestartedError" and "seed 3" in str(error)
    core = thinking(tick=4)
    core.rebuild(3, 1.0)
    core.handle(m.Restarted(1, "with seed 3"), 1.0)
    assert core.handle(frame(0, epoch=1), 1.0) == [seen(0, epoch=1)]


def test_who_has_seen_no_frame_is_not_told_of_a_restart() -> None:
    core = welcomed()
    core.handle(m.Restarted(1, "with seed 3"), 1.0)
    assert core.handle(frame(0, epoch=1), 1.0) == [seen(0, epoch=1)]


def test_tick_timeout_names_the_late_ones() -> None:
    core = waiting()
    for second in range(1, 300, 50):
        core.handle(m.Waiting(0, 0, ("slow one", "other")), float(second))
    core.handle(m.Waiting(0, 0, ("slow one",)), 300.0)
    error = error_in(core.clock(301.0))
    assert type(error).__name__ == "TickTimeoutError"
    assert "301 s" in str(error) and "slow one" in str(error) and "other" not in str(error)


def test_evicted_and_in_again() -> None:
    core = waiting(tick=4)
    assert type(error_in(core.handle(failure(core, "EvictedError"), 1.0))).__name__ == "EvictedError"
    assert core.phase is ClientPhase.OFF
    (join,) = said(core.join(2.0))
    assert isinstance(join, m.Join) and join.seat == 0
    core.handle(welcome(core, tick=9), 2.0)
    assert core.handle(frame(9), 2.0) == [seen(9)]


def test_who_wanted_any_seat_takes_another_one_when_its_own_is_gone() -> None:
    core = waiting(tick=4)
    core.handle(failure(core, "StaleSessionError"), 1.0)
    (join,) = said(core.handle(failure(core, "SeatTakenError"), 1.0))
    assert isinstance(join, m.Join) and join.seat == m.ANY_SEAT


def test_a_refused_rebuild_leaves_the_driver_where_it_was() -> None:
    core = thinking(tick=2)
    core.rebuild(3, 0.0)
    assert type(error_in(core.handle(failure(core, "NotMasterError"), 0.0))).__name__ == "NotMasterError"
    assert said(core.act(2, AHEAD, 0.0)) == [m.Act(core.session, 0, 2, 0, 0.0, 1.0)]
    assert core.handle(failure(core, "NotMasterError"), 0.0) == [], "it came twice"
    assert core.phase is ClientPhase.WAIT_TICK


def test_a_late_double_of_an_old_request_does_not_fail_the_one_of_now() -> None:
    core = waiting(tick=6)
    assert core.handle(failure(core, "StaleTickError"), 0.0) == []
    assert core.phase is ClientPhase.WAIT_TICK


def test_words_for_another_session_are_nobodys() -> None:
    core = waiting()
    assert core.handle(m.Failure("EvictedError", "", b"somebody else's.."), 0.0) == []
    assert core.handle(m.Bye(b"somebody else's.."), 0.0) == []
    assert core.phase is ClientPhase.WAIT_TICK


def test_a_copy_goes_its_own_way() -> None:
    core = thinking()
    twin = core.copied()
    twin.act(0, AHEAD, 0.0)
    assert (core.phase, twin.phase) == (ClientPhase.THINK, ClientPhase.WAIT_TICK)
