"""Whatever comes from a peer is checked before it touches anything."""

from pathlib import Path

import msgspec
import pytest
from msgspec import inspect

from tests.attack.outcomes import Tally
from tests.attack.peers.messages import Besieged, field_cases
from tests.attack.peers.wire import shapes, unbounded
from wcsim.server.protocol import messages as m

KINDS = (*m.Request.__args__, *m.Reply.__args__)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_field_has_a_bound(kind: type[msgspec.Struct]) -> None:
    assert list(unbounded(inspect.type_info(kind), kind.__name__)) == []


def test_a_field_without_a_bound_is_found() -> None:
    class Careless(msgspec.Struct):
        text: str
        inner: tuple[int, ...]
        anything: dict[str, float]

    found = list(unbounded(inspect.type_info(Careless), "Careless"))
    assert [place.split(" ")[0] for place in found] == [
        "Careless.text", "Careless.inner", "Careless.inner", "Careless.anything",
    ]  # fmt: skip


def test_a_sound_one_of_every_kind_is_taken() -> None:
    for shape in shapes():
        decode = m.decode_request if shape.request else m.decode_reply
        assert decode(msgspec.msgpack.encode(shape.sound)) is not None


def test_every_field_times_every_nasty_value() -> None:
    tally = Tally().run(field_cases())
    assert tally.defects == []
    assert tally.total > 10_000


def test_the_siege_sees_a_server_that_lets_an_honest_client_go(tmp_path: Path) -> None:
    siege = Besieged(tmp_path)
    assert siege.attack(b"")
    siege.core.roster.members[0].action = None
    siege.say(b"Lhonest", m.encode_message(m.Leave(b"h" * 16)))
    assert not siege.attack(b"")
    siege.close()
