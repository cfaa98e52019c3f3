"""What is counted on a carriageway, on a street of 8 m with a crossing at 38 < x < 42 (`tests/support/samples.py`)."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.actors import actor
from tests.support.samples import strip_street
from tests.support.worlds import open_world, push
from wcsim.bridge.ego.crossing_watch import SET_OUT_M, CrossingWatch, OnRoad
from wcsim.towns.street import load_street
from wcsim.types import ActorKind, Joystick, SeatSpec, SignalState, StartSpec, WayKind

HALF_M = 0.5
TICK_S = 0.1
STREET = strip_street()
GRID = STREET.grid


def walk(tls_id="", ends=((40.0, 4.0), (40.0, -4.0))):
    """The sample's walk graph; SUMO's crossings end at the kerbs."""
    graph = STREET.walk
    edges = [
        replace(edge, points_W_m=np.array(ends), width_m=4.0, tls_id=tls_id, tls_links=(1,))
        if edge.kind is WayKind.CROSSING
        else edge
        for edge in graph.edges
    ]
    return replace(graph, edges=tuple(edges))


def chair(x, y, yaw_rad):
    return actor(ActorKind.WHEELCHAIR, x, y, yaw_rad, name="w:0", size=(2 * HALF_M, 0.6, 1.3))


def light(colour):
    return (SignalState(tls_id="t", colours=f"G{colour}"),)


def drive(way, colours="r", graph=None, watch=None, pace_m=0.1):
    """Along a polyline of places; the colour of tick k is `colours[k]`, the last one holds. What was seen in each."""
    watch = watch or CrossingWatch(GRID, graph or walk("t"))
    seen = []
    for a, b in itertools.pairwise(way):
        length_m = math.dist(a, b)
        yaw_rad = math.atan2(b[1] - a[1], b[0] - a[0])
        for share in np.arange(0.0, 1.0, pace_m / max(length_m, pace_m)):
            x, y = (p + share * (q - p) for p, q in zip(a, b, strict=True))
            colour = colours[min(len(seen), len(colours) - 1)]
            seen.append(watch.see(chair(x, y, yaw_rad), TICK_S * len(seen), light(colour)))
    return seen


def crossed(way, **more):
    return sum(moment.crossed for moment in drive(way, **more))


def red_entries(way, **more):
    return sum(moment.entered_red for moment in drive(way, **more))


OVER = ((40.0, 6.0), (40.0, -6.0))


def test_over_the_crossing_and_back_are_two():
    for graph in (walk("t"), walk("t", ends=((40.0, -4.0), (40.0, 4.0)))):
        assert crossed(OVER, graph=graph) == 1
        assert crossed((*OVER, OVER[0]), graph=graph) == 2
    moment = next(moment for moment in drive(OVER) if moment.crossed)
    assert not moment.on_carriageway  # counted when it is off the road again


@pytest.mark.parametrize(
    "way, why",
    [
        (((40.0, 6.0), (40.0, -3.5), (40.0, 6.0)), "back to where it came from"),
        (((30.0, 6.0), (30.0, -6.0)), "not on a crossing"),
        (((30.0, 6.0), (30.0, 0.0), (40.0, 0.0), (40.0, -6.0)), "in beside the crossing"),
        (((40.0, 6.0), (40.0, 0.0), (60.0, 0.0), (60.0, -6.0)), "out beside the crossing"),
        (((40.0, 6.0), (40.0, 0.0), (60.0, 0.0), (40.0, 0.0), (40.0, -6.0)), "away from the crossing meanwhile"),
        (((40.0, -2.0), (40.0, -6.0)), "began on the road"),
        (((0.0, 5.0), (80.0, 5.0)), "along the pavement"),
    ],
)
def test_what_is_no_crossing(way, why):
    assert crossed(way) == 0, why


def test_a_little_beside_the_strip_is_on_the_crossing():
    assert crossed(((42.8, 6.0), (42.8, -6.0))) == 1
    assert crossed(((43.2, 6.0), (43.2, -6.0))) == 0


def test_a_wait_on_the_road_is_seen_and_the_crossing_still_counts():
    watch = CrossingWatch(GRID, walk())
    seen = drive(((40.0, 6.0), (40.0, 1.0)), watch=watch)
    seen += [watch.see(chair(40.0, 1.0, -0.5 * math.pi), 10.0 + TICK_S * k, ()) for k in range(50)]
    assert all(moment == OnRoad(on_carriageway=True) for moment in seen[-50:])
    assert sum(moment.crossed for moment in drive(((40.0, 1.0), (40.0, -6.0)), watch=watch)) == 1


def test_who_passes_the_kerb_line_at_red_and_goes_on_set_out_at_red():
    seen = drive(OVER)
    (k,) = [k for k, moment in enumerate(seen) if moment.entered_red]
    assert 6.0 - 0.1 * k == pytest.approx(4.0 - SET_OUT_M, abs=0.11)  # its middle is beyond the kerb
    assert seen[k].on_carriageway
    assert red_entries(OVER, colours="G") == red_entries(OVER, colours="o") == 0
    assert red_entries(OVER[::-1]) == 1
    assert red_entries(OVER, graph=walk("")) == 0  # no light governs it
    assert red_entries(OVER, colours="G" * 18 + "r") == 0  # it was on the road when the light changed
    assert red_entries(OVER, colours="G" * 14 + "r") == 1
    assert red_entries(OVER, colours="r" * 20 + "G") == 0  # it waited with the footplate out, and went at green


@pytest.mark.parametrize("reached_m", [3.95, 3.6])
def test_who_waits_with_the_footplate_or_its_middle_over_the_kerb_has_not_set_out(reached_m):
    assert red_entries(((40.0, 6.0), (40.0, reached_m), (40.0, 6.0))) == 0


def test_setting_out_at_red_beside_the_crossing_is_not_counted():
    assert red_entries(((30.0, 6.0), (30.0, -6.0))) == 0


def test_a_footplate_that_trembles_over_the_kerb_entered_once():
    tremble = ((40.0, 4.6), *[(40.0, y) for _ in range(6) for y in (4.4, 4.6)], (40.0, 3.4), (40.0, 3.0))
    facing = [replace(chair(x, y, 0.0), yaw_rad=-math.pi / 2) for x, y in tremble]
    watch = CrossingWatch(GRID, walk("t"))
    assert sum(watch.see(at, TICK_S * k, light("r")).entered_red for k, at in enumerate(facing)) == 1
    later = [(facing[0], 10.0), (facing[0], 11.0), (facing[1], 11.1), (facing[-1], 11.2)]  # behind for a second
    assert [watch.see(at, time_s, light("r")).entered_red for at, time_s in later] == [False, False, False, True]


def test_the_crossing_that_the_chair_goes_over_decides():
    """At a corner two crossings begin within reach of one footplate; one has green, the other one red."""
    graph = walk("t")
    (mine,) = (edge for edge in graph.edges if edge.kind is WayKind.CROSSING)
    aside = replace(mine, points_W_m=np.array([(41.0, 4.0), (49.0, 4.0)]), tls_links=(0,))
    both = replace(graph, edges=(*graph.edges, aside))
    assert red_entries(OVER, graph=both) == 1
    green_mine = replace(graph, edges=(replace(mine, tls_links=(0,)), replace(aside, tls_links=(1,))))
    assert red_entries(OVER, graph=green_mine) == 0
    assert red_entries(((40.0, 6.0), (40.0, 3.6), (60.0, 3.6)), graph=both) == 0  # it only swept the corner


def test_a_town_without_crossings():
    bare = replace(walk(), edges=tuple(e for e in walk().edges if e.kind is not WayKind.CROSSING))
    seen = drive(OVER, graph=bare)
    assert not any(moment.crossed or moment.entered_red for moment in seen)
    assert any(moment.on_carriageway for moment in seen)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(36.0, 44.0), st.floats(-6.0, 6.0)), min_size=2, max_size=8))
def test_nobody_crosses_more_often_than_the_sides_change(places):
    way = [(40.0, 5.5), *places]
    seen = drive(way, pace_m=0.17)
    sides, side = 0, 1
    for _, y in way:
        if abs(y) >= 4.0 and (y > 0) != (side > 0):
            side, sides = -side, sides + 1
    assert sum(moment.crossed for moment in seen) <= sides


def test_a_wheelchair_that_crosses_tells_it_once(corner, corner_town):
    """In the world: a careless user drives over a crossing whatever its light shows."""
    street = load_street(corner_town)
    (edge, *_) = (e for e in street.walk.edges if e.kind is WayKind.CROSSING)
    (x0, y0), (x1, y1) = edge.points_W_m[0], edge.points_W_m[-1]
    length_m = math.dist((x0, y0), (x1, y1))
    ux, uy = (x1 - x0) / length_m, (y1 - y0) / length_m
    start = StartSpec(
        p_W_m=(x0 - 2.0 * ux, y0 - 2.0 * uy), yaw_rad=math.atan2(uy, ux), goal_W_m=(x1 + 2.5 * ux, y1 + 2.5 * uy)
    )
    spec = SeatSpec(profile="competent", start=start)
    with open_world(corner, "world.demand_scale=0", spec=spec) as world:
        seen = []
        while not (seen and (seen[-1].arrived or len(seen) > 400)):
            seen.append(push(world, Joystick(0.0, 0.6)).events)
            at_m = float(np.dot(world.seats[0].as_actor().p_W_m[:2] - (x0, y0), (ux, uy)))
            assert seen[-1].on_carriageway == (0.0 < at_m < length_m) or min(abs(at_m), abs(at_m - length_m)) < 0.4
            if at_m > length_m + 1.0:
                break
    assert sum(events.crossed for events in seen) == 1
    assert not any(events.entered_red for events in seen) or edge.tls_id
    assert 0.5 * length_m < 0.1 * sum(events.on_carriageway for events in seen) < 3.0 * length_m
