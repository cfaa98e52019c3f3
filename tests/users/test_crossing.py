"""Crossings on a route, their lights, and vehicles that come."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.samples import USUAL_OUTLINE, strip_street, strip_walk
from tests.users.actors import actor, car, make_user, user_view
from tests.users.kinematics import Chair, Sim, polyline
from wcsim.core.seeding import make_rng
from wcsim.types import ActorKind, Route, SignalState, Street, WalkGraph
from wcsim.users.crossing import CrossingStopPlanner, _has_conflict, _has_light, find_route_crossings, is_red
from wcsim.users.route_line import RoutePolyline

STREET = strip_street()


def walk(tls_id="", links=()) -> WalkGraph:
    plain = strip_walk()
    return replace(plain, edges=(*plain.edges[:4], replace(plain.edges[4], tls_id=tls_id, tls_links=links)))


def over_the_road() -> Route:
    """Along the north pavement, over the crossing at x = 40, along the south pavement."""
    bare = polyline((30, 5.5), (40, 5.5), (40, 4), (40, -4), (40, -5.5), (50, -5.5))
    x, y = bare.points_W_m.T
    on_road = (x == 40) & (y <= 4) & (y > -4)
    return replace(bare, edge_index=np.where(on_road, 4, np.where(y > 0, 0, 3)).astype(np.int32))


def lit(street: Street) -> Street:
    return replace(street, walk=walk("t", (1, 2)))


ROUTE = over_the_road()
(ROAD,) = find_route_crossings(ROUTE, walk("t", (1, 2)))


def stops(found=(ROAD,), route=ROUTE, ground=None, law_share=1.0, seed=0) -> CrossingStopPlanner:
    rng = make_rng(seed, "user")
    return CrossingStopPlanner(found, RoutePolyline(route), ground, law_share, rng, USUAL_OUTLINE.half_lw_m[0])


def crossed(
    signals=lambda t: (), others=lambda t: (), street=STREET, name="competent", seed=0, seconds=60.0, **changes
):
    """A drive over the road while others come and go; and (time, y of the chair's middle) each tick."""
    user = make_user(name, seed, street, **{"see_share": 1.0, "law_share": 1.0, **changes})
    sim, log = Sim(user, ROUTE, Chair(x=32.0, y=5.5)), []
    while sim.goes_on(seconds):
        sim.actors, sim.signals = others(sim.time_s), signals(sim.time_s)
        sim.tick()
        log.append((sim.time_s, sim.track.xy[-1][1]))
    return sim, np.array(log)


def test_the_crossing_is_found_where_it_is():
    assert (ROAD.start_m, ROAD.end_m) == pytest.approx((11.5, 19.5))
    assert ROAD.start_W_m == pytest.approx((40.0, 4.0)) and ROAD.end_W_m == pytest.approx((40.0, -4.0))
    assert (ROAD.tls_id, ROAD.tls_links) == ("t", (1, 2))
    assert find_route_crossings(replace(ROUTE, edge_index=np.zeros(len(ROUTE.arc_m), np.int32)), walk()) == ()


@pytest.mark.parametrize(
    "colours, red, light",
    [("rGGr", False, True), ("GrrG", True, True), ("GGrG", True, True), ("ggyg", True, True), ("oooo", False, False)],
)
def test_lights(colours, red, light):
    signals = (SignalState(tls_id="other", colours="rrrr"), SignalState(tls_id="t", colours=colours))
    assert is_red(ROAD, signals) == red
    assert _has_light(ROAD, signals) == light


def test_without_a_light_nothing_is_red():
    (bare,) = find_route_crossings(ROUTE, walk())
    signals = (SignalState(tls_id="", colours="rrr"), SignalState(tls_id="t", colours="rrr"))
    assert not is_red(bare, signals) and not _has_light(bare, signals)
    assert not is_red(ROAD, ())


@pytest.mark.parametrize(
    "vehicle, conflict",
    [
        (car(20.0, -2.0, v=10.0), True),  # on it in 1.5 s
        (car(0.0, 2.0, v=10.0), True),  # in 3.5 s, when the chair is in that lane
        (car(-35.0, 2.0, v=10.0), False),  # in 7 s, when the chair has left it
        (car(-20.0, -2.0, v=10.0), True),  # in 5.5 s, when the chair is in the far lane
        (car(-110.0, -2.0, v=10.0), False),  # in 14.5 s
        (car(50.0, -2.0, v=10.0), False),  # has passed
        (car(60.0, 2.0, yaw=math.pi, v=10.0), True),
        (car(30.0, -2.0, v=0.0), False),  # stands
        (car(20.0, 12.0, v=10.0), False),  # another road
        (car(40.0, 0.0, v=8.0), True),  # is on it
    ],
)
def test_vehicles(vehicle, conflict):
    assert _has_conflict(ROAD, (vehicle,)) == conflict


@pytest.mark.parametrize("colours, from_m, waits", [("rGGr", 28.0, False), ("rGGr", 22.0, True), ("oooo", 28.0, True)])
def test_at_green_those_far_away_have_red_and_are_not_waited_for(colours, from_m, waits):
    here = stops()
    red, now = (SignalState(tls_id="t", colours="GrrG"),), (SignalState(tls_id="t", colours=colours),)
    assert here.stop_m(10.6, 59.9, red, ()) is not None
    coming = car(40.0 - from_m, -2.0, v=10.0)
    assert (here.stop_m(10.6, 60.0, now, (coming,)) is not None) == waits


def test_whether_a_light_is_obeyed_is_independent_of_the_way_to_it():
    """Of two drives of one seed, one corrected its stick (which draws as well) more often than the other."""

    def obeyed(seed, looks_before):
        user = make_user("ataxic", seed, lit(STREET), law_share=0.5)
        user.follow(polyline((0, 5.5), (60, 5.5)))
        for i in range(looks_before):
            user.look(user_view(ROUTE, 0.5 * i, (5.0, 5.5, 0.0), 0.5))
        user.follow(ROUTE)
        user.look(user_view(ROUTE, 100.0, (40.0, 6.0, -0.5 * math.pi), 0.5))
        return user.obeys[ROAD]

    answers = []
    for seed in range(12):
        answers.append({obeyed(seed, looks) for looks in (0, 1, 2, 7)})
        assert len(answers[-1]) == 1
    assert answers.count({True}) * answers.count({False}) > 0


def test_each_crossing_of_a_route_has_a_draw_of_its_own_whichever_is_reached():
    far = replace(ROAD, start_m=60.0, end_m=68.0)
    for seed in range(12):
        both, one = (stops((ROAD, far), law_share=0.5, seed=seed) for _ in range(2))
        for here, places_m in ((both, (10.6, 59.0)), (one, (59.0,))):
            for arc_m in places_m:
                here.stop_m(arc_m, 1.0, (), ())
        assert (len(both.obeys), len(one.obeys)) == (2, 1) and both.obeys[far] == one.obeys[far]


# --- riders ---


@pytest.mark.parametrize("kind", [ActorKind.BICYCLE, ActorKind.SCOOTER])
@pytest.mark.parametrize(
    "x, y, yaw, v, waits",
    [
        pytest.param(30.0, -2.0, 0.0, 5.0, True, id="on the road"),
        pytest.param(50.0, 3.5, math.pi, 5.0, True, id="at its edge"),
        pytest.param(40.0, 2.0, 0.0, 5.0, True, id="over the crossing"),
        pytest.param(30.0, 4.8, 0.0, 5.0, False, id="on the pavement beside the kerb"),
        pytest.param(39.5, 3.0, -0.5 * math.pi, 2.0, False, id="along the crossing"),
        pytest.param(40.5, -3.0, 0.5 * math.pi, 2.0, False, id="along the crossing, towards one"),
        pytest.param(39.5, 3.0, 0.0, 0.0, False, id="stands on it"),
    ],
)
def test_riders_on_the_road_are_waited_for(kind, x, y, yaw, v, waits):
    here = stops(find_route_crossings(ROUTE, walk()), ground=STREET.grid)
    assert (here.stop_m(10.6, 1.0, (), (actor(kind, x, y, yaw, v),)) is not None) == waits


def row(t, y, v, from_m):
    """Cyclists who ride to the east, one behind the other."""
    return tuple(actor(ActorKind.BICYCLE, x + v * t, y, 0.0, v, str(x)) for x in from_m)


@pytest.mark.parametrize("from_m", [-28.0, -31.0])
def test_lets_a_cyclist_pass_that_would_get_too_near(from_m):
    def away_s(law_share):
        sim, log = crossed(others=lambda t: row(t, -2.0, 4.0, (from_m,)), law_share=law_share)
        assert sim.user.arrived
        return np.abs(log[np.abs(log[:, 1] + 2.0) < 0.57 + 0.4, 0] - (40.0 - from_m) / 4.0).min()

    assert away_s(1.0) > 1.5 > away_s(0.0)


@pytest.mark.parametrize(
    "riders",
    [
        pytest.param(lambda t: row(t, 4.7, 5.0, range(-100, 40, 8)), id="on the pavement beside the kerb"),
        pytest.param(lambda t: row(t, -5.0, 5.0, range(-200, 40, 8)), id="on the far pavement"),
        pytest.param(
            lambda t: tuple(
                actor(ActorKind.BICYCLE, 41.0, 15.0 - (2.0 * t + gap) % 30.0, -0.5 * math.pi, 2.0, str(gap))
                for gap in (0, 10, 20)
            ),
            id="over the same crossing",
        ),
        pytest.param(lambda _: (actor(ActorKind.BICYCLE, 37.0, -2.0),), id="stands in the road"),
    ],
)
def test_no_user_waits_for_riders_that_are_no_traffic(riders):
    """Who keeps to the law drives as who does not: what is left is going around."""
    sim, log = crossed(others=riders)
    heedless, as_if_alone = crossed(others=riders, law_share=0.0)
    assert sim.user.arrived and heedless.user.arrived
    assert np.array_equal(log, as_if_alone)
