import ast
import inspect
import math
import shutil
import textwrap
from pathlib import Path

import numpy as np
import pytest

from tests.support.worlds import follow, hashes, open_world, push
from wcsim.bridge.mirror import BODY_REACH_M
from wcsim.bridge.sumo.session import world_in_this_process
from wcsim.bridge.world import World, _reach
from wcsim.bridge.world_copy import in_copy
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig, resolve
from wcsim.errors import ConfigError, ProtocolError, WorldInUseError
from wcsim.physics.wheelchair.drive_controller import stopping_distance_m
from wcsim.supervisor.oracle import CrashOracle
from wcsim.towns.scenario.town import Town, find_town
from wcsim.types import ActorKind, Command, Joystick, SeatSpec


def test_the_tick_is_five_lines():
    (function,) = ast.parse(textwrap.dedent(inspect.getsource(World.tick))).body
    assert isinstance(function, ast.FunctionDef)
    assert len(function.body[1:]) == 5


def test_equal_seeds_give_equal_worlds_and_others_do_not(corner):
    with open_world(corner, seed=3) as world:
        first = hashes(world, 80)
    with open_world(corner, seed=3) as world:
        assert hashes(world, 80) == first
        world.rebuild(4)
        assert hashes(world, 80) != first
        world.rebuild(3)
        assert hashes(world, 80) == first
        assert world.epoch == 2


def test_a_second_world_in_the_process_is_refused_with_its_cure(corner):
    with open_world(corner), pytest.raises(WorldInUseError, match="process"):
        open_world(corner)


def _rolls(world: World) -> list[int]:
    """The seats whose chairs went through the last tick without the engine."""
    return sorted(world._planes)


def test_chairs_that_roll_are_where_they_would_be_and_equal_seeds_give_equal_worlds(corner):
    places, shares = [], []
    for rolling in ("true", "true", "false"):
        with open_world(corner, f"world.rolling={rolling}", seats=3, seed=3) as world:
            rolled, steps = 0, hashes(world, 1)
            for _ in range(60):
                steps += hashes(world, 1)
                rolled += len(_rolls(world))
                if len(steps) == 21:
                    places.append([seat.plant.p_WB_m[:2] for seat in world.seats])
            shares.append(rolled / 180)
            places[-1] = (places[-1], steps)
    (one, first), (_, second), (other, _) = places
    assert first == second and shares[0] == shares[1] > 0.5 and shares[2] == 0.0
    assert np.abs(np.subtract(one, other)).max() < 0.05


def test_the_ground_that_a_chair_may_come_to_is_ahead_of_it_or_behind_one_that_backs(corner):
    with open_world(corner, seed=3) as world:
        (seat,) = world.seats
        way_m = 0.167 + stopping_distance_m(1.67, 1.5, 4.0)
        for stick, side in ((Joystick(0.0, 1.0), 1.0), (Joystick(0.0, -1.0), -1.0)):
            for _ in range(25):
                push(world, stick)
            now, reach = seat.as_actor(), _reach(seat, way_m)
            shift_m = reach.p_W_m - now.p_W_m
            ahead_m = shift_m[0] * math.cos(now.yaw_rad) + shift_m[1] * math.sin(now.yaw_rad)
            assert ahead_m == pytest.approx(0.5 * side * way_m)
            assert np.subtract(reach.size_lwh_m, now.size_lwh_m) == pytest.approx([way_m + 0.6, 0.6, 0.0])


def test_who_has_somebody_in_reach_is_in_the_engine(corner):
    with open_world(corner, "world.rolling=true", seats=2, seed=3) as world:
        follow(world)
        assert 0 in _rolls(world)
        plant = world.seats[0].plant
        ahead = np.array([math.cos(plant.yaw_rad), math.sin(plant.yaw_rad)])
        world.put_chair(1, plant.p_WB_m[:2] + 2.5 * ahead, plant.yaw_rad)
        follow(world)
        assert _rolls(world) == []


def test_a_copy_of_a_world_that_rolls_goes_on_as_the_world_does(corner):
    with open_world(corner, "world.rolling=true", "world.draw_threads=1", seats=2, seed=3) as world:
        hashes(world, 15)
        assert in_copy(world, lambda copy: " ".join(hashes(copy, 20)).encode()).decode().split() == hashes(world, 20)


def _rim_m(actor, x_m, y_m):
    away_m = np.abs(actor.p_W_m[:2] - [x_m, y_m]).max()
    return away_m - 0.5 * actor.size_lwh_m[0]


def test_every_actor_in_reach_of_a_chair_has_a_body_and_no_other(corner):
    with open_world(corner) as world:
        seen: set[ActorKind] = set()
        without = 0
        for _ in range(150):
            snapshot = follow(world)
            bodies = world._open.bodies.poses()
            (chair,) = world.snapshot.clients
            x, y, _ = chair.plant.p_WB_m
            near = {a.id: a for a in snapshot.actors if _rim_m(a, x, y) < BODY_REACH_M - 0.3}  # it drives on in a tick
            around = {a.id for a in snapshot.actors if _rim_m(a, x, y) < BODY_REACH_M + 0.3}
            assert near.keys() <= bodies.keys() <= around
            without += len(snapshot.actors) - len(bodies)
            for actor in near.values():
                seen.add(actor.kind)
                assert np.abs(bodies[actor.id][0][:2] - actor.p_W_m[:2]).max() < 0.05
        assert ActorKind.CAR in seen and without > 0


def test_a_world_that_cannot_begin_leaves_nothing_behind(corner):
    with pytest.raises(ConfigError, match="nobody"):
        open_world(corner, spec=SeatSpec(profile="nobody"))
    assert not world_in_this_process()


def test_a_command_for_another_tick_is_refused(corner):
    with open_world(corner) as world:
        with pytest.raises(ProtocolError, match="tick 0"):
            world.tick((Command(seat=0, tick=7, joystick=Joystick(0.0, 0.0)),))
        with pytest.raises(ProtocolError, match="one a seat"):
            world.tick(())
        after = hashes(world, 5)
    with open_world(corner) as world:
        assert hashes(world, 5) == after, "a refused command must not move anything"


def test_the_step_limit_truncates_and_the_next_episode_begins_in_the_same_tick(corner):
    with open_world(corner, spec=SeatSpec(max_steps=5)) as world:
        clients = [follow(world).clients[0] for _ in range(11)]
        ends = [i for i, client in enumerate(clients) if client.events.truncated]
        assert ends == [4, 9]
        first = clients[4].first
        assert first is not None
        assert (first.events.episode, first.events.step) == (1, 0)
        assert first.tick == clients[4].tick
        assert clients[5].events.step == 1
        gap = np.linalg.norm(clients[5].plant.p_WB_m[:2] - first.plant.p_WB_m[:2])
        assert gap < 0.3
        assert all(client.first is None for i, client in enumerate(clients) if i not in ends)


def test_what_was_seen_before_an_ending_tick_still_stands_after_it(corner):
    with open_world(corner, spec=SeatSpec(max_steps=4)) as world:
        for _ in range(3):
            before = follow(world).clients[0].sensors.cameras[0]
        kept = before.depth_m.copy()
        assert follow(world).clients[0].first is not None
        assert np.array_equal(before.depth_m, kept)
        with pytest.raises(ValueError, match="read-only"):
            before.depth_m[0, 0] = 0.0


def test_the_order_of_seats_does_not_decide_what_they_see(corner):
    with open_world(corner, seats=2, seed=2) as world:
        others = [{actor.id: actor.p_W_m for actor in world._others(seat)} for seat in world.seats]
        for seat, seen in zip(world.seats[::-1], others, strict=True):
            assert np.linalg.norm(seen[f"w:{seat.index}"] - seat.as_actor().p_W_m) < 1e-12
        assert all(client.plant.p_WB_m[2] > -1.0 for client in world.snapshot.clients)


def test_two_chairs_see_each_other_and_drive_apart(corner):
    with open_world(corner, seats=2, seed=2) as world:
        for _ in range(30):
            snapshot = follow(world)
        assert len(snapshot.clients) == 2
        a, b = (client.plant.p_WB_m for client in snapshot.clients)
        assert np.linalg.norm(a - b) > 1.0
        assert {actor.id for actor in world._others(world.seats[0])} >= {"w:1"}


def test_the_truth_knows_of_the_commands_that_wait(corner):
    """A chair that is driven in a bend until something comes: every answer is that of a chair which drives on."""
    spec = SeatSpec(profile="competent", truth=True)
    differs = 0
    with open_world(corner, "world.action_delay_ticks=3", "world.demand_scale=0", spec=spec) as world:
        sticks = [Joystick(0.0, 0.0)] * 3
        for tick in range(200):
            sticks.append(Joystick(-0.1 - 0.05 * (tick % 3), 0.8))
            (client,) = world.tick((Command(seat=0, tick=tick, joystick=sticks[-1]),)).clients
            if client.first is not None:
                break
            seat, others = world.seats[0], world._others(world.seats[0])
            accel_mps2 = seat.chair.drive_accel_mps2()
            said = seat._oracle.assess(client.plant, client.user, others, sticks[-3:], accel_mps2=accel_mps2)
            assert client.truth is not None and client.truth.danger == said.danger
            np.testing.assert_array_equal(client.truth.first_s, said.first_s)
            at_once = seat._oracle.assess(client.plant, client.user, others, accel_mps2=accel_mps2)
            differs += bool((said.first_s != at_once.first_s).any())
    assert differs > 3


def test_the_truth_knows_that_the_chair_speeds_up(corner, monkeypatch):
    asked_mps2 = []
    assess = CrashOracle.assess

    def heard(oracle, plant, stick, others, waiting, known, accel_mps2):
        asked_mps2.append(accel_mps2)
        return assess(oracle, plant, stick, others, waiting, known, accel_mps2)

    monkeypatch.setattr(CrashOracle, "assess", heard)
    with open_world(corner, spec=SeatSpec(truth=True)) as world:
        for tick in range(4):
            world.tick((Command(seat=0, tick=tick, joystick=Joystick(0.0, 1.0)),))
    assert asked_mps2[0] == 0.0 and min(asked_mps2[2:]) > 0.5


def test_a_slow_camera_repeats_its_image_with_its_old_tick(corner):
    with open_world(corner, "cameras.0.every_ticks=3") as world:
        taken = [follow(world).clients[0].sensors.cameras[0].taken_tick for _ in range(7)]
        assert taken == [0, 0, 3, 3, 3, 6, 6]


def test_a_blind_world_draws_nothing_and_goes_on_as_it_would(corner):
    with open_world(corner) as world:
        follow(world)
        seen = [follow(world).clients[0] for _ in range(20)]
    with open_world(corner) as world:
        (before,) = follow(world).clients
        world.go_blind()
        blind = [follow(world).clients[0] for _ in range(20)]
    assert {client.sensors.cameras[0].taken_tick for client in blind} == {before.sensors.cameras[0].taken_tick}
    assert [client.sensors.cameras[0].taken_tick for client in seen] == [client.tick for client in seen]
    assert all(client.truth is None for client in blind)
    for one, other in zip(seen, blind, strict=True):
        assert (one.plant, one.user, one.events) == (other.plant, other.user, other.events)


COPIED_TICKS = 300


@pytest.fixture
def busy(corner: Path, tmp_path: Path) -> Town:
    """The corner with a file of routes that SUMO reads bit by bit: it takes 1 MiB at a time."""
    folder = tmp_path / "busy"
    shutil.copytree(corner, folder)
    (routes,) = folder.glob("*.rou.xml")
    car = '<vehicle id="more.{0}" type="car" depart="{1}"><route edges="WC CE"/></vehicle><!-- {2} -->'
    rows = [car.format(number, 8 + 2 * number, "." * 200000) for number in range(30)]
    routes.write_text(routes.read_text("utf-8").replace("</routes>", "\n".join([*rows, "</routes>"])), "utf-8")
    (scenario,) = folder.glob("*.sumocfg")
    text = scenario.read_text("utf-8")
    scenario.write_text(text.replace("</input>", '<route-steps value="5"/></input>'), "utf-8")
    return find_town(str(folder))


def driven(town: Town, every: int) -> str:
    """The hash of a world's last tick, after copies of it have driven on."""
    config = resolve(RunConfig(), ("world.draw_threads=1", "world.warmup_s=0"))

    def far(copy: World) -> bytes:
        for _, step in zip(range(COPIED_TICKS), rollout(copy), strict=False):
            last = step.after.state_hash
        return last.encode()

    with World(town, config, (SeatSpec(),), 3) as world:
        for tick, _ in zip(range(COPIED_TICKS), rollout(world), strict=False):
            if every and tick % every == 0:
                in_copy(world, far)
        return world.snapshot.state_hash


def test_what_a_copy_reads_of_the_routes_is_not_missing_in_the_world(busy):
    assert driven(busy, 100) == driven(busy, 0)
