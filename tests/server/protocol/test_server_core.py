"""The server core: what each wrong request is answered, and that nothing a peer sends can break it."""

import math

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from tests.server.model.shadow import Shadow
from tests.server.protocol.desk import Desk, failure, join_of, only, session_of
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import (
    AdmitSeatEffect,
    BarrierState,
    ClientLostEvent,
    DismissSeatEffect,
    Effect,
    Event,
    MessageReceivedEvent,
    RebuildWorldEffect,
    RespawnSeatsEffect,
    SendMessageEffect,
    SendSensorFrameEffect,
    ServerRules,
    StepWorldEffect,
    TimePassedEvent,
    WorldSteppedEvent,
)
from wcsim.server.protocol.members import MOST_LIVES
from wcsim.server.protocol.server_core import ServerCore


def test_stale_tick() -> None:
    desk = Desk(members=1)
    for tick in range(3):
        desk.step(tick)
    error, text = failure(desk.act(0, tick=1))
    assert error == "StaleTickError"
    assert "tick 1" in text and "tick 3" in text


def test_future_tick() -> None:
    error, text = failure(Desk().act(0, tick=9))
    assert error == "FutureTickError"
    assert "(0, 9, 0)" in text and "(0, 0, 0)" in text


@pytest.mark.parametrize("x, y", [(1.01, 0.0), (math.nan, 0.0), (0.0, -math.inf)])
def test_bad_action(x: float, y: float) -> None:
    error, text = failure(Desk().act(0, x=x, y=y))
    assert error == "BadActionError"
    assert str(x) in text and "-1 to 1" in text


def test_a_second_action_that_differs_is_bad_and_the_first_one_counts() -> None:
    desk = Desk()
    desk.act(0, x=0.5)
    assert failure(desk.act(0, x=0.25))[0] == "BadActionError"
    assert desk.act(0, x=0.5) == []
    assert only(desk.act(1), StepWorldEffect).commands[0].joystick.x == 0.5


def test_those_who_have_acted_are_told_for_whom_they_wait() -> None:
    desk = Desk()
    desk.act(0)
    assert only(desk.wait(1.0), m.Waiting, peer=0).late == ("c1",)


def test_not_master() -> None:
    error, text = failure(Desk().say(1, m.Rebuild(session_of(1), 0, 3)))
    assert error == "NotMasterError"
    assert "seat 1" in text


@pytest.mark.parametrize("leaves", [True, False])
def test_the_next_oldest_is_master_when_the_master_goes_and_all_are_told(leaves: bool) -> None:
    desk = Desk(members=3, capacity=3)
    desk.act(1)
    desk.act(2)
    went = desk.say(0, m.Leave(session_of(0))) if leaves else desk.feed(ClientLostEvent(session_of(0)))
    assert [c.seat for c in only(went, StepWorldEffect).commands] == [1, 2], "nobody waits for a new master"
    done = desk.feed(WorldSteppedEvent(1))
    assert [only(done, m.TickDone, peer=who).master for who in (1, 2)] == [1, 1]
    desk.say(0, join_of(0, session=session_of(7)))
    assert only(desk.step(1), m.Welcome, peer=0).master == 1, "it is the youngest now"


def test_a_new_world_needs_a_seed_that_there_is() -> None:
    desk = Desk(members=1)
    error, text = failure(desk.say(0, m.Rebuild(session_of(0), 0, -5)))
    assert error == "ProtocolError"
    assert "-5" in text
    assert only(desk.say(0, m.Rebuild(session_of(0), 0, 5)), RebuildWorldEffect).seed == 5


def test_stale_session() -> None:
    desk = Desk(members=1)
    error, text = failure(desk.say(1, m.Act(session_of(9), 0, 0, 0, 0.0, 0.0)))
    assert error == "StaleSessionError"
    assert "epoch 0" in text and "join again" in text


def test_evicted_by_its_lease_and_fenced_afterwards() -> None:
    desk = Desk(lease_s=100.0)
    desk.act(0)
    error, text = failure(desk.wait(101.0))
    assert error == "EvictedError"
    assert "101 s" in text
    assert failure(desk.act(1))[0] == "EvictedError"
    assert failure(desk.say(1, join_of(1)))[0] == "EvictedError"
    desk.say(1, join_of(1, session=session_of(7)))
    assert only(desk.step(0), m.Welcome, peer=1).session == session_of(7)


def test_progress_keeps_a_slow_client_and_a_beat_without_does_not() -> None:
    desk = Desk(members=1, lease_s=100.0)
    for progress in (1, 2, 3):
        desk.say(0, m.Beat(session_of(0), progress))
        assert desk.wait(90.0) == []
    desk.say(0, m.Beat(session_of(0), 3))
    assert failure(desk.wait(90.0))[0] == "EvictedError"


def test_new_lives_give_a_client_no_new_time_to_think_and_have_an_end() -> None:
    desk = Desk(members=1, lease_s=100.0, max_think_s=50.0)

    def respawn(life: int) -> list[Effect]:
        return desk.say(0, m.Respawn(session_of(0), 0, 0, life))

    for life in range(2):
        assert desk.wait(20.0) == []
        assert only(respawn(life), RespawnSeatsEffect).seats == (0,)
    assert failure(desk.wait(20.0)) == ("EvictedError", "the server dropped this client: no action within 50 s")
    desk = Desk(members=2, max_think_s=50.0)
    respawn(0)
    desk.wait(49.0)
    assert only(desk.act(1), RespawnSeatsEffect).seats == (0,)
    desk.wait(2.0)
    assert len(desk.core.roster.members) == 2, "while it waited for others it owed nothing"
    desk = Desk(members=1)
    for life in range(MOST_LIVES):
        respawn(life)
    assert failure(respawn(MOST_LIVES))[0] == "ProtocolError"
    desk.say(0, m.Act(session_of(0), 0, 0, MOST_LIVES, 0.0, 0.0))
    desk.feed(WorldSteppedEvent(1))
    assert only(desk.say(0, m.Respawn(session_of(0), 0, 1, 0)), RespawnSeatsEffect).seats == (0,)


def test_a_client_that_comes_again_gets_a_new_chair_and_holds_nobody_up() -> None:
    desk = Desk(members=2, lease_s=300.0, max_think_s=50.0)
    desk.act(1)
    again = desk.say(0, join_of(0, session=session_of(7)))
    assert failure(again) == ("EvictedError", "the server dropped this client: its client restarted")
    assert [c.seat for c in only(again, StepWorldEffect).commands] == [1]
    assert only(desk.feed(WorldSteppedEvent(1)), m.Welcome, peer=0).session == session_of(7)


def test_the_same_claim_takes_its_seat_over_whatever_seat_it_asks_for() -> None:
    desk = Desk()
    effects = desk.say(7, join_of(7, claim=bytes([1]), seat=m.ANY_SEAT))
    assert failure(effects)[0] == "EvictedError"
    effects = desk.step(0)
    assert only(effects, DismissSeatEffect).seat == 1
    assert only(effects, AdmitSeatEffect).seat == 1
    assert only(effects, m.Welcome, peer=7).seat == 1


def test_who_waits_is_found_at_its_new_address() -> None:
    desk = Desk(members=1)
    assert desk.say(1, join_of(1)) == []
    assert desk.say(8, join_of(1)) == []
    assert only(desk.step(0), m.Welcome, peer=8).session == session_of(1)


def test_an_older_life_that_waits_hears_that_it_is_over() -> None:
    desk = Desk(members=1)
    desk.say(1, join_of(1))
    assert failure(desk.say(1, join_of(1, session=session_of(7))))[0] == "EvictedError"
    assert failure(desk.say(1, join_of(1)))[0] == "EvictedError"


def test_a_sole_master_that_hangs_does_not_hold_the_next_one_up() -> None:
    desk = Desk(members=1, lease_s=100.0)
    desk.say(1, join_of(1))
    assert not any(isinstance(e, AdmitSeatEffect) for e in desk.wait(50.0))
    effects = desk.wait(51.0)
    assert failure(effects)[0] == "EvictedError"
    assert only(effects, AdmitSeatEffect).seat == 1
    assert only(effects, m.Welcome, peer=1).master == 1


def test_who_lives_goes_on_past_two_that_hang() -> None:
    desk = Desk(members=3, capacity=3, lease_s=100.0)
    desk.act(2)
    step = only(desk.wait(101.0), StepWorldEffect)
    assert [c.seat for c in step.commands] == [2]
    assert only(desk.feed(WorldSteppedEvent(1)), m.TickDone).master == 2


def test_an_epoch_ends_at_a_full_barrier_with_those_gone_who_have_left() -> None:
    desk = Desk()
    desk.core.last_tick = 0
    desk.act(0)
    assert [type(e) for e in desk.say(1, m.Leave(session_of(1)))] == [SendMessageEffect, DismissSeatEffect]
    assert desk.core.stage is BarrierState.EPOCH_OVER
    assert desk.act(0) == desk.wait(1000.0) == []


def test_a_lost_session_that_nobody_knows_is_refused_when_it_joins_late() -> None:
    desk = Desk(members=1)
    desk.feed(ClientLostEvent(session_of(1)))
    assert failure(desk.say(1, join_of(1)))[0] == "EvictedError"


def test_who_was_cut_off_joins_again_under_another_session_and_is_not_told_that_it_was_dropped() -> None:
    desk = Desk()
    assert desk.feed(ClientLostEvent(session_of(1), may_return=True)) == []
    for late in (m.Act(session_of(1), 0, 0, 0, 0.5, 0.0), join_of(1)):
        assert failure(desk.say(1, late))[0] == "StaleSessionError"
    desk.say(1, join_of(1, session=session_of(7)))
    assert only(desk.step(), m.Welcome, peer=1).seat == 1


NUMBERS = st.one_of(st.integers(-2, 4), st.integers(-(1 << 63), (1 << 64) - 1))
FLOATS = st.one_of(st.sampled_from([0.0, 1.0, -1.0]), st.floats())
SESSIONS = st.one_of(st.integers(0, 4).map(session_of), st.binary(max_size=20))


class AnyRequests(RuleBasedStateMachine):
    """Whatever peers send: no exception, a legal order of world operations, a master among the members."""

    def __init__(self) -> None:
        super().__init__()
        self.core = ServerCore(ServerRules(capacity=2, expected=1, lease_s=50.0, gather_s=10.0))
        self.world, self.now_s = Shadow(), 0.0

    def feed(self, event: Event) -> None:
        todo: list[Effect] = list(self.core.handle(event, self.now_s))
        while todo:
            effect = todo.pop(0)
            if isinstance(effect, StepWorldEffect):
                acted = [(c.seat, c.tick) for c in effect.commands]
                assert acted == [(chair.seat, self.world.tick) for chair in self.world.chairs]
                self.world = self.world.stepped()
                todo += self.core.handle(WorldSteppedEvent(self.world.tick), self.now_s)
            elif isinstance(effect, SendSensorFrameEffect):
                assert self.world.at(effect.seat) is not None
            elif not isinstance(effect, SendMessageEffect):
                self.world = self.world.after(effect)

    @rule(session=SESSIONS, seat=NUMBERS, claim=st.binary(max_size=2))
    def join(self, session: bytes, seat: int, claim: bytes) -> None:
        self.feed(MessageReceivedEvent(b"p", join_of(0, session=session, seat=seat, claim=claim)))

    @rule(who=st.integers(0, 4))
    def join_well(self, who: int) -> None:
        self.feed(MessageReceivedEvent(bytes([who]), join_of(who, seat=m.ANY_SEAT)))

    @rule(session=SESSIONS, epoch=NUMBERS, tick=NUMBERS, life=NUMBERS, x=FLOATS, y=FLOATS)
    def act(self, session: bytes, epoch: int, tick: int, life: int, x: float, y: float) -> None:
        self.feed(MessageReceivedEvent(b"p", m.Act(session, epoch, tick, life, x, y)))

    @rule(which=st.integers(0, 1))
    def act_well(self, which: int) -> None:
        for member in self.core.roster.members[which : which + 1]:
            now = (self.core.epoch, self.core.tick, member.life)
            self.feed(MessageReceivedEvent(member.peer, m.Act(member.session, *now, 0.5, 0.5)))

    @rule(session=SESSIONS, epoch=NUMBERS, number=NUMBERS, life=NUMBERS, kind=st.integers(0, 3))
    def other(self, session: bytes, epoch: int, number: int, life: int, kind: int) -> None:
        requests: tuple[m.Request, ...] = (
            m.Respawn(session, epoch, number, life),
            m.Rebuild(session, epoch, number),
            m.Beat(session, number),
            m.Leave(session),
        )
        self.feed(MessageReceivedEvent(b"p", requests[kind]))

    @rule(session=SESSIONS, may_return=st.booleans())
    def lose(self, session: bytes, may_return: bool) -> None:
        self.feed(ClientLostEvent(session, may_return=may_return))

    @rule(seconds=st.sampled_from([0.5, 6.0, 60.0]))
    def wait(self, seconds: float) -> None:
        self.now_s += seconds
        self.feed(TimePassedEvent())

    @invariant()
    def holds(self) -> None:
        assert len({member.seat for member in self.core.roster.members}) == len(self.core.roster.members) <= 2
        assert (self.core.epoch, self.core.tick) == (self.world.epoch, self.world.tick)
        assert self.core.stage in (BarrierState.EMPTY, BarrierState.COLLECT)
        there = {member.seat for member in self.core.roster.members} | set(self.core.roster.going)
        assert {chair.seat for chair in self.world.chairs} == there


TestAnyRequests = AnyRequests.TestCase
TestAnyRequests.settings = settings(max_examples=60, stateful_step_count=40, suppress_health_check=list(HealthCheck))


@pytest.mark.proof
@pytest.mark.timeout(900)
class TestManyMoreRequests(AnyRequests.TestCase):  # type: ignore[misc, name-defined]
    settings = settings(TestAnyRequests.settings, max_examples=2000, stateful_step_count=50)
