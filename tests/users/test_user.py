"""The user in a small kinematic world: keeps its line, goes around, waits, gives up, and is the same twice."""

import math
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from tests.supervisor.test_oracle import clearance
from tests.support.samples import USUAL_OUTLINE, straight_route
from tests.users.actors import actor, car, make_user, walker
from tests.users.kinematics import Chair, Sim, lateral, polyline
from tests.users.test_crossing import ROUTE, STREET, crossed, lit, stops
from wcsim.config import ChairConfig
from wcsim.core.joystick import raw_radius_from_shaped, shape_joystick
from wcsim.core.seeding import make_rng
from wcsim.errors import ConfigError
from wcsim.types import ActorKind, Joystick, SignalState
from wcsim.users.avoidance import PredictedChairPose
from wcsim.users.crossing import find_route_crossings
from wcsim.users.profiles import find_builtin_profile, list_profile_names, sample_profile
from wcsim.users.route_line import RoutePolyline
from wcsim.users.user import SimulatedUser, plan_stick_to_goal

CORNERS = polyline((0, 0), (20, 0), (20, 15), (40, 15), step_m=2.0)
cross = partial(crossed, street=lit(STREET), seconds=70.0)


def on_pavement(*who, quantised=False, x=0.3, **user) -> Sim:
    return Sim(make_user(*who, **user), straight_route(), Chair(x=x, y=5.5), quantised)


def nearest(sim: Sim, seconds: float, actors) -> float:
    """Run with actors that are a function of time; the least distance to them."""
    least = math.inf
    while sim.goes_on(seconds):
        sim.actors = actors(sim.time_s)
        sim.tick()
        least = min(least, clearance(sim.chair.plant(), actors(sim.time_s)))
    return least


# --- the line ---


@pytest.mark.parametrize("quantised", [False, True])
def test_the_competent_user_holds_its_line_around_corners(quantised):
    for seed in range(3):
        rng = make_rng(seed, "user")
        user = SimulatedUser(sample_profile(find_builtin_profile("competent"), rng), rng, ChairConfig(), USUAL_OUTLINE)
        sim = Sim(user, CORNERS, Chair(), quantised)
        off = lateral(sim.run(90.0).array(), CORNERS)
        assert user.arrived
        assert math.sqrt((off**2).mean()) < 0.15
        assert off.max() < 0.42


def test_a_straight_is_driven_straight_at_the_desired_speed():
    sim = on_pavement()
    track = sim.run(40.0)
    cruising = slice(60, 350)
    assert np.mean(track.speed[cruising]) == pytest.approx(0.8 * 1.67, abs=0.06)
    assert np.abs(np.array(track.xy)[cruising, 1] - 5.5).max() < 0.1
    # No swinging: what is left of the turn rate is the hand's wander, and it does not come back as a rhythm.
    assert np.std(track.yaw_rate[cruising]) < 0.06


@pytest.mark.parametrize("name", list_profile_names())
def test_every_profile_gets_around_the_corners(name):
    arrived = 0
    for seed in range(3):
        sim = Sim(make_user(name, seed), CORNERS, Chair(), quantised=True)
        track = sim.run(140.0)
        arrived += sim.user.arrived
        assert max(math.hypot(j.x, j.y) for j in track.sticks) <= 1.0 + 1e-9
        if name != "inattentive":  # who looks away in a corner may leave the street: that is what the agent is for
            assert math.sqrt((lateral(track.array(), CORNERS) ** 2).mean()) < 0.5
    assert arrived >= (2 if name == "inattentive" else 3)


@pytest.mark.parametrize("lane_m", [-0.6, -0.3, 0.0, 0.6])
def test_on_the_inside_of_a_hairpin_the_user_looks_farther_along(lane_m):
    user = make_user()
    route = polyline((0, 0), (10, 0), (4, 5), step_m=0.5)
    user.follow(route)
    user._lanes.offset_m = -lane_m
    path = RoutePolyline(route)
    for arc_m in np.arange(7.0, 12.0, 0.1).tolist():
        x, y = path.at(arc_m)
        for yaw_rad in np.arange(0.0, 6.2, 0.3).tolist():
            half_m = USUAL_OUTLINE.half_lw_m
            body = PredictedChairPose(
                x_m=x, y_m=y, yaw_rad=yaw_rad, speed_mps=0.0, arc_m=arc_m, left_m=0.0, half_m=half_m
            )
            goal, axle = user._goal(body, path, arc_m + 1.2), user._axle(body)
            assert math.dist(goal, (axle.x_m, axle.y_m)) >= 0.5
            assert path.project(*goal, arc_m + 2.0).arc_m < arc_m + 4.5


def test_profiles_differ_as_they_should():
    def jitter(name):
        sticks = np.array([(j.x, j.y) for j in on_pavement(name).run(25.0).sticks[80:]])
        return np.hypot(*np.diff(sticks, axis=0).T).mean()

    calm, tremor, ataxic = jitter("competent"), jitter("tremor"), jitter("ataxic")
    assert tremor > 5 * calm and ataxic > 2 * calm

    def speed(name):
        return np.mean(on_pavement(name).run(25.0).speed[80:])

    assert speed("slow") < 0.85 * speed("competent")


@pytest.mark.parametrize("y, yaw", [(5.5, math.pi), (5.5, math.pi / 2), (6.8, 0.0), (4.6, -0.8)])
def test_a_user_pushed_away_or_turned_around_returns(y, yaw):
    sim = Sim(make_user(), straight_route(), Chair(x=5.0, y=y, yaw=yaw))
    track = sim.run(25.0)
    assert abs(sim.chair.y - 5.5) < 0.1 and sim.chair.x > 25.0
    assert min(sim.track.xy, key=lambda p: p[1])[1] > 4.4
    assert len(track.xy) > 100


# --- what was noticed ---


@pytest.mark.parametrize("beside_m", [0.0, 0.15, -0.4])
@pytest.mark.parametrize("quantised", [False, True])
def test_goes_around_a_post_it_saw(beside_m, quantised):
    sim = on_pavement(street=STREET, see_share=1.0, quantised=quantised, x=5.0)
    sim.obstacles = np.array([[15.0, 5.5 + beside_m, 0.15]])
    post = replace(walker(15.0, 5.5 + beside_m), size_lwh_m=(0.3, 0.3, 1.0))
    least = math.inf
    while sim.time_s < 25.0:
        sim.tick()
        least = min(least, clearance(sim.chair.plant(), (post,)))
    assert least > 0.08
    assert sim.chair.x > 20.0
    assert abs(sim.chair.y - 5.5) < 0.1


def test_runs_into_a_post_it_missed():
    sim = on_pavement(street=STREET, see_share=0.0, x=8.0)
    sim.obstacles = np.array([[15.0, 5.5, 0.15]])
    sim.run(8.0)
    assert sim.chair.x > 15.0


def test_stops_before_a_post_when_there_is_no_room_and_gives_up():
    sim = on_pavement(see_share=1.0, x=5.0)
    sim.obstacles = np.array([[15.0, 5.5, 0.3]])
    sim.run(60.0)
    assert sim.user.gave_up and not sim.user.arrived
    nose_m = sim.chair.x + 0.8
    assert 13.8 < nose_m < 14.7
    assert sim.user.intent == Joystick(0.0, 0.0)


@pytest.mark.parametrize(
    "actors",
    [
        pytest.param(lambda t: (walker(25 - 1.3 * t, 5.5, math.pi, 1.3),), id="comes towards"),
        pytest.param(lambda t: (walker(6 + 0.6 * t, 5.6, 0.0, 0.6),), id="is slower"),
        pytest.param(lambda t: (walker(12, 1.5 + 0.5 * t, math.pi / 2, 0.5),), id="walks across"),
        pytest.param(lambda t: (actor(ActorKind.WHEELCHAIR, 12, 5.3),), id="wheelchair stands"),
    ],
)
def test_passes_people(actors):
    sim = on_pavement(street=STREET, see_share=1.0)
    assert nearest(sim, 25.0, actors) > 0.1
    assert sim.chair.x > 20.0


@pytest.mark.parametrize(
    "actors",
    [
        pytest.param([walker(12, y, name=str(y)) for y in (4.8, 5.5, 6.2, 6.9)], id="people"),
        pytest.param([car(15, 5.6)], id="car"),
    ],
)
def test_stops_for_a_closed_pavement_and_gives_up(actors):
    sim = on_pavement(street=STREET, see_share=1.0)
    assert nearest(sim, 60.0, lambda _: tuple(actors)) > 0.1
    assert sim.user.gave_up
    assert sim.time_s < 35.0


# --- the road ---


def light(green_from_s):
    return lambda t: (SignalState(tls_id="t", colours="GrrG" if t < green_from_s else "rGGr"),)


RED, GREEN = light(1e9)(0.0), light(0.0)(0.0)


def test_waits_at_red_and_goes_at_green():
    sim, log = cross(light(30.0))
    waiting = log[log[:, 0] < 30.0, 1]
    assert waiting.min() - 0.57 > 4.0  # the footplate stays on the pavement
    assert waiting[-1] < 5.6  # and the user is a metre from it
    assert sim.user.arrived and not sim.user.gave_up
    straight_over, _ = cross(light(0.0))
    assert straight_over.user.arrived and straight_over.time_s < 35.0


def test_a_lawless_user_crosses_at_red():
    _, log = cross(light(1e9), law_share=0.0, seconds=25.0)
    assert log[-1, 1] < 0.0


@pytest.mark.parametrize("away_share", [0.3, 0.6])
def test_a_lawful_user_that_looks_away_never_enters_at_red(away_share):
    """The red comes early or while the chair rolls up to the kerb; 25 s of it, and 25 users who look away."""
    entered = 0
    for seed in range(25):
        red_from_s = 0.2 * seed

        def signals(t, red_from_s=red_from_s):
            return light(25.0 if t >= red_from_s else 0.0)(t)

        _, log = cross(signals, name="inattentive", seed=seed, seconds=25.0, away_share=away_share)
        entered += bool((log[(log[:, 0] >= red_from_s), 1] < 4.0 + 0.57).any())
    assert entered == 0


def test_a_look_away_lets_the_steering_go_and_goes_on_braking():
    sim = on_pavement("inattentive", street=STREET, noise=0.0, see_share=1.0)
    sim.actors = tuple(walker(8.0, y, name=str(y)) for y in (4.5, 5.5, 6.5))
    user = sim.user
    while not 0.0 < user.intent.y < 0.35 or sim.chair.v < 0.6:  # it has seen them, and brakes
        sim.tick()
    user._perception.step_attention = lambda dt_s, calm, heeds: False
    user._intent = Joystick(0.19, user.intent.y)
    held = [user.intent]
    for _ in range(40):
        sim.tick()
        held.append(user.intent)
    assert [stick.x for stick in held[:6]] == pytest.approx([0.19, 0.15, 0.11, 0.07, 0.03, 0.0])
    assert all(stick.x == 0.0 for stick in held[5:]) and abs(sim.chair.w) < 1e-6
    assert all(b.y <= a.y for a, b in pairwise(held)) and held[-1].y < 0.15
    assert sim.chair.v < 0.05 and clearance(sim.chair.plant(), sim.actors) > 0.1


def test_a_chair_that_has_rolled_over_the_line_at_red_waits_there_and_not_in_the_lane():
    here, stop_m = stops(), 11.5 - 0.5675 - 0.3
    assert [here.stop_m(arc_m, 0.0, RED, ()) for arc_m in (4.0, 10.6, 11.4, 12.5)] == pytest.approx([stop_m] * 4)
    assert here.stop_m(12.6, 0.0, RED, ()) is None  # the footplate is beyond the middle of the first lane
    assert here.stop_m(11.0, 0.0, GREEN, ()) is None  # began at green
    assert here.stop_m(11.2, 0.0, RED, ()) is None


@pytest.mark.parametrize("beside_m, before_m", [(2.5, 0.87 + 0.75), (0.5, 0.87 + 3.0)])
def test_along_the_kerb_the_user_waits_before_the_front_can_swing_over_it(beside_m, before_m):
    """The road begins at y = 4; the way runs beside it and turns onto the crossing at x = 40."""
    y = 4.0 + beside_m
    bare = polyline((30, y), (40, y), (40, 4), (40, -4), (40, -5.5), step_m=0.5)
    on_road = (bare.points_W_m[:, 1] <= 4) & (bare.points_W_m[:, 1] > -4)
    route = replace(bare, edge_index=np.where(on_road, 4, np.where(bare.points_W_m[:, 1] > 0, 0, 3)).astype(np.int32))
    stop_m = stops(find_route_crossings(route, lit(STREET).walk), route, STREET.grid).stop_m(4.0, 0.0, RED, ())
    assert stop_m == pytest.approx(10.0 + beside_m - before_m, abs=0.26)


def test_from_afar_after_a_short_green_the_user_moves_up_and_waits_for_the_next_one():
    """A green of 5 s that comes when the chair still has 2.9 m to the kerb: it stops behind it, and goes next time."""
    here = stops()
    assert here.stop_m(8.0, 0.0, RED, ()) is not None
    assert here.stop_m(8.0, 0.1, GREEN, ()) is None  # it may get there
    for age_s in (1.0, 3.0, 5.0):
        assert here.stop_m(8.0, age_s, GREEN, ()) == pytest.approx(11.5 - 0.5675 - 0.3)
    assert here.stop_m(8.0, 6.6, GREEN, ()) is None  # it is a longer one
    assert here.stop_m(10.6, 60.0, RED, ()) is not None
    assert here.stop_m(10.6, 60.1, GREEN, ()) is None  # near enough


def test_at_the_end_of_a_short_green_the_user_never_enters_at_red():
    """Greens of 5 s in every 25 s, which come at any moment of the way to the kerb, at y = 4."""
    entered = []
    for onset_s in np.arange(3.0, 9.0, 0.5).tolist():

        def signals(t, onset_s=onset_s):
            return light(0.0 if (t - onset_s) % 25.0 < 5.0 else 1e9)(t)

        sim, log = cross(signals)
        over = int(np.argmax(log[:, 1] < 4.0 + 0.5675))
        entered.append((log[over, 0] - 0.1 - onset_s) % 25.0)
        assert sim.user.arrived
    assert max(entered) < 5.0


def test_a_lawful_user_watches_a_light_from_just_before_the_kerb():
    here, careless = stops(), stops(law_share=0.0)
    for arc_m, heeds in ((4.0, False), (8.3, False), (8.6, True), (10.9, True), (11.3, False)):
        here.stop_m(arc_m, 0.0, GREEN, ())
        assert here.heeds_light(arc_m) == heeds
    careless.stop_m(10.0, 0.0, GREEN, ())
    assert not careless.heeds_light(10.0)


def test_no_lawful_user_looks_elsewhere_while_driving_towards_a_kerb_with_a_light():
    near = []
    for seed in range(5):
        user = make_user("inattentive", seed, lit(STREET), see_share=1.0, law_share=1.0, away_share=0.9, away_s=5.0)
        sim = Sim(user, ROUTE, Chair(x=32.0, y=5.5))
        sim.signals = GREEN
        while sim.time_s < 60.0 and not user.arrived:
            sim.tick()
            if 9.0 < user.route_progress_m < 10.9:
                near.append(user._perception.attentive)
    assert len(near) > 30 and all(near)


def test_a_lawful_user_waits_at_a_light_that_stays_red_and_at_last_goes_elsewhere():
    sim, log = cross(light(1e9), seconds=250.0)
    assert sim.user.gave_up and sim.time_s > 150.0
    assert log[:, 1].min() - 0.57 > 4.0  # the footplate stays on the pavement


def test_the_wait_at_a_closed_crossing_is_long_but_ends():
    endless = [car(x, -2.0, 0.0, 6.0, name=str(x)) for x in range(0, 81, 8)]
    sim, log = cross(light(1e9), lambda _: endless, seconds=250.0)
    assert sim.user.gave_up and log[:, 1].min() > 4.0
    assert 90.0 < sim.time_s < 200.0


@pytest.mark.parametrize("from_m", [-10.0, -30.0, -66.0])
def test_lets_a_car_pass_that_would_get_too_near(from_m):
    dark = (SignalState(tls_id="t", colours="oooo"),)

    def cars(t):
        return (car(from_m + 6.0 * t, -2.0, 0.0, 6.0),)

    def meeting(law_share):
        """Least distance in time between car and chair on the car's lane."""
        sim, log = cross(lambda _: dark, cars, law_share=law_share)
        assert sim.user.arrived
        in_lane_s = log[np.abs(log[:, 1] + 2.0) < 0.57 + 0.9, 0]
        return np.abs(in_lane_s - (40.0 - from_m) / 6.0).min()

    assert meeting(1.0) > 2.0
    if from_m == -66.0:
        assert meeting(0.0) < 1.0


# --- the episode ---


def test_gives_up_when_held_and_takes_the_next_destination():
    sim = on_pavement()
    for _ in range(50):
        sim.tick()
    sim.frozen, sim.chair.v = True, 0.0
    sim.run(100.0)
    assert sim.user.gave_up
    assert sim.time_s == pytest.approx(5.0 + 15.0, abs=1.0)
    for _ in range(15):
        sim.tick()
    assert math.hypot(sim.user.joystick.x, sim.user.joystick.y) < 0.15
    sim.frozen = False
    sim.user.follow(sim.route)
    assert not sim.user.gave_up and sim.user.route_progress_m == 0.0
    sim.run(120.0)
    assert sim.user.arrived
    assert sim.user.route_progress_m == pytest.approx(80.0, abs=0.6)


def test_the_same_seed_is_the_same_user():
    def sticks(seed):
        sim = on_pavement("ataxic", seed)
        return [(j.x, j.y) for j in sim.run(15.0).sticks]

    assert sticks(4) == sticks(4) != sticks(5)


def test_before_its_first_route_the_user_stands_still():
    user = make_user()
    assert user.joystick == Joystick(0.0, 0.0)
    user.move_hand(2, 0.004)
    assert user.sticks.shape == (2, 2) and np.hypot(*user.sticks.T).max() < 0.05
    assert user.route_progress_m == 0.0 and user.intent == Joystick(0.0, 0.0)


@pytest.mark.parametrize("steps, dt_s", [(24, 0.0), (24, 0.1), (24, math.nan), (0, 0.004)])
def test_an_impossible_step_is_refused(steps, dt_s):
    with pytest.raises(ConfigError, match="at least one"):
        make_user("slow").move_hand(steps, dt_s)


def test_a_user_knows_the_dead_band_and_the_shape_of_its_own_chair():
    body = PredictedChairPose(x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=0.5, arc_m=0.0, left_m=0.0, half_m=(0.57, 0.31))
    for chair in (ChairConfig(), ChairConfig(deadband=0.2), ChairConfig(deadband=0.05, shape_exponent=2.0)):
        stick = plan_stick_to_goal(body, (10.0, 0.0), 0.5, chair, 0.2, 0.0)
        _, out = shape_joystick(stick.x, stick.y, chair.deadband, chair.shape_exponent)
        assert out * chair.v_max_mps == pytest.approx(0.5)
        assert raw_radius_from_shaped(out, chair) == pytest.approx(stick.y)


# --- help ---


def requests_s(ask_share: float, seed: int = 0) -> tuple[list[float], list[Joystick]]:
    """When a user requests help, in front of which a person appears three times, and its stick."""
    sim = on_pavement("slow", seed, STREET, ask_share=ask_share, see_share=1.0)
    times = []
    for _ in range(400):
        ahead = sim.chair.x + 2.6
        appears = [t for t in (8.0, 9.0, 20.0) if t <= sim.time_s < t + 0.3]
        sim.actors = tuple(walker(ahead, 5.5, name=f"p{t}") for t in appears)
        sim.tick()
        if sim.user.requests_help:
            times.append(sim.time_s)
    return times, sim.track.sticks


def test_a_scared_user_requests_help_once_and_its_stick_is_the_same():
    requests, sticks = requests_s(1.0)
    assert requests == [pytest.approx(8.1, abs=0.11), pytest.approx(20.1, abs=0.11)], "one scare in the seconds after 8"
    silent, same = requests_s(0.0)
    assert silent == [] and same == sticks


def test_requests_for_help_are_drawn_from_the_seed():
    found = [requests_s(0.5, seed)[0] for seed in range(6)]
    assert found[:2] == [requests_s(0.5, seed)[0] for seed in range(2)]
    assert 2 < sum(map(len, found)) < 12


def test_a_user_that_sees_in_time_requests_no_help():
    sim = on_pavement(street=STREET, ask_share=1.0)
    sim.actors = (walker(20.0, 5.5),)
    requests = 0
    for _ in range(300):
        sim.tick()
        requests += sim.user.requests_help
    assert requests == 0 and sim.chair.x > 10.0
