"""The Gymnasium environment on a seat of a running world that others share."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.api.streets import TINY, action_at, equal
from tests.server.local_server import LocalServer
from tests.server.servers import AHEAD, Server, stand_in_order
from wcsim.agents.envs.episode_view import SeatEnvAdapter
from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.config import resolve
from wcsim.errors import ConfigMismatchError, EvictedError, NotMasterError, ProtocolError, ServerGoneError
from wcsim.server.host.opening import make_street_world
from wcsim.server.links import socket
from wcsim.server.protocol.events import ClientLostEvent, ServerRules
from wcsim.server.specs import SeatRequest, WorldBuildSpec
from wcsim.types import SeatSpec

CONFIG = resolve("quick", TINY)
SPEC = SeatSpec(max_steps=12)


def seat_of(number: int = 0) -> SeatRequest:
    """An order for a seat of a world in this process."""
    return SeatRequest(endpoint="here", name="env", claim="env", seat=number, spec=SPEC)


@pytest.fixture
def hall(corner: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Makes a world in this process whose seats `join` reaches: nothing but the socket is left out."""
    open_now: list[LocalServer] = []

    def opened(order: SeatRequest) -> Any:
        return open_now[-1].link(order.spec, order.seat, order.name)

    def make(seats: int, expected: int) -> LocalServer:
        order = WorldBuildSpec(town=str(corner), config=CONFIG, seed=4, seats=seats)
        open_now.append(LocalServer(make_street_world(order, (None,) * order.seats, order.seed), seats, expected))
        return open_now[-1]

    monkeypatch.setattr(socket, "SocketSeatLink", opened)
    yield make
    for server in open_now:
        server.world.close()


@pytest.fixture
def pair(hall: Any) -> Iterator[tuple[LocalServer, Any, WheelchairEnv, Any]]:
    """A server, its master on seat 0, an environment on seat 1, and the first thing that this one saw."""
    server = hall(2, 2)
    master, env = server.link(SPEC, 0, "master"), WheelchairEnv(config=CONFIG, join=seat_of(1))
    master.request_join()
    first = env.reset(seed=99)
    master.receive()
    yield server, master, env, first
    env.close()


def both(master: Any, env: WheelchairEnv, action: int = 40) -> Any:
    """A step of the environment, in which the master does its part."""
    master.send(master.core.tick, AHEAD)
    step = env.step(action)
    master.receive()
    return step


def drive(env: WheelchairEnv, steps: int, seed: int | None) -> list[Any]:
    seen: list[Any] = [env.reset(seed=seed)]
    for step in range(steps):
        seen.append(tuple(env.step(action_at(step))))
        if seen[-1][2] or seen[-1][3]:
            seen.append(env.reset())
    return seen


def test_a_seat_of_a_world_process_shows_what_a_world_of_ones_own_shows(corner, tmp_path):
    """Over a socket, with the pictures in shared memory; the seed of the first reset is the server's."""
    own = WheelchairEnv(str(corner), overrides=(*TINY, f"env.max_steps={SPEC.max_steps}"), seed=4)
    expected = [drive(own, 30, None), drive(own, 5, 9)]
    own.close()
    world = {"town": str(corner), "seed": 4, "config": CONFIG}
    order = stand_in_order(tmp_path, rules=ServerRules(capacity=1, config=CONFIG.world_digest()), **world)
    with Server(order, tmp_path) as server:
        server.status()
        env = WheelchairEnv(config=CONFIG, join=server.seat("env", spec=SPEC, config=CONFIG.world_digest()))
        assert env.waits.steps == 0
        assert equal(expected[0], drive(env, 30, 1234))
        assert env.waits.steps == 30
        assert 0.0 < env.waits.simulation_s < env.waits.link_s
        assert equal(expected[1], drive(env, 5, 9)), "a sole client may begin the world again"
        env.close()
        env.close()
        again = WheelchairEnv(config=CONFIG, join=server.seat("other", spec=SPEC))
        assert again.reset()[1]["event_step"] == 0, "the seat is free for others"
        again.close()


def test_one_that_is_to_end_does_not_wait_for_a_world_that_is_not_there(tmp_path):
    nobody = SeatRequest(endpoint=f"ipc://{tmp_path}/nobody", name="a", claim="a")
    env = WheelchairEnv(config=CONFIG, join=nobody)
    env.wait_no_more()
    with pytest.raises(ServerGoneError, match="requested to stop"):
        env.reset()


def test_a_world_that_begins_again_cuts_the_episode(pair):
    server, master, env, first = pair
    for _ in range(3):
        last = both(master, env)
    master.rebuild(7)
    observation, reward, terminated, truncated, info = both_restarted(master, env)
    assert equal(observation, last[0])
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["world_restarted"]
    assert set(info) == set(last[4])
    assert (info["progress_m"], info["contacts"], info["objects"].reward_terms.total) == (0.0, 0, 0.0)
    assert (info["event_step"], info["event_truncated"], info["event_crashed"]) == (3, True, False)
    with pytest.raises(ProtocolError, match="call reset"):
        env.step(40)
    again, info = env.reset()
    assert (server.world.snapshot.epoch, server.world.snapshot.tick) == (1, 0)
    assert (info["event_episode"], info["event_step"]) == (0, 0)
    assert not equal(again, first[0])
    assert both(master, env)[4]["event_step"] == 1


def both_restarted(master: Any, env: WheelchairEnv) -> Any:
    """The step in which the environment hears of the new epoch; nobody moves."""
    tick = master.core.tick
    step = env.step(40)
    assert master.core.tick == tick
    return step


def test_a_reset_that_meets_a_new_epoch_hands_out_its_first_frame(pair):
    server, master, env, _ = pair
    both(master, env)
    master.rebuild(7)
    _, info = env.reset()
    assert (info["event_episode"], info["event_step"]) == (0, 0)
    assert server.world.snapshot.tick == 0
    assert both(master, env)[4]["event_step"] == 1


def test_only_the_master_begins_a_shared_world_again(pair):
    _, master, env, _ = pair
    both(master, env)
    with pytest.raises(NotMasterError, match="only the master may restart"):
        env.reset(seed=5)
    assert both(master, env)[4]["event_step"] == 2, "the episode goes on"


def test_a_client_that_was_given_up_hears_of_it_and_may_come_again(hall):
    server = hall(1, 1)
    env = WheelchairEnv(config=CONFIG, join=seat_of())
    env.reset()
    env.step(40)
    server.hub.feed(ClientLostEvent(env._link.core.session, "it hung"), time.monotonic())
    with pytest.raises(EvictedError, match="it hung"):
        env.step(40)
    _, info = env.reset(seed=1)
    assert (info["event_episode"], info["event_step"]) == (1, 0)
    assert env.step(40)[4]["event_step"] == 1
    env.close()


def test_closing_leaves_and_the_others_go_on(pair):
    server, master, env, _ = pair
    both(master, env)
    env.close()
    assert [member.name for member in server.hub.core.roster.by_seat()] == ["master"]
    assert master.act(master.core.tick, AHEAD).tick == 2
    with pytest.raises(ProtocolError, match="call reset"):
        env.step(40)


def test_a_world_with_other_cameras_is_refused(hall):
    server = hall(1, 1)
    env = WheelchairEnv(preset="quick", overrides=("world.warmup_s=0",), join=seat_of())
    with pytest.raises(ConfigMismatchError, match="use its configuration"):
        env.reset()
    env.close()
    assert server.hub.core.roster.by_seat() == []


def test_a_world_that_is_killed_and_comes_back_cuts_the_episode(tmp_path):
    """As a launcher sees to it; the world is a stand-in."""
    with Server(stand_in_order(tmp_path, seats=1, run=str(tmp_path / "run")), tmp_path) as server:
        env = WheelchairEnv(config=CONFIG, join=server.seat("env", spec=SeatSpec()))
        env.reset()
        for _ in range(5):
            last = env.step(40)
        server.kill()
        server.start()
        step = env.step(40)
        assert (step.truncated, step.reward, step.info["world_restarted"]) == (True, 0.0, True)
        assert equal(step.observation, last.observation)
        assert env.reset()[1]["event_step"] == 0
        assert [env.step(40).info["event_step"] for _ in range(3)] == [1, 2, 3]
        env.close()


def test_a_chair_without_an_episode_has_nothing_to_cut_or_to_go_on_with():
    chair = SeatEnvAdapter(CONFIG)
    for call in (chair.truncate, chair.begin_next):
        with pytest.raises(ProtocolError, match="expected one that has"):
            call()
    assert chair.picture is None
    assert not chair.ready
