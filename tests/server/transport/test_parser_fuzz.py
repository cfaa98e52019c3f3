"""Whatever bytes come: an error with a name, and nobody else notices."""

import itertools
import threading
import time
from typing import Any

import msgspec
import numpy as np
import pytest
import zmq
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.barrier.fake_world import FakeWorld
from tests.attack.scenarios.twists import Rng, integer, pick
from tests.server.protocol.test_messages import REPLIES, REQUESTS
from tests.server.servers import AHEAD, Server, stand_in_order
from tests.support.worlds import quick_config
from wcsim.errors import OverloadedError, ProtocolError
from wcsim.server.ledger import audit_ledgers, iter_ledger_frames
from wcsim.server.links.socket import SocketSeatLink
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import WorldBuildSpec
from wcsim.server.transport.sockets import BURST, MESSAGES_PER_S
from wcsim.types import SeatSpec

NAMED = (ProtocolError, OverloadedError)
WORLD = FakeWorld(WorldBuildSpec(town="x", config=quick_config(), seed=1), (SeatSpec(),), 1)
FRAME = m.Frame(0, 0, 0, WORLD.snapshot.clients[0])
VALID = [m.encode_message(message) for message in (*REQUESTS, *REPLIES, FRAME)]
HUGE = [b"\xc6\xff\xff\xff\xff", b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xdb\xff\xff\xff\xff\xa3Act"]
NESTED = [b"\x91" * 100_000, b"\x81\xa1x" * 50_000, b"\x92\xa4Join" + b"\x91" * 5_000]


def mutated(rng: Rng) -> bytes:
    """A valid message with some bytes changed, cut off, doubled or moved."""
    data = bytearray(pick(rng, VALID))
    for _ in range(int(rng.integers(1, 4))):
        at = integer(rng, len(data) + 1)
        match integer(rng, 5):
            case 0 if at < len(data):
                data[at] ^= 1 << integer(rng, 8)
            case 1:
                del data[at:]
            case 2:
                data[at:at] = pick(rng, HUGE)
            case 3:
                data += data[at:]
            case _:
                del data[at : at + 1]
    return bytes(data)


def loose(kind: Any) -> st.SearchStrategy[bytes]:
    """An array that begins like a message and goes on with anything."""
    numbers = st.one_of(st.none(), st.integers(-(2**63), 2**64 - 1), st.floats())
    plain = st.one_of(numbers, st.binary(max_size=20), st.text(max_size=9))
    fields = st.one_of(plain, st.lists(plain, max_size=6))
    return st.lists(fields, max_size=12).map(lambda row: msgspec.msgpack.encode([kind, *row]))


def taken_in(decode, data):
    """Whether it is a message; anything but a named error is a failure."""
    try:
        message = decode(data)
    except NAMED as error:
        assert str(error)
        return False
    m.encode_message(message)
    return True


@settings(max_examples=150)
@given(st.one_of(st.binary(max_size=200), st.sampled_from(["Act", "Join", "Tick", "Frame"]).flatmap(loose)))
def test_any_bytes_are_a_message_or_a_named_error(data):
    taken_in(m.decode_request, data)
    taken_in(m.decode_reply, data)


@pytest.mark.parametrize("data", [*HUGE, *NESTED], ids=range(len(HUGE) + len(NESTED)))
def test_what_claims_to_be_endless_is_refused(data):
    assert not taken_in(m.decode_request, data)
    assert not taken_in(m.decode_reply, data)


def test_messages_that_were_spoilt_are_messages_or_named_errors():
    rng = np.random.default_rng(3)
    refused = sum(not taken_in(m.decode_request, data) for data in (mutated(rng) for _ in range(6_000)))
    assert 3_000 < refused < 6_000
    for _ in range(2_000):
        taken_in(m.decode_reply, mutated(rng))


@pytest.mark.parametrize("data", VALID[:-1], ids=[type(message).__name__ for message in (*REQUESTS, *REPLIES)])
def test_a_message_that_was_cut_off_is_refused(data):
    assert not any(taken_in(m.decode_request, data[:cut]) for cut in range(len(data)))
    assert not any(taken_in(m.decode_reply, data[:cut]) for cut in range(len(data)))


def test_all_valid_ones_are_taken_in():
    assert all(taken_in(m.decode_request, data) for data in VALID[: len(REQUESTS)])
    assert all(taken_in(m.decode_reply, data) for data in VALID[len(REQUESTS) :])


class Vandal(threading.Thread):
    """Sends the worst to a server until it is told to stop; never waits for an answer."""

    def __init__(self, endpoint: str, seen: list[bytes]) -> None:
        super().__init__(daemon=True)
        self.done = threading.Event()
        self.sent = 0
        self.told: set[str] = set()
        self._endpoint, self._seen = endpoint, seen

    def run(self) -> None:
        rng = np.random.default_rng(5)
        with zmq.Context() as context:
            while not self.done.is_set():
                with context.socket(zmq.DEALER) as socket:  # each has 20 faults before it is not heard any more
                    socket.setsockopt(zmq.LINGER, 0)
                    socket.connect(self._endpoint)
                    for _ in range(40):
                        self._spoil(socket, rng)
                    if socket.poll(200):
                        self._listen(socket)

    def _spoil(self, socket: zmq.Socket[bytes], rng: Rng) -> None:
        choices = [rng.bytes(30), b"", VALID[-1], VALID[0], *self._seen[-20:], *self._seen[:1]]
        data = pick(rng, choices)
        parts = [data, data] if rng.integers(8) == 0 else [data]
        if rng.integers(40) == 0:
            parts = [bytes(m.MAX_REQUEST_BYTES + 100)]
        try:
            socket.send_multipart(parts, zmq.NOBLOCK)
            self.sent += 1
        except zmq.Again:
            self.done.wait(0.01)

    def _listen(self, socket: zmq.Socket[bytes]) -> None:
        while socket.poll(0):
            reply = m.decode_reply(socket.recv_multipart()[-1])
            if isinstance(reply, m.Failure):
                self.told.add(reply.error)


def test_a_good_client_loses_nothing_whatever_others_send(tmp_path):
    order = stand_in_order(tmp_path, rules=ServerRules(capacity=2, expected=1))
    with Server(order, tmp_path) as server, SocketSeatLink(server.seat("a", ledger=f"{tmp_path}/a")) as a:
        server.status()
        seen: list[bytes] = []
        a._post = lambda message, then=a._post: (seen.append(m.encode_message(message)), then(message))
        frame = a.join()
        vandal = Vandal(server.order.endpoint, seen)
        vandal.start()
        try:
            for tick in itertools.count():
                frame = a.act(frame.tick, AHEAD)
                assert frame.tick == tick + 1
                if frame.tick >= 300 and vandal.sent > 200 and vandal.told:
                    break
        finally:
            vandal.done.set()
            vandal.join(60.0)
        assert "ProtocolError" in vandal.told
        assert server.status(lambda s: s.tick == frame.tick).members == ("a",)
    _, (found,) = audit_ledgers((), [(0, iter_ledger_frames(tmp_path / "a"))])
    assert (found.steps, found.missing) == (frame.tick, 0)


def test_who_sends_too_much_is_told_and_then_not_heard(tmp_path):
    with Server(stand_in_order(tmp_path), tmp_path) as server, zmq.Context() as context:
        server.status()
        with context.socket(zmq.DEALER) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.SNDHWM, 100_000)
            socket.connect(server.order.endpoint)
            act, began_s = m.encode_message(REQUESTS[1]), time.monotonic()
            for _ in range(40_000):
                socket.send(act)
            told = []
            while socket.poll(1000):
                told.append(type(m.error_from_failure(m.decode_reply(socket.recv()))).__name__)
            lasted_s = time.monotonic() - began_s
        assert told.count("OverloadedError") <= 20
        # a machine that has other work to do may read them so slowly that they are not too many
        assert len(told) < 40_000 or BURST + MESSAGES_PER_S * lasted_s >= 40_000
        with SocketSeatLink(server.seat("a")) as a:
            assert a.join().tick == 0
