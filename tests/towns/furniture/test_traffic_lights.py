from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely import MultiPoint, Polygon, box

from tests.towns.furniture.standing_samples import item, signal_net
from wcsim.towns.furniture.placement import FreeGround, StandingObject
from wcsim.towns.furniture.traffic_lights import HEAD_LOW_M, _find_approaches, sign_things, signal_things
from wcsim.towns.ground.surfaces import make_surfaces
from wcsim.towns.sumo.net import Lane, LaneKind, Net

WAYS = ("sidewalk", "crossing", "shared")


@pytest.fixture(scope="module", params=["right", "left"])
def net(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Net:
    return signal_net(tmp_path_factory.mktemp("net"), *(["--lefthand"] if request.param == "left" else []))


def place_of(net: Net) -> FreeGround:
    surfaces = make_surfaces(net, WAYS)
    lines = shapely.MultiLineString([lane.points_m for lane in net.lanes(LaneKind.SIDEWALK)])
    return FreeGround(low=surfaces.low.buffer(0.1), solids=Polygon(), lines=lines, hull=surfaces.hull)


def heads_of(things: list[StandingObject], pedestrian: bool) -> list[tuple[StandingObject, int]]:
    return [(t, i) for t in things for i, head in enumerate(t.heads) if head.pedestrian is pedestrian]


def lane_at(net: Net, link: int) -> Lane:
    start = next(c for c in net.connections if c.tls_id and c.tls_link == link)
    edge = next(edge for edge in net.edges if edge.id == start.start)
    return edge.lanes[start.start_lane]


def test_every_link_of_a_signal_has_a_head_of_its_colour(net: Net) -> None:
    things = signal_things(net, (), place_of(net))
    columns = {tls: [state.lower() for name, state in net.phases if name == tls] for tls, _ in net.phases}
    crossings = {lane.edge_id for lane in net.lanes(LaneKind.CROSSING)}

    def shown(tls: str, link: int) -> str:
        return "".join(state[link] for state in columns[tls])

    heads = [head for thing in things for head in thing.heads]
    for link in net.connections:
        if link.tls_id:
            walks = link.end in crossings
            same = [
                h for h in heads
                if h.tls_id == link.tls_id and h.pedestrian is walks
                and shown(h.tls_id, h.link) == shown(link.tls_id, link.tls_link)
            ]  # fmt: skip
            assert same, link


def test_posts_of_vehicles_stand_at_the_kerb_on_their_side_and_face_them(net: Net) -> None:
    empty = place_of(net)
    found = heads_of(signal_things(net, (), place_of(net)), pedestrian=False)
    assert found
    for thing, i in found:
        head, lane = thing.heads[i], lane_at(net, thing.heads[i].link)
        ahead = lane.points_m[-1] - lane.points_m[-2]
        ahead = ahead / np.hypot(*ahead)
        aside = float(
            ahead[0] * (head.p_W_m - [*lane.points_m[-1], 0])[1] - ahead[1] * (head.p_W_m[0] - lane.points_m[-1][0])
        )
        assert (aside > 0) is net.lefthand
        assert np.dot([np.cos(head.yaw_rad), np.sin(head.yaw_rad)], ahead) == pytest.approx(-1.0)
        assert -6.0 < np.dot(head.p_W_m[:2] - lane.points_m[-1], ahead) <= 0.0
        assert empty.free(thing.footprint) and abs(aside) < 12.0
        assert thing.piece.vertices_W_m[:, 2].max() > head.p_W_m[2] > HEAD_LOW_M


def test_an_approach_is_that_of_the_lane_beside_the_pavement(net: Net) -> None:
    lanes = {edge.id: edge.lanes for edge in net.edges if not edge.function}
    found = _find_approaches(net)
    assert found and all(len(lanes[approach.edge_id]) == 3 for approach in found)
    for approach in found:
        pavement, kerbside, inner = (lane.points_m[-1] for lane in lanes[approach.edge_id])
        assert np.hypot(*(kerbside - pavement)) < np.hypot(*(inner - pavement))
        assert approach.stop_m == pytest.approx(kerbside)
        assert np.dot(pavement - kerbside, approach.aside) > 0.0


def test_heads_of_lanes_stand_in_the_order_of_the_lanes(net: Net) -> None:
    mixed = tuple((name, "".join("rGyu"[i % 4] for i in range(len(state)))) for name, state in net.phases)
    things = signal_things(replace(net, phases=mixed), (), place_of(net))
    on_posts = [thing for thing in things if len(thing.heads) > 1]
    assert len(on_posts) == 4
    for thing in on_posts:
        lanes = [lane_at(net, head.link) for head in thing.heads]
        (aside,) = (a.aside for a in _find_approaches(net) if a.edge_id == lanes[0].edge_id)
        aside_m = [float(np.dot(head.p_W_m[:2], aside)) for head in thing.heads]
        from_kerb = [lanes[i].index for i in np.argsort(aside_m)[::-1]]
        assert from_kerb == sorted(from_kerb) and len(set(from_kerb)) == 2


def test_both_ends_of_a_crossing_show_each_other_their_light(net: Net) -> None:
    things = signal_things(net, (), place_of(net))
    found = heads_of(things, pedestrian=True)
    lit = {c.end: c.tls_link for c in net.connections if c.tls_id}
    crossings = [lane for lane in net.lanes(LaneKind.CROSSING) if lane.edge_id in lit]
    assert len(found) == 2 * len(crossings) == 8
    for lane in crossings:
        ends = [thing.heads[i] for thing, i in found if thing.heads[i].link == lit[lane.edge_id]]
        assert len(ends) == 2
        middle = lane.points_m.mean(axis=0)
        for head in ends:
            towards = middle - head.p_W_m[:2]
            assert np.dot([np.cos(head.yaw_rad), np.sin(head.yaw_rad)], towards) > 0.0


def test_links_that_always_agree_share_a_head(net: Net) -> None:
    assert len(heads_of(signal_things(net, (), place_of(net)), pedestrian=False)) == 4  # "g" and "G" look alike
    name, state = net.phases[0]
    arrow = replace(net, phases=(*net.phases, (name, "r" + "G" * (len(state) - 1))))  # one link for itself
    assert len(heads_of(signal_things(arrow, (), place_of(net)), pedestrian=False)) == 5
    unknown = replace(net, phases=())  # nothing is known of its program: each link may differ
    assert len(heads_of(signal_things(unknown, (), place_of(net)), pedestrian=False)) > 5


def test_a_program_in_an_additional_file_splits_heads(net: Net, tmp_path: Path) -> None:
    place = place_of(net)
    same = replace(net, phases=tuple((name, "G" * len(state)) for name, state in net.phases))
    name, state = net.phases[0]
    mixed = "".join("rGyg"[i % 2] for i in range(len(state)))
    path = tmp_path / "tls.add.xml"
    path.write_text(
        f'<additional><tlLogic id="{name}" type="static" programID="n"><phase duration="9" state="{mixed}"/></tlLogic>'
        '<tlLogic id="other"><phase duration="1"/></tlLogic></additional>',
    )
    things = signal_things(same, (path,), place)
    assert len(heads_of(things, pedestrian=False)) > 4


def test_without_room_the_light_hangs_on_an_arm_whose_post_stands_off_the_road(net: Net) -> None:
    place = place_of(net)
    stops = shapely.union_all([shapely.Point(a.stop_m).buffer(14.0) for a in _find_approaches(net)])
    crowded = replace(place, lines=shapely.union_all([place.lines, stops.difference(place.low)]))
    things = [thing for thing in signal_things(net, (), crowded) if not thing.heads[0].pedestrian]
    assert len(things) == 4 and all(thing.heads[0].p_W_m[2] > 4.8 for thing in things)
    for thing in things:
        assert not thing.footprint.intersects(place.low) and connected_to_ground(thing)


def test_between_buildings_the_light_hangs_from_a_wall_and_takes_no_ground(net: Net) -> None:
    houses = box(-1000, -1000, 1000, 1000).difference(place_of(net).low.buffer(0.1))
    place = replace(place_of(net), solids=houses)
    things = signal_things(net, (), place)
    assert things and all(thing.footprint.is_empty for thing in things)
    assert all(thing.piece.vertices_W_m[:, 2].min() > 4.0 for thing in things)
    assert all(houses.intersects(MultiPoint(thing.piece.vertices_W_m[:, :2]).convex_hull) for thing in things)
    assert not heads_of(things, pedestrian=True)


def connected_to_ground(thing: StandingObject) -> bool:
    """Whether the parts of a thing, seen from above, touch each other, and one of them reaches the ground."""
    corners_m = thing.piece.vertices_W_m[thing.piece.faces]
    seen = shapely.union_all([MultiPoint(corner[:, :2]).convex_hull.buffer(0.08) for corner in corners_m])
    return bool(corners_m[:, :, 2].min() < 0.0) and seen.geom_type == "Polygon"


def test_a_short_state_and_a_net_without_signals_are_no_error(net: Net) -> None:
    short = replace(net, phases=tuple((name, "r") for name, _ in net.phases))
    assert signal_things(short, (), place_of(net))
    dark = replace(net, connections=tuple(replace(c, tls_id="", tls_link=-1) for c in net.connections))
    assert signal_things(dark, (), place_of(net)) == []


def test_stop_signs_stand_at_the_kerb_of_their_approach(net: Net) -> None:
    place = place_of(net)
    approach = _find_approaches(net)[0]
    on_road = approach.stop_m - 4.0 * approach.ahead
    (sign,) = sign_things([item("highway.stop", tuple(on_road))], net, place)
    assert place_of(net).free(sign.footprint)
    away = sign.base_m - approach.stop_m
    assert np.dot(away, approach.aside) > approach.half_m
    far = item("highway.give_way", (5000.0, 5000.0))
    assert sign_things([far, item("amenity.bench", (0, 0))], net, place) == []
