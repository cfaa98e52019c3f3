"""What travels between clients and a server: typed msgpack messages, no pickle, bounded in size.

Every request carries the session of its client, and what it is about: epoch, tick and life (the number of respawns at
that tick). Nothing is "the next", so a request that comes twice, or late, does nothing twice.
"""

from __future__ import annotations

import hashlib
from functools import cache
from typing import Any

import msgspec
import numpy as np

from wcsim import errors
from wcsim.errors import ProtocolError, WcsimError
from wcsim.server.packed import PackedClient, Pictures, packed, unpacked
from wcsim.types import ClientSnapshot, SeatSpec

PROTOCOL = 3
MAX_REQUEST_BYTES = 1 << 20  # a server refuses more
MAX_REPLY_BYTES = 64 << 20  # a client refuses more: pictures travel inside when there is no shared memory
SESSION_BYTES = 16
ANY_SEAT = -1


class _Message(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True, array_like=True):
    """Base of all messages: a tagged array, unknown fields refused."""


# --- requests ---


class Join(_Message, frozen=True):
    """A client wants a seat."""

    protocol: int
    schema: str
    config: str  # hash of the configuration that the client expects of the world, "" for any
    session: bytes  # drawn anew for every connection
    claim: bytes  # drawn once by a client or its launcher: who shows it again takes the seat over
    seat: int  # or ANY_SEAT
    name: str
    spec: SeatSpec
    pid: int = 0  # of a client on the same machine, which gets its pictures through shared memory; 0 for others
    resume: tuple[int, int] | None = None  # epoch and tick of the last frame that the client has, to go on from


class Act(_Message, frozen=True):
    """Drive through a tick."""

    session: bytes
    epoch: int
    tick: int
    life: int
    x: float
    y: float


class Tick(_Message, frozen=True):
    """The master carries both simulators on; refused unless the barrier of that tick is full."""

    session: bytes
    epoch: int
    tick: int
    term: int


class Respawn(_Message, frozen=True):
    """Begin the seat's next episode, without a tick."""

    session: bytes
    epoch: int
    tick: int
    life: int


class Rebuild(_Message, frozen=True):
    """Begin the world again with another seed; for a sole client or the master."""

    session: bytes
    epoch: int
    seed: int


class Beat(_Message, frozen=True):
    """The client works: a counter that its training moves on, so that a hung one is not taken for a slow one."""

    session: bytes
    progress: int


class Leave(_Message, frozen=True):
    """The client is done."""

    session: bytes


# --- replies ---


class Welcome(_Message, frozen=True):
    """The client has its seat; its frame follows."""

    session: bytes
    epoch: int
    tick: int
    seat: int
    term: int  # of its mastership, 0 for a client that is not the master
    resumed: bool  # the seat's episode goes on as if nothing had happened
    ring: str = ""  # where the seat's pictures are, for a client on the same machine
    config_json: str = ""  # the world's configuration
    town: str = ""


class BarrierFull(_Message, frozen=True):
    """To the master: everybody has acted, ask for the tick."""

    epoch: int
    tick: int
    term: int


class Promote(_Message, frozen=True):
    """The client is the master from now on."""

    term: int


class Demoted(_Message, frozen=True):
    """The client is the master no more."""

    term: int


class TickDone(_Message, frozen=True):
    """The simulation has reached this tick (the paper's end of simulation)."""

    epoch: int
    tick: int
    step_s: float = 0.0  # what the world took for it


class Frame(_Message, frozen=True):
    """What the sensors of the seat say; with a slot, the pictures lie there in the seat's shared memory."""

    epoch: int
    tick: int
    life: int
    client: ClientSnapshot | None
    slot: int = -1


class Restarted(_Message, frozen=True):
    """A new epoch has begun; the seat's first frame in it follows."""

    epoch: int
    reason: str


class Waiting(_Message, frozen=True):
    """The server lives and waits for the actions of these clients."""

    epoch: int
    tick: int
    late: tuple[str, ...]


class Failure(_Message, frozen=True):
    """A request went wrong: the name of an error in `wcsim.errors`, and its message."""

    error: str
    message: str
    session: bytes = b""


class Bye(_Message, frozen=True):
    """The client has left as asked, or the server ends."""

    session: bytes
    reason: str = ""


Request = Join | Act | Tick | Respawn | Rebuild | Beat | Leave
Reply = Welcome | BarrierFull | Promote | Demoted | TickDone | Frame | Restarted | Waiting | Failure | Bye


class _PackedFrame(_Message, frozen=True, tag="Frame"):
    """A `Frame` as it travels."""

    epoch: int
    tick: int
    life: int
    client: PackedClient | None
    slot: int


_OtherReply = Welcome | BarrierFull | Promote | Demoted | TickDone | Restarted | Waiting | Failure | Bye


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot send a {type(value).__name__}")


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_plain)
_REQUESTS: msgspec.msgpack.Decoder[Request] = msgspec.msgpack.Decoder(Request)
_REPLIES: msgspec.msgpack.Decoder[_OtherReply | _PackedFrame] = msgspec.msgpack.Decoder(_OtherReply | _PackedFrame)


@cache
def schema_hash() -> str:
    """A short hash of all fields of all messages: two programs with the same one understand each other."""
    kinds = (*Request.__args__, *_OtherReply.__args__, _PackedFrame)
    _, parts = msgspec.json.schema_components(kinds)
    text = msgspec.json.encode(parts, order="deterministic")
    return hashlib.blake2b(text, digest_size=8).hexdigest()


def encode(message: Request | Reply) -> bytes:
    """A message as bytes; a frame has its pictures inside unless they are in a slot of shared memory."""
    if isinstance(message, Frame):
        client = message.client
        inside = None if client is None else packed(client, pictures=message.slot < 0)
        return _ENCODER.encode(_PackedFrame(message.epoch, message.tick, message.life, inside, message.slot))
    return _ENCODER.encode(message)


def decode_request(data: bytes) -> Request:
    """Bytes as a request. Raises OverloadedError when there are too many, ProtocolError for anything else."""
    request: Request = _decode(data, _REQUESTS, MAX_REQUEST_BYTES)
    return request


def decode_reply(data: bytes, shared: Pictures | None = None) -> Reply:
    """Bytes as a reply; pictures that did not travel are taken from `shared`, or empty.

    Raises OverloadedError when there are too many bytes, ProtocolError for anything else that is no reply.
    """
    reply: _OtherReply | _PackedFrame = _decode(data, _REPLIES, MAX_REPLY_BYTES)
    if isinstance(reply, _PackedFrame):
        client = None if reply.client is None else unpacked(reply.client, reply.slot, shared)
        return Frame(reply.epoch, reply.tick, reply.life, client, reply.slot)
    return reply


def _decode(data: bytes, decoder: msgspec.msgpack.Decoder[Any], limit_bytes: int) -> Any:
    if len(data) > limit_bytes:
        raise errors.OverloadedError(f"a message of {len(data)} bytes; expected at most {limit_bytes}")
    try:
        return decoder.decode(data)
    except (msgspec.MsgspecError, TypeError, ValueError, RecursionError) as error:
        raise ProtocolError(f"a message does not fit protocol {PROTOCOL}: {error}") from None


def failure_of(error: WcsimError, session: bytes = b"") -> Failure:
    """An error as the message that carries it."""
    return Failure(error=type(error).__name__, message=str(error), session=session)


def error_of(failure: Failure) -> WcsimError:
    """The error that a message carries, under its own name."""
    kind = getattr(errors, failure.error, None)
    known = isinstance(kind, type) and issubclass(kind, WcsimError)
    return (kind if known else WcsimError)(failure.message)  # type: ignore[misc]
