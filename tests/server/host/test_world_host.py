"""The hub: what it writes, what it refuses, and where pictures of a recovered world go."""

from __future__ import annotations

import numpy as np

from benchmarks.barrier.fake_world import FakeWorld
from tests.support.worlds import quick_config
from wcsim.log.records import Admitted
from wcsim.server.host.world_host import WorldHost, sealed
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import Received, Rules
from wcsim.server.protocol.members import Member
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import WorldOrder
from wcsim.server.transport.shared_images import RingSink, RingView
from wcsim.types import Command, Joystick, SeatSpec


def join(profile: str = "competent", claim: bytes = b"secret") -> m.Join:
    return m.Join(
        protocol=m.PROTOCOL,
        schema=m.schema_hash(),
        config="",
        session=b"0123456789abcdef",
        claim=claim,
        seat=0,
        name="a",
        spec=SeatSpec(profile=profile),
    )


def stand_in(*specs: SeatSpec | None) -> FakeWorld:
    return FakeWorld(WorldOrder(town="", config=quick_config(), seed=1), specs, 1)


def test_pictures_of_a_recovered_world_lie_where_its_clients_look_for_them(tmp_path):
    world = stand_in(SeatSpec(), SeatSpec())
    for _ in range(3):
        world.tick([Command(seat=s, tick=world.snapshot.tick, joystick=Joystick(0.1, 0.5)) for s in (0, 1)])
    kept = [Member(seat=seat, name="", spec=SeatSpec(), life=0) for seat in (0, 1)]
    ring = RingSink(tmp_path, 2, quick_config().cameras)
    core = ServerCore(Rules(capacity=2), 0, 3, kept)
    WorldHost(core, world, lambda peer, message: None, sink=ring)
    for client in world.snapshot.clients:
        (images,) = RingView(ring.path(client.seat)).pictures(ring.slot(3), False)
        (frame,) = client.sensors.cameras
        assert np.array_equal(images.depth_m, frame.depth_m) and np.array_equal(images.class_id, frame.class_id)
        assert frame.depth_m.any()


def test_a_claim_is_kept_sealed():
    records, posted = [], []
    hub = WorldHost(
        ServerCore(Rules(capacity=1)), stand_in(None), lambda p, message: posted.append(message), records.append
    )
    hub.feed(Received(b"p", join()), 0.0)
    (admitted,) = [record for record in records if isinstance(record, Admitted)]
    assert admitted.claim == sealed(b"secret").hex() and b"secret".hex() not in admitted.claim
    assert hub.core.cycle.roll.members[0].claim == sealed(b"secret")
    assert any(isinstance(message, m.Frame) for message in posted)


def test_a_world_that_is_not_begun_again_does_not_say_that_it_loads():
    said = []
    hub = WorldHost(
        ServerCore(Rules(capacity=1)), stand_in(None), lambda p, message: None, loading=lambda: said.append(True)
    )
    hub.feed(Received(b"p", join()), 0.0)
    hub.feed(Received(b"p", m.Rebuild(join().session, 0, -1)), 0.0)
    assert not said
    hub.feed(Received(b"p", m.Rebuild(join().session, 0, 3)), 0.0)
    assert said == [True] and hub.core.cycle.epoch == 1


def test_a_user_that_does_not_exist_gets_no_seat():
    posted = []
    hub = WorldHost(ServerCore(Rules(capacity=1)), stand_in(None), lambda p, message: posted.append(message))
    hub.feed(Received(b"p", join(profile="drunk")), 0.0)
    (failure,) = posted
    assert failure.error == "ConfigError" and "drunk" in failure.message
    assert not hub.core.cycle.roll.members and not hub.core.cycle.roll.pending
