"""The oracle: walls, kerbs, moving people, and no danger where there is none."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.samples import ACTIONS, KERB_M, USUAL_OUTLINE, straight_route, strip_street
from tests.support.yardstick import multiple
from tests.users.actors import USUAL_RIMS_M, USUAL_WHEELS_M, actor, car, make_user, walker
from tests.users.kinematics import TICK_S, Chair, Sim, plant, polyline
from wcsim.config import ChairConfig
from wcsim.core.frames import quaternion_from_ypr
from wcsim.core.joystick import shape_joysticks
from wcsim.supervisor.oracle import CrashOracle
from wcsim.types import ActorKind, Joystick, StreetGrid
from wcsim.types.street import AT_EDGE

STREET = strip_street()
FORWARD, STOP, BACKWARDS = Joystick(0.0, 0.8), Joystick(0.0, 0.0), Joystick(0.0, -1.0)
STAY, ON, BACK = (ACTIONS.nearest((0.0, y)) for y in (0.0, 1.0, -0.5))
UP, DOWN = math.pi / 2, -math.pi / 2


def oracle_of(grid=STREET.grid, outline=USUAL_OUTLINE, wheels=USUAL_WHEELS_M, rims=USUAL_RIMS_M, tick_s=0.1, **chair):
    return CrashOracle(grid, ChairConfig(**chair), outline, wheels, rims, ACTIONS.points, tick_s)


ORACLE = oracle_of()
SOFT = oracle_of(decel_mps2=0.3)


def danger(x, y, yaw, v=0.0, stick=FORWARD, actors=()) -> bool:
    return ORACLE.assess(plant(x, y, yaw, v), stick, actors).danger


def meets(*others, v=1.3, stick=FORWARD) -> bool:
    """Whether a chair in the middle of the pavement is in danger of others."""
    return danger(5.0, 5.5, 0.0, v, stick, others)


def safe_actions(state, others):
    return ORACLE.assess(state, STOP, others).safe_actions


def clearance(state, others) -> float:
    return ORACLE.assess(state, STOP, others).clearance_m


def drive(chair: Chair, stick: Joystick, ticks: int) -> None:
    for _ in range(24 * ticks):
        chair.drive(stick, TICK_S / 24)


@pytest.mark.parametrize("speed", [0.4, 0.8, 1.25, 1.67])
def test_a_wall_is_seen_in_time_to_brake_and_not_much_sooner(speed):
    stick = Joystick(0.0, 0.08 + 0.92 * speed / 1.67)
    chair = Chair(x=60.0, y=4.5, yaw=UP, v=speed)  # the house begins at y = 9
    while not ORACLE.assess(chair.plant(), stick, ()).danger:
        drive(chair, stick, 1)
    gap_m = 9.0 - (chair.y + 0.8)
    drive(chair, stick, 2)  # an agent needs a tick to see it and one to act
    drive(chair, STOP, 30)
    assert chair.v == 0.0
    assert 9.0 - (chair.y + 0.8) > 0.0
    assert gap_m < speed * 0.5 + speed**2 / 3.0 + speed * 0.19 + 0.25


def told_of_edges(edge_m: float) -> StreetGrid:
    """The strip with its northern kerb told of, and moved to `edge_m`, between two middles of cells."""
    grid = STREET.grid
    rows, cols = grid.height_cm.shape
    y_m = grid.origin_W_m[1] + grid.cell_m * (np.arange(rows) + 0.5)
    far_cm = np.floor(np.clip(100.0 * np.abs(y_m - edge_m), 0.0, 80.0))
    column = np.where(y_m < edge_m, AT_EDGE - 1 - far_cm, AT_EDGE + far_cm)
    return replace(grid, edge_cm=np.repeat(column[:, None], cols, axis=1).astype(np.uint8))


def test_an_edge_is_known_to_two_centimetres_where_a_kerb_cuts_a_cell():
    """From how far, in centimetres, a chair may back towards a kerb, wherever that lies between middles of cells."""
    firsts = []
    for edge_m in (3.96, 4.0, 4.04):
        grid = told_of_edges(edge_m)
        oracle = oracle_of(grid)
        found = [oracle.assess(plant(20.0, edge_m + 0.01 * cm, UP), BACKWARDS, ()).danger for cm in range(10, 80)]
        firsts.append(found.index(False))
        assert firsts[-1] > 0 and not any(found[firsts[-1] :])
    assert max(firsts) - min(firsts) <= 2


def test_casters_swing_outwards_in_a_turn():
    """Turned on the spot before an edge, a trailing caster leaves its place behind the swivel, and the pavement."""
    edge_m = 4.0  # the pavement is north of it
    grid = told_of_edges(edge_m)
    fixed = USUAL_WHEELS_M * (1.0, 1.0, 0.0)
    least_m = []
    for wheels in (USUAL_WHEELS_M, fixed):
        oracle = oracle_of(grid, wheels=wheels)
        away_m = edge_m + np.arange(0.44, 0.64, 0.01)
        found = [oracle.assess(plant(20.0, y_m, DOWN), Joystick(1.0, 0.0), ()).danger for y_m in away_m]
        least_m.append(away_m[found.index(False)] - edge_m)
    assert 0.02 < least_m[0] - least_m[1] < 0.08


def test_a_chair_that_stands_on_both_sides_of_a_kerb_may_drive_along_it():
    """Its right wheels are on the road; of a chair that is level they hang, and fall."""
    level = replace(plant(20.0, 4.0, 0.0, 0.5), p_WB_m=np.array([20.0, 4.0, KERB_M]))
    roll_rad = math.atan2(KERB_M, USUAL_WHEELS_M[0][1] - USUAL_WHEELS_M[1][1])
    leans = replace(
        level,
        p_WB_m=np.array([20.0, 4.0, 0.5 * KERB_M]),
        q_WB=np.array(quaternion_from_ypr(0.0, 0.0, roll_rad)),
        roll_rad=roll_rad,
    )
    assert ORACLE.assess(level, FORWARD, ()).danger
    assert not ORACLE.assess(leans, FORWARD, ()).danger


def test_safe_actions_in_front_of_a_wall():
    safe = safe_actions(plant(60.0, 7.4, UP, 0.5), ())
    assert not safe[ON]
    assert safe[STAY]
    assert safe[BACK]
    assert safe.shape == (81,) and safe.dtype == np.bool_


def test_a_thin_pole_is_solid():
    assert danger(22.8, 6.7, 0.0, 1.3)
    assert not danger(22.8, 5.9, 0.0, 1.3)
    assert danger(25.6, 6.7, 0.0, 0.0, BACKWARDS)  # behind


@pytest.mark.parametrize(
    "y, yaw, v, expected",
    [
        (6.3, DOWN, 0.5, False),
        (5.3, DOWN, 1.3, True),  # off the kerb
        (2.6, UP, 1.0, True),  # into it
        (1.0, UP, 0.5, False),
        (4.6, 0.0, 1.3, False),  # along it, on the pavement's own slope of 1:12
        (4.6, -0.35, 1.3, True),  # drifts off it
        (5.5, 0.0, 1.67, False),
    ],
)
def test_kerbs(y, yaw, v, expected):
    assert danger(15.0, y, yaw, v) == expected


def test_standing_at_the_kerb_is_no_danger():
    assert not danger(15.0, 4.7, DOWN, 0.0, STOP)


def test_ramps_and_crossing_are_free():
    for x in np.arange(30.0, 50.0, 0.5):
        assert not danger(float(x), 5.0, 0.0, 1.3), x
    for y in np.arange(6.0, -6.5, -0.25):
        assert not danger(40.0, float(y), DOWN, 1.3), y


def test_moving_others():
    def cyclist(x, y=5.5, yaw=math.pi, v=5.0):
        return actor(ActorKind.BICYCLE, x, y, yaw, v)

    assert meets(cyclist(13.0))
    assert not meets(cyclist(25.0))
    assert not meets(cyclist(13.0, yaw=0.0))  # drives away
    assert meets(cyclist(7.0, 1.5, UP, 4.0))  # from the side
    assert not meets(cyclist(8.0, 1.5, UP, 4.0), v=0.0, stick=STOP)  # passes before a standing chair
    safe = safe_actions(plant(5.0, 5.5, 0.0, 1.0), (cyclist(7.3, 2.3, UP, 3.0),))
    assert safe[STAY] and not safe[ON]


def test_following_a_walker_is_no_danger_and_a_standing_one_is():
    for other, expected in ((walker(7.0, 5.5, 0.0, 1.3), False), (walker(6.7, 5.5), True)):
        assert meets(other, v=1.2, stick=Joystick(0.0, 0.72)) is expected


def test_passing_somebody_at_arms_length_is_free():
    beside = 5.5 + 0.31 + 0.25 + 0.12
    assert not meets(walker(7.0, beside))
    assert meets(walker(7.0, beside - 0.1))


def test_an_actor_on_a_bridge_is_elsewhere():
    above = car(7.0, 5.5)
    above.p_W_m[2] = 6.0
    assert not meets(above)


def test_who_touches_already_may_leave():
    near = plant(60.0, 9.0 - 0.8 - 0.02, UP)  # the footplate 2 cm from the wall
    safe = safe_actions(near, ())
    assert safe[BACK] and not safe[ON]


def test_clearance():
    assert clearance(plant(60.0, 7.2, UP), ()) == pytest.approx(1.0, abs=0.1)
    person = walker(5.0 + 0.8 + 0.25 + 0.7, 5.5)
    assert clearance(plant(5.0, 5.5, 0.0), (person,)) == pytest.approx(0.7)
    corner = actor(ActorKind.BICYCLE, 5.8 + 0.9 + 0.3, 5.81 + 0.325 + 0.4)
    assert clearance(plant(5.0, 5.5, 0.0), (corner,)) == pytest.approx(0.5)
    assert clearance(plant(5.0, 5.5, 0.0), (car(6.0, 5.5),)) == 0.0
    assert clearance(plant(-15.0, 5.5, 0.0), ()) > 20.0


def free_ticks(user, sim):
    """Whether the oracle finds no danger, in each tick of a user's way alone."""
    free = []
    while not user.arrived and sim.time_s < 60.0:
        sim.tick()
        free.append(not ORACLE.assess(sim.chair.plant(), user.joystick, ()).danger)
    return free


@pytest.mark.parametrize("name", ["competent", "tremor", "inattentive"])
def test_driving_along_an_empty_pavement_is_free(name):
    user = make_user(name, street=STREET)
    sim = Sim(user, straight_route(), Chair(x=0.3, y=5.5))
    assert np.mean(free_ticks(user, sim)) >= 0.98


def test_crossing_a_road_on_its_ramps_is_free():
    user = make_user()
    sim = Sim(user, polyline((30, 5.5), (40, 5.5), (40, -5.5), (50, -5.5)), Chair(x=30.0, y=5.5))
    free = free_ticks(user, sim)
    assert user.arrived and np.mean(free) >= 0.95


def test_mirrored_streets_give_mirrored_answers():
    """On the open crossing the answer for (x, y) and (-x, y) is the same."""
    safe = safe_actions(plant(40.0, 1.5, DOWN, 1.0), (walker(40.0, -1.0),))
    np.testing.assert_array_equal(safe, safe[ACTIONS.mirror])


def test_shaping_is_the_drives():
    chair = ChairConfig(deadband=0.1, shape_exponent=2.0)
    got = shape_joysticks(np.array([[0.0, 0.05], [0.0, 0.55], [3.0, 4.0], [1.0, -1.0]]), chair)
    np.testing.assert_allclose(got, [[0, 0], [0, 0.25], [0.6, 0.8], [math.sqrt(0.5), -math.sqrt(0.5)]], atol=1e-12)


def test_the_oracle_is_quick():
    rng = np.random.default_rng(0)
    people = [walker(*rng.uniform((0, 2), (10, 9)), float(rng.uniform(-3, 3)), 1.2, str(i)) for i in range(20)]
    state = plant(23.0, 6.2, 0.2, 1.3)
    assert multiple(lambda: ORACLE.assess(state, FORWARD, people)) < 40  # about 7


def test_a_wider_and_longer_chair_has_less_room():
    outline = replace(USUAL_OUTLINE, width_m=0.9, length_m=1.4)
    large = oracle_of(outline=outline)
    beside_the_house, beside_the_pole = plant(60.0, 8.4, 0.0, 0.0), plant(22.8, 6.14, 0.0, 1.3)
    lost_m = clearance(beside_the_house, ()) - large.assess(beside_the_house, STOP, ()).clearance_m
    assert lost_m == pytest.approx(0.14, abs=0.06)
    assert not ORACLE.assess(beside_the_pole, FORWARD, ()).danger
    assert large.assess(beside_the_pole, FORWARD, ()).danger


def test_a_label_keeps_a_margin_of_a_wall_and_who_is_near_may_leave():
    def failing(gap_m, yaw, stick=(0.0, 1.0), v=1.0):
        there = plant(60.0, 9.0 - 0.5 * USUAL_OUTLINE.width_m - gap_m, yaw, v)
        label = ORACLE.reassess(there, (), frozenset(), (), 0.0, {}, 1.0)
        metric = ORACLE.assess(there, STOP, ()).first_s
        return [bool(np.isfinite(first_s[ACTIONS.nearest(stick)])) for first_s in (label, metric)]

    along = [failing(gap_m, 0.04) for gap_m in (0.16, 0.3)]  # it comes nearer
    assert along == [[True, False], [False, False]]
    away = [failing(gap_m, 0.0, (0.5, 1.0)) for gap_m in (0.05, 0.1, 0.15)]
    assert [*away, failing(0.02, 0.0)] == 4 * [[False, False]]


def test_in_hindsight_it_knows_who_cut_in_and_what_appeared():
    chair = plant(5.0, 5.5, 0.0, 1.3)
    beside, ahead = (replace(walker(x, y), kind=ActorKind.BICYCLE) for x, y in ((6.4, 7.2), (7.4, 5.8)))

    def first_s(*later, ids=frozenset({beside.id})):
        named = {other.id: other for other in later}
        return ORACLE.reassess(chair, (beside,), ids, (), 0.0, named, 1.0)[[ON, BACK]]

    assert np.isinf(first_s(beside)).all()
    assert np.isfinite(first_s(replace(ahead, id=beside.id))).tolist() == [True, False]
    door = replace(ahead, id="door")
    assert np.isfinite(first_s(beside, door)).tolist() == [True, False]
    cuts = replace(door, p_W_m=np.array([7.0, 5.8, 0.0]), v_W_mps=np.array([0.0, -2.0, 0.0]))
    assert first_s(beside, cuts)[0] > 0.8, "it comes from the side, and was not ahead from the first"
    both = {beside.id, door.id}
    assert np.isinf(first_s(beside, door, ids=both)).all(), "it was there, and no camera had shown it"


def test_casters_behind_feel_kerbs_too():
    behind = np.concatenate([USUAL_WHEELS_M, [(-0.40, 0.25, 0.0), (-0.40, -0.25, 0.0)]])
    outline = replace(USUAL_OUTLINE, middle_x_m=0.0)
    mid = oracle_of(outline=outline, wheels=behind, rims=np.zeros((0, 3)))  # a high frame
    above_the_kerb = plant(15.0, 4.55, UP, 0.0)  # the road is behind
    assert not ORACLE.assess(above_the_kerb, BACKWARDS, ()).danger
    assert mid.assess(above_the_kerb, BACKWARDS, ()).danger


def test_the_footplate_meets_a_kerb_before_any_wheel_does():
    creeping = Joystick(0.0, 0.3)
    for gap_m, expected in ((0.05, True), (0.6, False)):
        assert danger(15.0, 4.0 - 0.8 - gap_m, UP, 0.0, creeping) is expected
    assert not danger(40.0, 4.0 - 0.8 - 0.05, UP, 0.0, creeping)  # where the kerb is lowered it passes over
    over = plant(15.0, 4.0 - 0.7, UP)  # one that stands over the kerb may leave
    safe = safe_actions(over, ())
    assert safe[STAY] and safe[BACK]


def test_a_kerb_behind_stops_the_wheels_and_is_no_danger():
    assert not danger(15.0, 3.2, DOWN, 0.0, BACKWARDS)


def test_a_wheel_that_hangs_over_an_edge_is_falling_whatever_the_stick_says():
    hanging = replace(plant(15.0, 3.95, UP, -0.6), p_WB_m=np.array([15.0, 3.95, 0.12]))
    assert not safe_actions(hanging, ()).any()


LATE = (FORWARD,) * 2  # a delay of two ticks, the stick held


def test_a_wall_is_seen_earlier_by_who_is_obeyed_late():
    """With two commands waiting the answer is that of the moment in which they have been driven."""
    chair = Chair(x=60.0, y=4.5, yaw=UP, v=1.25)
    while not ORACLE.assess(chair.plant(), FORWARD, (), LATE).danger:
        assert not ORACLE.assess(chair.plant(), FORWARD, ()).danger
        drive(chair, FORWARD, 1)
    drive(chair, FORWARD, 1)
    assert not ORACLE.assess(chair.plant(), FORWARD, ()).danger
    drive(chair, FORWARD, 2)
    assert ORACLE.assess(chair.plant(), FORWARD, ()).danger


def test_waiting_commands_are_driven_before_any_other():
    """What they lead into, no action mends; what they lead away from is no danger."""
    close, far = plant(60.0, 8.0, UP, 0.8), plant(60.0, 5.0, UP, 0.8)
    doomed = ORACLE.assess(close, STOP, (), (Joystick(0.0, 1.0),) * 5)
    assert doomed.danger and len(set(doomed.first_s)) == 1 and doomed.first_s[0] <= 0.5
    assert not ORACLE.assess(far, STOP, (), (FORWARD,) * 5).danger
    once = ORACLE.assess(far, FORWARD, (), (STOP,) * 10)
    at_rest = ORACLE.assess(plant(60.0, 5.0 + 0.3, UP), FORWARD, ())
    assert once.danger == at_rest.danger
    assert np.isinf(once.first_s[STAY])


def test_seconds_count_from_now():
    standing = plant(60.0, 8.15, UP)
    now, late = (ORACLE.assess(standing, FORWARD, (), waiting).first_s for waiting in ((), (STOP,) * 3))
    failing = np.isfinite(now)
    assert failing.any() and not failing.all()
    np.testing.assert_allclose(late[failing], now[failing] + 0.3, atol=1e-9)
    np.testing.assert_array_equal(np.isfinite(late), failing)


@pytest.mark.parametrize("tick_s, steps", [(0.1, 4), (0.05, 2), (0.02, 1), (0.25, 10)])
def test_a_waiting_command_lasts_a_tick(tick_s, steps):
    rolled = oracle_of(tick_s=tick_s)._steps((FORWARD, STOP))
    assert rolled.shape == (steps, 2)
    assert (rolled[: (steps + 1) // 2, 1] > 0.5).all() and (rolled[(steps + 1) // 2 :] == 0.0).all()


def test_others_come_nearer_while_commands_wait():
    """A car that reaches the chair only after three seconds of waiting is among those that are looked at."""
    standing, others = plant(40.0, 0.0, UP), (car(40.0 - 36.0, 0.0, 0.0, 11.0),)
    assert not ORACLE.assess(standing, STOP, others).danger
    late = ORACLE.assess(standing, STOP, others, (Joystick(1.0, 0.0),) * 10 + (Joystick(-1.0, 0.0),) * 20)
    assert late.danger and 2.5 < late.first_s.max() < 3.5


def test_a_long_wait_leaves_as_long_a_look_at_what_comes_after_it():
    """Somebody stands where the chair, told to stop after 3.8 s, comes to rest."""
    chair = plant(5.0, 5.5, 0.0, 1.25)
    stood = [walker(5.0 + ahead_m, 5.5) for ahead_m in np.arange(4.0, 9.0, 0.05)]
    fails_s = [ORACLE.assess(chair, STOP, (one,), (FORWARD,) * 38).first_s[STAY] for one in stood]
    reached_s = [later_s for later_s in fails_s if np.isfinite(later_s)]
    assert max(reached_s) > 4.2 and len(reached_s) < len(fails_s)
    assert reached_s == sorted(reached_s)


WALL_Y_M = 9.0


def overlap_m(chair: Chair) -> float:
    """How deep the chair's rectangle is in the house; below 0 how far from it."""
    outline = USUAL_OUTLINE
    ahead = [outline.middle_x_m + side * 0.5 * outline.length_m for side in (1, -1)]
    reach_m = max(x * math.sin(chair.yaw) for x in ahead) + 0.5 * outline.width_m * abs(math.cos(chair.yaw))
    return chair.y + reach_m - WALL_Y_M


@pytest.mark.parametrize("wish", [(0.0, 1.0), (-0.5, 0.9), (0.5, 0.9), (-1.0, 0.0), (1.0, 0.0)])
@pytest.mark.parametrize("yaw", [UP, UP - 0.5, 0.3, 0.0])
@pytest.mark.parametrize("gap_m", [0.3, 0.05, 0.02, 0.0])
def test_fifty_choices_beside_a_wall_lead_no_step_into_it(gap_m, yaw, wish):
    """The user presses on; no choice may be a little deeper than the one before, corners that swing included."""
    chair = Chair(x=60.0, y=0.0, yaw=yaw)
    chair.y = -gap_m - overlap_m(chair)
    distances = np.hypot(*(ACTIONS.points - np.array(wish)).T)
    for _ in range(50):
        first_s = ORACLE.assess(chair.plant(), Joystick(*wish), ()).first_s
        drive(chair, Joystick(*ACTIONS.points[np.where(first_s == first_s.max(), distances, np.inf).argmin()]), 1)
        assert overlap_m(chair) < 0.01


@pytest.mark.parametrize("deep_m", [0.02, 0.05])
def test_who_is_in_a_wall_by_the_raster_gets_no_deeper_and_may_leave(deep_m):
    """A raster is coarse: a chair that stands beside a thing may be in it by the raster."""
    for yaw in (0.0, UP):
        chair = Chair(x=60.0, y=0.0, yaw=yaw)
        chair.y = deep_m - overlap_m(chair)
        safe = safe_actions(chair.plant(), ())
        assert safe[STAY]
        assert safe[BACK]
        for _ in range(50):
            safe = safe_actions(chair.plant(), ())
            inwards = Joystick(0.0, 0.25) if yaw == UP else Joystick(-0.25, 0.25)
            drive(chair, inwards if safe[ACTIONS.nearest((inwards.x, inwards.y))] else STOP, 1)
            assert overlap_m(chair) < deep_m + 0.03


def test_asked_once_more_it_says_what_it_would_say_of_those_alone():
    ahead, behind = walker(7.2, 5.5), walker(4.1, 5.5, name="b")
    far = car(60.0, 0.0, name="far")
    state = plant(5.0, 5.5, 0.0, 0.8)
    for known in ((), (ahead,), (behind,), (ahead, behind), (far,), (ahead, behind, far)):
        said = ORACLE.assess(state, FORWARD, (ahead, behind, far), LATE, known)
        alone = ORACLE.assess(state, FORWARD, known, LATE)
        assert said.visible is not None and alone.visible is None
        assert said.visible.danger == alone.danger
        np.testing.assert_array_equal(said.visible.first_s, alone.first_s)
        np.testing.assert_array_equal(said.first_s, ORACLE.assess(state, FORWARD, (ahead, behind), LATE).first_s)


def test_who_brakes_softly_is_in_danger_from_as_far_as_it_rolls():
    post_m, full = 25.0, Joystick(0.0, 1.0)
    here = plant(post_m - 0.8 - 5.2, 6.7, 0.0, 1.67)
    assert SOFT.assess(here, full, ()).danger and not ORACLE.assess(here, full, ()).danger
    assert not SOFT.assess(plant(post_m - 0.8 - 6.5, 6.7, 0.0, 1.67), full, ()).danger


def test_a_car_that_comes_while_a_soft_brake_still_slows_the_chair_down_is_seen():
    here, full = plant(0.0, 5.5, 0.0, 1.67), Joystick(0.0, 1.0)
    others = (car(5.4 + 0.8, 5.5 + 45.0, DOWN, v=9.0),)  # it crosses the way in 5 s
    assert SOFT.assess(here, full, others).danger and not ORACLE.assess(here, full, others).danger
