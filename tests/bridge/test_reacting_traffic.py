"""The traffic near chairs without an engine: the same tick as a world's, for who leads the chairs by hand."""

from contextlib import ExitStack

import numpy as np
import pytest

from tests.support.worlds import follow, open_world
from wcsim.bridge.epoch import ReactingTraffic
from wcsim.bridge.reaction.attention import AttentionModel
from wcsim.bridge.sumo.session import SumoSession, open_session
from wcsim.core import seeding
from wcsim.types.episode import RunPlace

TICKS = 250


def test_a_worlds_actors_are_those_of_its_traffic_alone_round_the_same_chairs(corner):
    with open_world(corner, seed=4, seats=2) as world:
        town, config, street = world.town, world.config, world.street
        places, actors, chairs, signals = [world._places()], [world.snapshot.actors], [], []
        for _ in range(TICKS):
            snapshot = follow(world)
            chairs.append(world._open.traffic.chairs)
            places.append(np.array([chair.p_W_m for chair in chairs[-1]]))
            actors.append(snapshot.actors)
            signals.append(snapshot.signals)
            assert all(client.first is None for client in snapshot.clients), "nobody is put elsewhere"
    with ExitStack() as held:
        _, sumo = open_session(town, config, 4, RunPlace(), street.net_origin_m[2], held)
        habits = AttentionModel(config.world, seeding.derive_seed(4, "street"))
        traffic = ReactingTraffic(config.world, street.grid, sumo, habits)
        traffic.look_again(places[0])
        assert traffic.actors == actors[0]
        for tick in range(TICKS):
            traffic.react(chairs[tick])
            sumo.step()
            traffic.move(traffic.read(places[tick + 1]), places[tick + 1])
            assert (traffic.actors, traffic.signals) == (actors[tick + 1], signals[tick])
    assert any(actor.deflect_m for near in actors for actor in near), "somebody stepped aside"


@pytest.mark.parametrize("range_m, reach_m", [(10.0, 60.0), (40.0, 60.0), (150.0, 170.0)])
def test_lights_are_known_as_far_as_a_camera_sees_their_heads(corner, monkeypatch, range_m, reach_m):
    asked = []
    monkeypatch.setattr(SumoSession, "signals", lambda self, places, within_m: asked.append(within_m) or ())
    with open_world(corner, f"cameras.0.range_m={range_m}", "world.mirror_radius_m=150") as world:
        follow(world)
    assert set(asked) == {reach_m}
