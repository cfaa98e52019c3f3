"""The host of a world: what it writes, and what it refuses."""

from typing import Any

from benchmarks.barrier.fake_world import FakeWorld
from tests.server.protocol.desk import join_of
from tests.support.worlds import quick_config
from wcsim.log.records import Admitted, record_to_bytes
from wcsim.server.host.world_host import WorldEffectExecutor
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import MessageReceivedEvent, ServerRules
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import WorldBuildSpec
from wcsim.types import SeatSpec


def join(profile: str = "competent", claim: bytes = b"secret") -> m.Join:
    return join_of(0, claim=claim, name="a", spec=SeatSpec(profile=profile))


def host_of(posted: list[m.Reply], **options: Any) -> WorldEffectExecutor:
    """The host of a fake world with one free seat."""
    world = FakeWorld(WorldBuildSpec(town="", config=quick_config(), seed=1), (None,), 1)
    return WorldEffectExecutor(
        ServerCore(ServerRules(capacity=1)), world, lambda p, message: posted.append(message), **options
    )


def test_a_claim_is_in_no_journal():
    """Whoever reads one could take the seat."""
    records, posted = [], []
    host_of(posted, write=records.append).feed(MessageReceivedEvent(b"p", join()), 0.0)
    (admitted,) = [record for record in records if isinstance(record, Admitted)]
    assert admitted.name == "a" and b"secret" not in record_to_bytes(admitted)
    assert any(isinstance(message, m.Frame) for message in posted)


def test_a_world_that_is_not_begun_again_does_not_say_that_it_loads():
    said = []
    host = host_of([], loading=lambda: said.append(True))
    host.feed(MessageReceivedEvent(b"p", join()), 0.0)
    host.feed(MessageReceivedEvent(b"p", m.Rebuild(join().session, 0, -1)), 0.0)
    assert not said
    host.feed(MessageReceivedEvent(b"p", m.Rebuild(join().session, 0, 3)), 0.0)
    assert said == [True] and host.core.epoch == 1


def test_a_user_that_does_not_exist_gets_no_seat():
    posted = []
    host = host_of(posted)
    host.feed(MessageReceivedEvent(b"p", join(profile="drunk")), 0.0)
    (failure,) = posted
    assert failure.error == "ConfigError" and "drunk" in failure.message
    assert not host.core.roster.members and not host.core.roster.pending
