"""Whom a chair's cameras have shown lately, and what the oracle says when it knows nobody else."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.physics.rig import shoot
from tests.physics.sensors.test_camera import SMALL, plant
from tests.support.samples import ACTIONS, USUAL_OUTLINE, strip_street
from tests.support.worlds import follow, open_world
from tests.users.actors import USUAL_RIMS_M, USUAL_WHEELS_M, actor
from wcsim.bridge.ego.ego import _ShownActors
from wcsim.bridge.world import World
from wcsim.config import ChairConfig, WorldConfig
from wcsim.physics.sensors.camera import CameraRig
from wcsim.supervisor.oracle import CrashOracle
from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street
from wcsim.types import ActorKind, Command, Joystick, SeatSpec, StartSpec, Truth, WayKind

FORWARD, BACKWARD = ACTIONS.nearest((0.0, 1.0)), ACTIONS.nearest((0.0, -1.0))
AT_REST = Joystick(0.0, 0.0)


def known(shown: _ShownActors, *names: str) -> set[str]:
    actors = [actor(ActorKind.CAR, 0.0, 0.0, name=name) for name in names]
    return {one.id for one in shown.known(actors)}


@pytest.mark.parametrize("tick_s, kept", [(0.1, 10), (0.05, 20), (0.5, 2)])
def test_who_was_shown_is_known_for_a_second(tick_s, kept):
    shown = _ShownActors(WorldConfig(tick_s=tick_s, substeps=round(240 * tick_s)))
    shown.see(5, {"a": 300.0})
    for tick in range(6, 6 + 2 * kept):
        shown.see(tick, {"b": 300.0})
        assert ("a" in known(shown, "a", "b", "c")) == (tick <= 5 + kept), tick
        assert "b" in known(shown, "a", "b", "c")
    shown.forget()
    assert known(shown, "a", "b") == set()


def test_too_few_pixels_show_nobody():
    shown = _ShownActors(WorldConfig())
    shown.see(0, {"many": 16.0, "few": 15.9})
    assert known(shown, "many", "few") == {"many"}


def test_all_pieces_of_who_is_shown_are_known_where_they_are_now():
    shown = _ShownActors(WorldConfig())
    shown.see(0, {"tram": 99.0})
    front, rear = (replace(actor(ActorKind.CAR, x, 0.0, name=name), piece=piece)
                   for x, name, piece in ((9.0, "tram", 0), (0.0, "tram~1", 1)))  # fmt: skip
    assert shown.known((front, rear, actor(ActorKind.CAR, 0.0, 0.0, name="tram~2"))) == (front, rear)


def said(place, others, history=()) -> tuple[np.ndarray, np.ndarray]:
    """Safe actions on the sample street by the full and by the blinded oracle.

    `history`: (tick, place, others) of pictures that were taken before; the last one is of tick 100.
    """
    street = strip_street()
    oracle = CrashOracle(street.grid, ChairConfig(), USUAL_OUTLINE, USUAL_WHEELS_M, USUAL_RIMS_M, ACTIONS.points)
    shown = _ShownActors(WorldConfig())
    with CameraRig(street.mesh, (SMALL,), seats=1) as rig:
        for tick, at, actors in (*history, (100, place, others)):
            shoot(rig, at, actors, tick=tick, counted=True)
            shown.see(tick, rig.shown_px(0))
    full = oracle.assess(place, AT_REST, others, known=shown.known(others))
    assert full.visible is not None
    return full.safe_actions, full.visible.safe_actions


CHAIR = plant(x=10.0)
BEHIND = (actor(ActorKind.PEDESTRIAN, 9.2, 5.5),)


def test_who_stands_behind_is_danger_for_the_full_oracle_alone():
    full, visible = said(CHAIR, BEHIND)
    assert not full[BACKWARD] and visible[BACKWARD]
    ahead = (actor(ActorKind.PEDESTRIAN, 11.3, 5.5),)
    full, visible = said(CHAIR, ahead)
    assert not full[FORWARD] and not visible[FORWARD]


@pytest.mark.parametrize("ago_ticks, remembered", [(5, True), (15, False)])
def test_who_was_seen_half_a_second_ago_is_remembered(ago_ticks, remembered):
    """Seen in front by a chair that then turned round, and has come nearer since."""
    turned = plant(x=10.0, yaw=math.pi)
    further = (replace(BEHIND[0], p_W_m=np.array([7.0, 5.5, 0.0])),)
    full, visible = said(CHAIR, BEHIND, ((100 - ago_ticks, turned, further),))
    assert not full[BACKWARD]
    assert visible[BACKWARD] != remembered


def test_a_bus_behind_the_house_is_not_known_and_the_house_is():
    """The house stands from x = 50 to 70 m and y = 9 to 19 m; a bus comes through it."""
    north = plant(x=60.0, y=7.8, yaw=math.pi / 2)
    bus = replace(
        actor(ActorKind.CAR, 60.0, 15.0), kind=ActorKind.BUS, size_lwh_m=(8.0, 2.5, 3.4),
        v_W_mps=np.array([0.0, -6.0, 0.0]), yaw_rad=-math.pi / 2,
    )  # fmt: skip
    full, visible = said(north, (bus,))
    stand = ACTIONS.nearest((0.0, 0.0))
    assert not full[stand] and visible[stand]
    assert not visible[FORWARD]  # the wall


def pavement(corner) -> StartSpec:
    """On the longest pavement of the corner, along it."""
    street = load_street(find_town(str(corner)))
    ways = [e for e in street.walk.edges if e.kind is WayKind.SIDEWALK]
    points = max((e.points_W_m for e in ways), key=lambda p: float(np.linalg.norm(p[-1] - p[0])))
    along = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    start = 0.5 * (points[0] + points[-1])
    return StartSpec(
        p_W_m=(float(start[0]), float(start[1])),
        yaw_rad=math.atan2(along[1], along[0]),
        goal_W_m=(float(points[-1][0]), float(points[-1][1])),
    )


def stand(world: World, ticks: int = 1) -> Truth:
    """Nobody moves; the truth of the first seat after so many ticks."""
    for _ in range(ticks):
        commands = [Command(seat=seat.index, tick=world.snapshot.tick, joystick=AT_REST) for seat in world.seats]
        snapshot = world.tick(commands)
    truth = snapshot.clients[0].truth
    assert truth is not None and truth.visible is not None
    return truth


def test_in_a_world_who_was_seen_is_known_for_a_second_and_for_no_other_episode(corner):
    start = pavement(corner)
    spec = SeatSpec(profile="competent", start=start, truth_visible=True)
    here, ahead = np.array(start.p_W_m), np.array([math.cos(start.yaw_rad), math.sin(start.yaw_rad)])
    with open_world(corner, "world.demand_scale=0", seats=2, spec=spec) as world:
        world.put_chair(1, here - 1.2 * ahead, start.yaw_rad)
        world.put_chair(0, here, start.yaw_rad)
        truth = stand(world)
        assert not truth.safe_actions[BACKWARD] and truth.visible.safe_actions[BACKWARD]  # w:1 is behind, never seen

        def turn_round_and_back() -> None:
            world.put_chair(1, here - 4.0 * ahead, start.yaw_rad)
            world.put_chair(0, here, start.yaw_rad + math.pi)
            stand(world)
            world.put_chair(1, here - 1.2 * ahead, start.yaw_rad)
            world.put_chair(0, here, start.yaw_rad)

        turn_round_and_back()
        assert not stand(world, 5).visible.safe_actions[BACKWARD]
        assert stand(world, 10).visible.safe_actions[BACKWARD]
        assert not stand(world).safe_actions[BACKWARD]
        turn_round_and_back()
        first = world.respawn(0).truth  # at the same place
        assert first is not None and first.visible is not None
        assert not first.safe_actions[BACKWARD] and first.visible.safe_actions[BACKWARD]


def truths(corner, ticks: int = 120) -> list[Truth | None]:
    spec = SeatSpec(truth_visible=True)
    with open_world(corner, "world.action_delay_ticks=2", seats=2, seed=4, spec=spec) as world:
        return [c.truth for _ in range(ticks) for c in follow(world).clients]


def test_equal_seeds_give_equal_truths_and_the_blinded_oracle_fears_less(corner):
    first, second = truths(corner), truths(corner)
    assert first == second
    pairs = [(truth.first_s, truth.visible.first_s) for truth in first if truth is not None and truth.visible]
    assert len(pairs) == len(first) == 240
    assert all((visible >= full).all() for full, visible in pairs)


@pytest.mark.parametrize("asked, truth, visible", [
    ({}, False, False), ({"truth": True}, True, False), ({"truth_visible": True}, True, True),
    ({"truth": True, "truth_visible": True}, True, True),
])  # fmt: skip
def test_each_part_of_the_truth_comes_only_when_it_is_asked_for(corner, asked, truth, visible):
    with open_world(corner, spec=SeatSpec(**asked)) as world:
        (client,) = follow(world).clients
        assert (client.truth is not None) == truth
        assert (client.truth is not None and client.truth.visible is not None) == visible
        assert bool(world.seats[0]._shown_actors._last) <= visible
