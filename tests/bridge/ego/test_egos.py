"""Seats that come and go between ticks."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.actors import actor as car
from tests.support.worlds import follow, quick_config
from wcsim.bridge.ego import ego
from wcsim.bridge.world import World
from wcsim.core.seeding import make_rng
from wcsim.errors import ConfigError, ProtocolError
from wcsim.physics.buffers import SeatBuffers, new_images
from wcsim.towns.scenario.town import find_town
from wcsim.types import ClientSnapshot, Command, Joystick, SeatSpec
from wcsim.users.perception import UserPerception
from wcsim.users.profiles import PROFILE_LIMITS, find_builtin_profile
from wcsim.users.user import SimulatedUser

SPEC = SeatSpec(profile="competent")


def empty_world(corner: Path, *overrides: str, seats: int = 3, seed: int = 2, epoch: int = 0) -> World:
    return World(find_town(str(corner)), quick_config(*overrides), (None,) * seats, seed, epoch=epoch)


@pytest.fixture
def world(corner):
    with empty_world(corner) as opened:
        yield opened


def bodies(world: World) -> int:
    """Bodies of PyBullet that are neither pooled actors nor the street."""
    street = sum(len(pieces) for pieces in world._open.street._pieces.values())
    return int(world._open.engine.bullet.getNumBodies()) - world._open.bodies.made - street


def present(world: World) -> list[int]:
    assert [seat.index for seat in world.seats] == [client.seat for client in world.snapshot.clients]
    return [seat.index for seat in world.seats]


def follow_for(world: World, ticks: int) -> list[str]:
    return [follow(world).state_hash for _ in range(ticks)]


def test_an_empty_world_ticks_and_counts_its_epochs(corner):
    with empty_world(corner, epoch=4) as world:
        assert (world.snapshot.epoch, world.snapshot.tick, world.snapshot.clients) == (4, 0, ())
        assert len(set(follow_for(world, 5))) == 5
        assert world.snapshot.tick == 5
        assert world.rebuild(3).epoch == 5


def test_a_seat_is_taken_once_and_left_once(world):
    for number in (-1, 3):
        with pytest.raises(ProtocolError, match=f"no seat {number}; expected 0 or more and less than 3"):
            world.admit(number, SPEC)
        with pytest.raises(ProtocolError, match="no seat"):
            world.dismiss(number)
    with pytest.raises(ProtocolError, match="seat 1 is free"):
        world.dismiss(1)
    with pytest.raises(ProtocolError, match="seat 1 is free"):
        world.respawn(1)
    before = world.snapshot.state_hash
    client = world.admit(2, SPEC)
    assert (client.seat, client.tick, client.events.episode, client.events.step) == (2, 0, 0, 0)
    assert world.snapshot.state_hash != before
    with pytest.raises(ProtocolError, match=r"seat 2 is taken.*\[0, 1\]"):
        world.admit(2, SPEC)
    world.admit(0, SPEC)
    assert present(world) == [0, 2]
    with pytest.raises(ProtocolError, match="do not fit"):
        world.tick(tuple(Command(seat=n, tick=0, joystick=Joystick(0.0, 0.0)) for n in range(3)))
    follow(world)
    world.dismiss(2)
    assert present(world) == [0]
    follow(world)


def test_who_cannot_be_admitted_changes_nothing(corner):
    script = (lambda world: world.admit(0, SPEC), lambda world: follow_for(world, 3))

    def drive(world: World, hinder: bool) -> str:
        for act in script:
            if hinder:
                with pytest.raises(ConfigError, match="nobody"):
                    world.admit(1, SeatSpec(profile="nobody"))
            act(world)
        world.admit(1, SPEC)
        return follow_for(world, 5)[-1]

    with empty_world(corner) as world:
        plain = drive(world, hinder=False)
    with empty_world(corner) as world:
        assert drive(world, hinder=True) == plain


def test_users_drawn_of_a_wide_profile_keep_within_the_bounds_of_profiles(corner, tmp_path, monkeypatch):
    """A gain below zero would turn the stick round."""
    (tmp_path / "wide.toml").write_text("gain = [0.2, 0.2]\nspread = 0.3\n")
    gains = []

    def made(user, *rest):
        gains.extend(user.gain)
        return SimulatedUser(user, *rest)

    monkeypatch.setattr(ego, "SimulatedUser", made)
    with empty_world(corner) as world:
        world.admit(0, SeatSpec(profile=str(tmp_path / "wide.toml")))
        for _ in range(12):
            world.respawn(0)
    assert len(set(gains)) > 12 and min(gains) == PROFILE_LIMITS["gain"][0]


def test_who_has_no_start_is_not_in_the_street_and_has_had_no_episode(world, monkeypatch):
    world.admit(0, SPEC)
    count, hashed = bodies(world), world.snapshot.state_hash
    with monkeypatch.context() as patch:
        patch.setattr(type(world.seats[0]), "_follow", lambda *_: (_ for _ in ()).throw(ConfigError("no way")))
        with pytest.raises(ConfigError, match="no way"):
            world.admit(1, SPEC)
    assert (bodies(world), present(world), world.snapshot.state_hash) == (count, [0], hashed)
    assert world.admit(1, SPEC).events.episode == 0


def test_a_chair_that_leaves_leaves_nothing_behind(world):
    world.admit(0, SPEC)
    alone = bodies(world)
    world.admit(1, SPEC)
    follow_for(world, 3)
    assert bodies(world) == alone + 1
    assert {actor.id for actor in world._others(world.seats[0])} >= {"w:1"}
    gone = world.seats[1].as_actor().p_W_m[:2]
    world.dismiss(1)
    assert bodies(world) == alone
    assert all(seat.chair.parked is False for seat in world.seats)
    assert "w:1" not in {actor.id for actor in world._others(world.seats[0])}
    assert "w:1" not in {actor.id for actor in world._taken(gone, 50.0)}
    near = world.config.world.mirror_radius_m
    here = world.snapshot.clients[0].plant.p_WB_m[:2]
    for actor in world.snapshot.actors:
        assert np.hypot(*(actor.p_W_m[:2] - here)) < near + actor.size_lwh_m[0]
    for _ in range(20):
        (client,) = follow(world).clients
        assert np.isfinite(client.plant.p_WB_m).all()
    assert len(world._open.traffic.chairs) == 1


def test_the_street_lets_go_of_whom_it_held_when_the_last_chair_leaves(world):
    world.admit(0, SPEC)
    follow_for(world, 40)
    world.dismiss(0)
    assert world.snapshot.actors == ()
    follow_for(world, 2)
    assert world._open.traffic.blocked() == ()
    assert world._open.bodies.count == 0


def test_a_seat_goes_on_with_its_next_episode_and_another_start(world):
    starts = []
    for episode in range(3):
        client = world.admit(1, SPEC)
        assert client.events.episode == 2 * episode
        starts.append(tuple(client.plant.p_WB_m))
        assert world.respawn(1).events.episode == 2 * episode + 1
        follow(world)
        world.dismiss(1)
    assert len(set(starts)) == 3
    parked = world._seating.admit(world._open.engine, world._rig, 1, SPEC)
    assert (parked.started, parked.spawned) == (6, False)  # it takes nobody's place before it has one
    world._seating.revoke(1)
    world.rebuild(2)
    assert world.admit(1, SPEC).events.episode == 0
    assert tuple(world.snapshot.clients[0].plant.p_WB_m) != starts[1]


def test_a_user_knows_of_a_car_three_seconds_away(world):
    world.admit(0, SPEC)
    x, y, _ = world.seats[0].plant.p_WB_m.tolist()
    coming = car(x=x - 41.0, y=y, speed=13.9)
    view = world.seats[0].view(0.0, (coming,), ())
    assert UserPerception(find_builtin_profile("competent"), make_rng(0)).update(view).vehicles == (coming,)


def test_a_chair_keeps_for_a_second_of_its_worlds_ticks_who_came_into_whom(corner):
    with empty_world(corner, "world.tick_s=0.2") as world:
        world.admit(0, SPEC)
        assert world.seats[0].chair._log._apart_ticks == 5


def script(world: World) -> list[str]:
    """Everything that can happen to a world, and its hashes."""
    seen = []

    def see(_: object) -> None:
        seen.append(world.snapshot.state_hash)

    steps: list[Callable[[], object]] = [
        *(lambda: world.admit(1, SPEC), lambda: follow_for(world, 10), lambda: world.admit(0, SPEC)),
        *(lambda: follow_for(world, 10), lambda: world.respawn(1), lambda: follow_for(world, 10)),
        *(lambda: world.dismiss(1), lambda: follow_for(world, 10), lambda: world.admit(2, SeatSpec(max_steps=7))),
        *(lambda: world.admit(1, SPEC), lambda: follow_for(world, 20), lambda: world.rebuild(9)),
        *(lambda: follow_for(world, 10), lambda: world.dismiss(0), lambda: follow_for(world, 10)),
    ]
    for step in steps:
        see(step())
    assert present(world) == [1, 2]
    return seen


def test_one_script_gives_one_world(corner):
    with empty_world(corner) as world:
        first = script(world)
    assert len(set(first)) == len(first)
    with empty_world(corner) as world:
        assert script(world) == first


class Sink:
    """New arrays for each frame, so that all of them can be looked at later."""

    def __init__(self, world: World) -> None:
        self._cameras = world.config.cameras
        self.given: list[tuple[int, bool, SeatBuffers]] = []

    def buffers(self, seat: int, first: bool) -> SeatBuffers:
        images = tuple(new_images(c.width_px, c.height_px, c.rgb) for c in self._cameras)
        self.given.append((seat, first, images))
        return images


Image = tuple[int, int, np.ndarray, np.ndarray, np.ndarray]


def shown(client: ClientSnapshot) -> list[Image]:
    """Copies of what a client and its next episode's first frame show."""
    frames = [(c.seat, c.sensors.cameras[0]) for c in (client, client.first) if c is not None]
    return [(seat, f.taken_tick, f.depth_m.copy(), f.class_id.copy(), f.rgb.copy()) for seat, f in frames]


@pytest.mark.parametrize("every", [1, 3])
def test_images_in_given_buffers_are_those_without(corner, every):
    spec = SeatSpec(profile="competent", max_steps=4)
    overrides = ("cameras.0.rgb=true", f"cameras.0.every_ticks={every}")

    def drive(world: World, sink: Sink | None) -> list[Image]:
        seen = [*shown(world.admit(0, spec, sink)), *shown(world.admit(2, spec, sink))]
        for tick in range(6):
            ahead = [Command(seat=seat, tick=tick, joystick=Joystick(0.0, 0.6)) for seat in (0, 2)]
            seen += [image for client in world.tick(ahead, sink).clients for image in shown(client)]
        seen += shown(world.respawn(2, sink))
        return seen + [image for client in world.rebuild(8, sink).clients for image in shown(client)]

    with empty_world(corner, *overrides) as world:
        plain = drive(world, None)
    with empty_world(corner, *overrides) as world:
        sink = Sink(world)
        own = drive(world, sink)
        last = world.snapshot.clients[-1].sensors.cameras[0]
        assert np.shares_memory(last.depth_m, sink.given[-1][2][0].depth_m)
    assert len(own) == len(sink.given) == 2 + 6 * 2 + 2 + 1 + 2
    for one, other in zip(plain, own, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    assert [seat for seat, first, _ in sink.given if first] == [0, 2, 0, 2, 2, 0, 2]
