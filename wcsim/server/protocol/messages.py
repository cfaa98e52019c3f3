"""What travels between clients and a server: typed msgpack messages, never pickle, every field bounded.

Every request carries the session of its client, and what it is about: epoch, tick and life (the number of respawns at
that tick). The bounds are those of `server/protocol/bounds.py`. Nothing is "the next", so a request that comes twice,
or late, does nothing twice.
"""

from __future__ import annotations

import hashlib
from functools import cache
from typing import Annotated, Any

import msgspec
import numpy as np

from wcsim import errors
from wcsim.core.reading import escaped
from wcsim.errors import ProtocolError, WcsimError
from wcsim.log.records import MOST_SEATS
from wcsim.server.protocol import bounds as b
from wcsim.server.protocol.frame_codec import Pictures, packed, packed_spec, unpacked, unpacked_spec
from wcsim.server.protocol.parts import PackedClient, PackedSpec
from wcsim.types import ClientSnapshot, SeatSpec

PROTOCOL = 6
MAX_REQUEST_BYTES = 1 << 13  # a server refuses more; the longest join has less
MAX_REPLY_BYTES = 64 << 20  # a client refuses more: pictures travel inside when there is no shared memory
SESSION_BYTES = b.SESSION_BYTES
ANY_SEAT = -1


class _Message(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True, array_like=True):
    """Base of all messages: a tagged array, unknown fields refused."""


# --- requests ---


class Join(_Message, frozen=True):
    """A client wants a seat."""

    protocol: b.Count
    schema: b.Hash
    config: b.Hash  # hash of the configuration that the client expects of the world, "" for any
    session: b.Session  # drawn anew for every connection
    claim: b.Claim  # drawn once by a client or its launcher: who shows it again takes the seat over
    seat: b.SeatOrAny  # or ANY_SEAT
    name: b.Name
    spec: SeatSpec
    pid: b.Process = 0  # of a client on the same machine, which gets its pictures through shared memory; 0 for others
    resume: tuple[b.Count, b.Count] | None = None  # epoch and tick of the last frame that the client has, to go on from


class Act(_Message, frozen=True):
    """Drive through a tick."""

    session: b.Session
    epoch: b.Count
    tick: b.Count
    life: b.Count
    x: b.Stick
    y: b.Stick


class Tick(_Message, frozen=True):
    """The master carries both simulators on; refused unless the barrier of that tick is full."""

    session: b.Session
    epoch: b.Count
    tick: b.Count
    term: b.Count


class Respawn(_Message, frozen=True):
    """Begin the seat's next episode, without a tick."""

    session: b.Session
    epoch: b.Count
    tick: b.Count
    life: b.Count


class Rebuild(_Message, frozen=True):
    """Begin the world again with another seed; for a sole client or the master."""

    session: b.Session
    epoch: b.Count
    seed: b.Seed


class Beat(_Message, frozen=True):
    """The client works: a counter that its training moves on, so that a hung one is not taken for a slow one."""

    session: b.Session
    progress: b.Count


class Leave(_Message, frozen=True):
    """The client is done."""

    session: b.Session


# --- replies ---


class Welcome(_Message, frozen=True):
    """The client has its seat; its frame follows."""

    session: b.Session
    epoch: b.Count
    tick: b.Count
    seat: b.Seat
    term: b.Count  # of its mastership, 0 for a client that is not the master
    resumed: bool  # the seat's episode goes on as if nothing had happened
    ring: b.Place = ""  # where the seat's pictures are, for a client on the same machine
    config_json: b.Document = ""  # the world's configuration
    town: b.Place = ""


class BarrierFull(_Message, frozen=True):
    """To the master: everybody has acted, ask for the tick."""

    epoch: b.Count
    tick: b.Count
    term: b.Count


class Promote(_Message, frozen=True):
    """The client is the master from now on."""

    term: b.Count


class Demoted(_Message, frozen=True):
    """The client is the master no more."""

    term: b.Count


class TickDone(_Message, frozen=True):
    """The simulation has reached this tick (the paper's end of simulation)."""

    epoch: b.Count
    tick: b.Count
    step_s: b.Seconds = 0.0  # what the world took for it


class Frame(_Message, frozen=True):
    """What the sensors of the seat say; with a slot, the pictures lie there in the seat's shared memory."""

    epoch: b.Count
    tick: b.Count
    life: b.Count
    client: ClientSnapshot | None
    slot: b.Slot = -1


class Restarted(_Message, frozen=True):
    """A new epoch has begun; the seat's first frame in it follows."""

    epoch: b.Count
    reason: b.Text


class Waiting(_Message, frozen=True):
    """The server lives and waits for the actions of these clients."""

    epoch: b.Count
    tick: b.Count
    late: Annotated[tuple[b.Name, ...], msgspec.Meta(max_length=MOST_SEATS)]


class Failure(_Message, frozen=True):
    """A request went wrong: the name of an error in `wcsim.errors`, and its message."""

    error: b.Name
    message: b.Text
    session: b.SessionOrNone = b""


class Bye(_Message, frozen=True):
    """The client has left as asked, or the server ends."""

    session: b.SessionOrNone
    reason: b.Text = ""


Request = Join | Act | Tick | Respawn | Rebuild | Beat | Leave
Reply = Welcome | BarrierFull | Promote | Demoted | TickDone | Frame | Restarted | Waiting | Failure | Bye


class _PackedFrame(_Message, frozen=True, tag="Frame"):
    """A `Frame` as it travels."""

    epoch: b.Count
    tick: b.Count
    life: b.Count
    client: PackedClient | None
    slot: b.Slot


class PackedJoin(_Message, frozen=True, tag="Join"):
    """A `Join` as it travels."""

    protocol: b.Count
    schema: b.Hash
    config: b.Hash
    session: b.Session
    claim: b.Claim
    seat: b.SeatOrAny
    name: b.Name
    spec: PackedSpec
    pid: b.Process
    resume: tuple[b.Count, b.Count] | None


_OtherRequest = Act | Tick | Respawn | Rebuild | Beat | Leave
_OtherReply = Welcome | BarrierFull | Promote | Demoted | TickDone | Restarted | Waiting | Failure | Bye


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot send a {type(value).__name__}")


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_plain)
_REQUESTS: msgspec.msgpack.Decoder[_OtherRequest | PackedJoin] = msgspec.msgpack.Decoder(_OtherRequest | PackedJoin)
_REPLIES: msgspec.msgpack.Decoder[_OtherReply | _PackedFrame] = msgspec.msgpack.Decoder(_OtherReply | _PackedFrame)


def _travelling() -> tuple[type[msgspec.Struct], ...]:
    """Every kind of message as it travels."""
    return (*_OtherRequest.__args__, PackedJoin, *_OtherReply.__args__, _PackedFrame)


@cache
def schema_hash() -> str:
    """A short hash of all fields of all messages: two programs with the same one understand each other."""
    _, parts = msgspec.json.schema_components(_travelling())
    text = msgspec.json.encode(parts, order="deterministic")
    return hashlib.blake2b(text, digest_size=8).hexdigest()


def encode(message: Request | Reply) -> bytes:
    """A message as bytes; a frame has its pictures inside unless they are in a slot of shared memory."""
    if isinstance(message, Frame):
        client = message.client
        inside = None if client is None else packed(client, pictures=message.slot < 0)
        return _ENCODER.encode(_PackedFrame(message.epoch, message.tick, message.life, inside, message.slot))
    if isinstance(message, Join):
        return _ENCODER.encode(PackedJoin(**{**_fields(message), "spec": packed_spec(message.spec)}))
    return _ENCODER.encode(message)


def decode_request(data: bytes) -> Request:
    """Bytes as a request. Raises OverloadedError when there are too many, ProtocolError for anything else."""
    request: _OtherRequest | PackedJoin = _decode(data, _REQUESTS, MAX_REQUEST_BYTES)
    if isinstance(request, PackedJoin):
        return Join(**{**_fields(request), "spec": unpacked_spec(request.spec)})
    return request


def _fields(join: Join | PackedJoin) -> dict[str, Any]:
    return {name: getattr(join, name) for name in join.__struct_fields__}


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
        raise errors.OverloadedError(f"a message has {len(data)} bytes; expected at most {limit_bytes}")
    try:
        return decoder.decode(data)
    except (msgspec.MsgspecError, TypeError, ValueError, RecursionError) as error:
        raise ProtocolError(f"a message does not fit protocol {PROTOCOL}: {escaped(error, 200)}") from None


def failure_of(error: WcsimError, session: bytes = b"") -> Failure:
    """An error as the message that carries it."""
    return Failure(error=type(error).__name__, message=str(error)[: b.MOST_TEXT], session=session)


def error_of(failure: Failure) -> WcsimError:
    """The error that a message carries, under its own name; its text is printable, whoever wrote it."""
    kind = getattr(errors, failure.error, None)
    known = isinstance(kind, type) and issubclass(kind, WcsimError)
    return (kind if known else WcsimError)(escaped(failure.message, b.MOST_TEXT))  # type: ignore[misc]
