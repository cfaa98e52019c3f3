import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.drive.lookers import HearsDelays, Noted, SeesNumbers
from tests.support.worlds import quick_config
from wcsim.drive import starting
from wcsim.drive.driven import DriverKind, EventKind
from wcsim.drive.runner import _notice_of
from wcsim.drive.session import DriveSession, Wish
from wcsim.drive.starting import DriveStart, checked
from wcsim.errors import ConfigError, PolicyError, TownError
from wcsim.log.records import Respawned
from wcsim.types import Joystick, StartSpec
from wcsim.types.chair import AT_REST
from wcsim.users.user import SimulatedUser

AHEAD = Wish(stick=Joystick(0.0, 1.0))


def test_a_scripted_stick_moves_the_chair_and_rest_stops_it(session: DriveSession, noted: Noted) -> None:
    session.assist(False)
    for _ in range(20):
        session.tick(AHEAD)
    for _ in range(25):
        session.tick(Wish())
    driven = noted.ticks
    way_m = float(np.hypot(*(driven[-1].p_WB_m - driven[0].p_WB_m)[:2]))
    assert max(each.speed_mps for each in driven) > 1.0 and way_m > 1.0
    assert abs(driven[-1].speed_mps) < 0.02
    assert {each.commanded for each in driven[:20]} == {Joystick(0.0, 1.0)}
    assert [each.tick for each in driven] == list(range(1, 46))
    assert session.way_m == pytest.approx(way_m, rel=0.2)
    assert session.metrics.kpi1 == 0.0, "the chair did what the stick said"
    assert all(each.intent is None for each in driven), "nobody knows what a person wants"


def test_ticks_are_copies(session: DriveSession, noted: Noted) -> None:
    first = session.tick(AHEAD)
    before = first.p_WB_m.copy()
    for _ in range(10):
        session.tick(AHEAD)
    assert (first.p_WB_m == before).all() and not (noted.ticks[-1].p_WB_m == before).all()


def test_the_simulated_user_drives_where_it_is_asked_to(session: DriveSession, noted: Noted) -> None:
    session.drive_by(DriverKind.SIMULATED)
    for _ in range(30):
        session.tick(Wish())
    assert any(math.hypot(each.stick.x, each.stick.y) > 0.3 for each in noted.ticks)
    assert all(each.intent is not None for each in noted.ticks)
    assert EventKind.DRIVER in noted.kinds()


def test_a_person_may_wait_for_ever_and_a_simulated_user_may_not(session: DriveSession) -> None:
    session.tick(Wish())
    user = session.world.seats[0].user
    assert isinstance(user, SimulatedUser) and user.patient
    session.drive_by(DriverKind.SIMULATED)
    session.tick(Wish())
    assert not user.patient


def test_help_and_overruling_are_counted_and_written_down(session: DriveSession, noted: Noted) -> None:
    session.tick(Wish(help=True))
    for overrule in (True, True, False, True):
        session.tick(Wish(overrule=overrule))
    assert (session.metrics.helps, session.metrics.overrules) == (1, 2)
    kinds = noted.kinds()
    assert kinds.count(EventKind.HELP) == 1
    assert kinds.count(EventKind.OVERRULE) == 2 and kinds.count(EventKind.OVERRULE_END) == 1
    assert [each.overruled for each in noted.ticks] == [False, True, True, False, True]
    assert noted.ticks[0].helped and not noted.ticks[1].helped


def test_nothing_counts_before_the_user_hands_the_chair_over(session: DriveSession, noted: Noted) -> None:
    session.place = replace(session.place, handover_step=5)
    for _ in range(5):
        assert not session.handed_over
        session.tick(AHEAD)
    assert (session.counted_s, session.way_m, len(noted.ticks)) == (0.0, 0.0, 5)
    for _ in range(3):
        assert session.handed_over
        session.tick(AHEAD)
    assert session.counted_s == pytest.approx(3 * session.tick_s) and session.way_m > 0.0
    assert session.time_s == pytest.approx(8 * session.tick_s)


def test_assistance_and_level_are_switched_while_driving(session: DriveSession, noted: Noted) -> None:
    session.set_level(2.0)
    session.assist(False)
    session.assist(False)
    session.tick(AHEAD)
    assert (session.assistance.on, session.assistance.level, session.unsafe) == (False, 2.0, ())
    assert noted.kinds().count(EventKind.ASSISTANCE) == 1 and noted.kinds().count(EventKind.LEVEL) == 1
    with pytest.raises(PolicyError, match="expected 0 to 2"):
        session.set_level(2.5)


def faces(session: DriveSession) -> bool:
    return abs(session.bearing_rad) < math.radians(45.0)


def test_every_beginning_faces_its_way(session: DriveSession, noted: Noted) -> None:
    place = session.place
    session.place = replace(place, spec=replace(place.spec, start=StartSpec(p_W_m=(0, 0), yaw_rad=0, goal_W_m=(9, 9))))
    drawn = []
    for _ in range(8):
        session.new_place()
        drawn.append(faces(session))
    assert set(drawn) == {True, False}, "starts as they are drawn, or as a list fixes them, may face away"
    session.place, before = place, len(noted.inputs)
    for begin in (*[session.new_place] * 8, lambda: session.change_user("slow"), session.again, session.face_way):
        begin()
        assert faces(session)
    turned = [record for record in noted.inputs[before:] if isinstance(record, Respawned) and record.start is not None]
    assert turned, "so that a recording does it again"


def test_after_a_crash_the_drive_goes_on_some_metres_before_it(session: DriveSession, noted: Noted) -> None:
    session.assist(False)
    session.face_way()
    for number in range(150):
        if session.tick(AHEAD if number < 50 else Wish(stick=Joystick(0.5, 0.8))).crashed:
            break
    crash, goal = session.client.plant.p_WB_m[:2], session.route.points_W_m[-1]
    trail = np.array([each.p_WB_m[:2] for each in noted.ticks])
    session.tick(Wish())
    back_m = session.client.plant.p_WB_m[:2]
    assert 4.9 < math.dist(crash, back_m) < 12.0
    assert np.linalg.norm(trail - back_m, axis=1).min() < 0.3, "where the chair has been"
    assert np.allclose(session.route.points_W_m[-1], goal) and faces(session)
    assert noted.events[-1].detail == "before the crash" and (session.episode, session.metrics.crashes) == (1, 1)


def test_a_crash_with_no_free_place_before_it_begins_elsewhere_and_says_so(
    session: DriveSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    session.assist(False)
    session.face_way()
    while not session.tick(Wish(stick=Joystick(0.5, 0.8))).crashed:
        assert session.time_s < 15.0
    monkeypatch.setattr(session.world, "start_facing", lambda *_: None)
    said: list[tuple[str, str] | None] = []
    session.add_observer(lambda record: said.append(_notice_of(record)))
    session.tick(Wish())
    assert [told for _, told in filter(None, said)] == ["No place before the crash is free. You start somewhere else."]


def test_a_new_place_another_user_and_the_beginning_are_episodes(session: DriveSession, noted: Noted) -> None:
    first = session.tick(Wish())
    for begin in (session.new_place, lambda: session.change_user("slow"), session.again):
        begin()
        assert session.last is None
        session.tick(Wish())
        assert session.metrics.steps == 1
    last = noted.ticks[-1]
    assert [each.episode for each in noted.ticks] == [0, 1, 2, 3] and session.last is last
    assert session.profile == "slow"
    assert np.abs(last.p_WB_m - first.p_WB_m).max() < 0.01, "the street begins as it did"
    assert (session.metrics.ended, session.metrics.ended_steps) == (3, 3)
    with pytest.raises(ConfigError, match="unknown user profile"):
        session.change_user("nobody")
    session.tick(Wish())
    assert session.profile == "slow"


def test_the_policy_hears_the_delay_of_each_episode_before_it_begins(
    corner: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    varied = quick_config("vary.action_delay_ticks=[0,9]")
    monkeypatch.setattr(starting, "resolve_policy_config", lambda *_, **__: varied)
    with DriveSession(DriveStart(town=str(corner), policy="tests.drive.lookers:HearsDelays", seed=4)) as drive:
        drawn = [drive.client.drawn]
        for _ in range(3):
            drive.new_place()
            drawn.append(drive.client.drawn)
        policy = drive.place.policy
    assert isinstance(policy, HearsDelays)
    delays = [each.action_delay_ticks for each in drawn if each is not None]
    assert policy.heard == [word for delay in delays for word in (delay, "reset")]
    assert len(delays) == 4 and len(set(delays)) > 1


def test_a_policy_that_sees_numbers_sees_the_stick_of_the_person(corner: Path) -> None:
    with DriveSession(DriveStart(town=str(corner), policy="tests.drive.lookers:SeesNumbers", seed=4)) as drive:
        drive.driver = DriverKind.PERSON
        for wish in (Joystick(0.5, 0.5), Joystick(-0.25, 0.75)):
            drive.tick(Wish(stick=wish))
        policy = drive.place.policy
    assert isinstance(policy, SeesNumbers) and policy.heard == [*2 * [(0.5, 0.5)], *2 * [(-0.25, 0.75)]]


def test_closing_twice_closes_observers_once(session: DriveSession, noted: Noted) -> None:
    session.close()
    session.close()
    assert noted.closed == 1


def test_the_same_sticks_give_the_same_drive(corner: Path) -> None:
    ways = []
    for _ in range(2):
        noted = Noted()
        with DriveSession(DriveStart(town=str(corner), seed=7), (noted,)) as drive:
            for number in range(15):
                drive.tick(Wish(stick=Joystick(0.2 * math.sin(number), 0.8)))
        ways.append(np.array([each.p_WB_m for each in noted.ticks]))
    assert (ways[0] == ways[1]).all()


def test_a_stick_is_shaped_before_anybody_sees_it(corner: Path, noted: Noted) -> None:
    start = DriveStart(town=str(corner), policy="dwa", seed=4, speed=0.5)
    with DriveSession(start, (noted,)) as drive:
        assert drive.tick(Wish(stick=Joystick(0.0, 1.0), pace=0.3)).stick == Joystick(0.0, 0.5)
        drive.shape_stick(1.0, 0.5)
        assert drive.tick(Wish(stick=Joystick(0.0, 0.5))).stick == Joystick(0.0, 0.25)
    told = [event.detail for event in noted.events if event.kind == EventKind.STICK_SHAPE]
    assert told == ["speed 1, sensitivity 0.5"]
    assert [tick.pace for tick in noted.ticks] == [0.3, 1.0]


def test_a_stick_out_of_its_gate_is_in_it(session: DriveSession) -> None:
    driven = session.tick(Wish(stick=Joystick(3.0, 4.0)))
    assert (driven.stick.x, driven.stick.y) == pytest.approx((0.6, 0.8))
    assert session.tick(Wish(stick=Joystick(math.nan, 1.0))).stick == AT_REST


@pytest.mark.parametrize(
    "wrong, error, told",
    [
        ({"town": "atlantis"}, TownError, "atlantis"),
        ({"profile": "nobody"}, ConfigError, "unknown user profile"),
        ({"suite": "guard", "block": 71}, ConfigError, "expected 0 to 9"),
        ({"suite": "guard", "seat": 6}, ConfigError, "expected 0 to 5"),
        ({"suite": "nope"}, ConfigError, "there is no such list"),
    ],
)
def test_what_is_not_there_is_refused_before_anything_is_closed(
    wrong: dict[str, object], error: type[Exception], told: str
) -> None:
    with pytest.raises(error, match=told):
        checked(DriveStart(**wrong))  # type: ignore[arg-type]


def test_an_episode_of_a_suite_begins_where_the_list_says() -> None:
    """A generated scene: the car door, with its own user, settings and start."""
    from wcsim.agents.opening.list_file import open_suite

    blocks = open_suite("dev2").file.blocks
    index = next(number for number, block in enumerate(blocks) if block.town == "car-door-near")
    with DriveSession(DriveStart(suite="dev2", block=index, profile="")) as drive:
        at = drive.tick(Wish()).p_WB_m
        assert np.abs(at[:2] - blocks[index].episodes[0].start_m).max() < 0.3
        assert drive.place.spec.max_steps == blocks[index].episodes[0].max_steps
        assert "car-door" in drive.place.told


def test_help_raises_the_assistance_for_ten_seconds_and_says_so(session: DriveSession, noted: Noted) -> None:
    said: list[tuple[str, str] | None] = []
    session.add_observer(lambda record: said.append(_notice_of(record)))
    session.tick(Wish(help=True))
    assert session.help_left_s == pytest.approx(9.9)
    levels = [session.assistance.level]
    for _ in range(99):
        session.tick(Wish())
        levels.append(session.assistance.level)
    assert levels == [2.0] * 99 + [1.0] and not session.help_left_s
    assert session.help_left_s == 0.0 and noted.kinds().count(EventKind.HELP_END) == 1
    assert [told for _, told in filter(None, said)] == [
        "The user asks for help. For 10 s the policy assists the most.",
        "Help is over. The assistance is as before.",
    ]


@pytest.mark.parametrize("answered", [False, True])
def test_the_request_of_a_simulated_user_counts_and_is_answered_where_that_is_set(
    session: DriveSession, answered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = session.place.config
    world = config.world.model_copy(update={"help_users": answered})
    session.place = replace(session.place, config=config.model_copy(update={"world": world}))
    events = replace(session.client.events, help_asked=True)
    session.client = replace(session.client, events=events)
    session.tick(Wish())
    assert session.metrics.helps == 0, "a person drives"
    session.client = replace(session.client, events=events)
    session.drive_by(DriverKind.SIMULATED)
    session.tick(Wish())
    assert session.metrics.helps == 1 and bool(session.assistance.help_left) is answered
