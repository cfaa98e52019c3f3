"""A peer that says what it likes to a world process, over the network's door."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import zmq

from tests.server.protocol.desk import join_of
from tests.server.servers import stand_in_order
from wcsim.server.protocol import messages as m
from wcsim.server.specs import WorldProcessSpec
from wcsim.server.transport.keys import read_client_keys, read_server_public_key
from wcsim.types import SeatSpec

ANSWER_MS = 30_000


def real_order(town: Path, folder: Path, **changes: object) -> WorldProcessSpec:
    """A world process with a real world in it, whose network door is on loopback."""
    order = stand_in_order(folder, **{"seats": 4, "listen": "tcp://127.0.0.1:*", **changes})
    return replace(order, town=str(town))


def a_join(spec: SeatSpec | None = None, **other: object) -> m.Join:
    """A join; nothing in it is checked on this side."""
    own = {"session": secrets.token_bytes(16), "claim": secrets.token_bytes(16), "seat": m.ANY_SEAT, "name": "x"}
    return join_of(0, **{**own, "spec": spec or SeatSpec(), **other})


class Attacker:
    """A connection of its own; a context manager."""

    def __init__(self, endpoint: str, keys: Path | None = None, name: str = "") -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.RCVTIMEO, ANSWER_MS)
        if keys is not None:
            pair = read_client_keys(keys, name)
            self._socket.curve_serverkey = read_server_public_key(keys)
            self._socket.curve_publickey, self._socket.curve_secretkey = pair.public, pair.secret
        self._socket.connect(endpoint)

    def say(self, message: m.Request | bytes) -> Sequence[m.Reply]:
        """Say it, and hear the answer."""
        self.shout(message)
        return self.hear()

    def shout(self, message: m.Request | bytes) -> None:
        """Say it."""
        self._socket.send(message if isinstance(message, bytes) else m.encode_message(message))

    def hear(self) -> Sequence[m.Reply]:
        """The next that is said."""
        return [m.decode_reply(part) for part in self._socket.recv_multipart()]

    def news(self, within_ms: int) -> Sequence[m.Reply]:
        """What is said within that time, but that others are waited for."""
        told = self.hear() if self.answers(within_ms) else ()
        return [reply for reply in told if not isinstance(reply, m.Waiting)]

    def answers(self, within_ms: int) -> bool:
        """Whether anything is said within that time."""
        return bool(self._socket.poll(within_ms))

    def __enter__(self) -> Attacker:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.destroy(0)


def refusal(replies: Sequence[m.Reply]) -> m.Failure:
    """The first answer; all of them are refusals."""
    failures = [reply for reply in replies if isinstance(reply, m.Failure)]
    assert failures and len(failures) == len(replies), replies
    return failures[0]
