"""A fork says what the user alone would come to, and is the same as driving there."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from tests.agents.evaluation.suite.lists import POINTS
from tests.support.worlds import open_world
from wcsim.agents.evaluation.suite.alarms import ALONE_S, _users_alone, crash_alone_s
from wcsim.bridge.world_rollout import rollout
from wcsim.types import SeatSpec


@pytest.fixture
def ahead(tmp_path):
    """A recorded user who drives straight on."""
    stick = tmp_path / "ahead.csv"
    stick.write_text("time_s,x,y\n" + "".join(f"{0.1 * k:.1f},0,1\n" for k in range(200)))
    return f"recorded:{stick}"


def test_forks_of_every_seat_move_nothing(corner):
    def driven(asked_at):
        with open_world(corner, seats=2, seed=5, spec=SeatSpec(profile="inattentive", max_steps=4000)) as world:
            steps = rollout(world, dict.fromkeys((0, 1), _users_alone(POINTS)))
            hashes = []
            for tick in range(6):
                if tick in asked_at:
                    crash_alone_s(world, asked_at[tick], POINTS, 0.1)
                hashes.append(next(steps).after.state_hash)
            return hashes

    assert driven({1: 0, 3: 1}) == driven({})


@contextmanager
def at_an_edge(corner, profile, max_steps):
    """The steps of a user who faces a kerb, and when the user alone would crash."""
    with open_world(corner, seed=2, spec=SeatSpec(profile=profile, max_steps=max_steps)) as world:
        _face_an_edge(world)
        steps = rollout(world, {0: _users_alone(POINTS)})
        next(steps)
        yield steps, crash_alone_s(world, 0, POINTS, 0.1)


def test_a_user_who_drives_off_the_kerb_crashes_in_the_fork_too(corner, ahead):
    with at_an_edge(corner, ahead, 4000) as (steps, alone_s):
        assert alone_s is not None and 0.5 < alone_s < ALONE_S
        ticks = 1
        while not next(steps).after.clients[0].events.crashed:
            ticks += 1
        assert alone_s == pytest.approx(0.1 * ticks)  # with nobody taken out a fork is the same to the tick


def _face_an_edge(world):
    here, grid = world.snapshot.clients[0].plant.p_WB_m[:2].copy(), world.street.grid
    yaw_rad = next(yaw for yaw in np.linspace(0.0, 2.0 * np.pi, 64) if _edge(grid, here, yaw))
    world.put_chair(0, here, float(yaw_rad))


def _edge(grid, here_m, yaw_rad):
    """Whether the ground falls by a kerb on the way of some metres."""
    way = here_m + np.arange(0.0, 3.5, 0.1)[:, None] * [np.cos(yaw_rad), np.sin(yaw_rad)]
    return float(grid.raised_at(way[:8]).min()) - float(grid.raised_at(way).min()) > 0.1


def test_a_fork_ends_where_an_episode_does(corner, monkeypatch):
    """What happens on the way to the next destination is no danger of this one."""
    with open_world(corner, seed=2) as world:
        tick, done = world.tick, []

        def arriving(commands):
            snapshot = tick(commands)
            (client,) = snapshot.clients
            done.append(client)
            events = replace(client.events, arrived=len(done) == 3, crashed=len(done) == 4)
            return replace(snapshot, clients=(replace(client, events=events),))

        monkeypatch.setattr(world, "tick", arriving)
        assert crash_alone_s(world, 0, POINTS, 0.1) is None


def test_a_fork_at_the_end_of_an_episode_looks_as_far_ahead_as_any_other(corner, ahead):
    found = []
    for max_steps in (4000, 2):
        with at_an_edge(corner, ahead, max_steps) as (steps, alone_s):
            found.append(alone_s)
            assert next(steps).after.clients[0].events.truncated == (max_steps == 2)
    assert found[0] is not None and found[0] == found[1]
