"""What travels between a client and a world process: typed msgpack messages, no pickle, bounded in size."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from wcsim import errors
from wcsim.errors import ProtocolError, WcsimError
from wcsim.types import ClientSnapshot, Joystick, SeatSpec

PROTOCOL = 2
MAX_MESSAGE_BYTES = 64 << 20


class Open(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True):
    """The first request: make this world."""

    protocol: int
    town: str
    config_json: str
    seat: SeatSpec
    seed: int
    run: str
    hook: str


class Act(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True):
    """Drive through a tick."""

    tick: int
    x: float
    y: float


class Respawn(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True):
    """Begin the seat's next episode."""


class Rebuild(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True):
    """Begin the world again."""

    seed: int


class Join(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True):
    """Show the frame the seat has now."""


class Leave(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True):
    """The client is done; the world ends."""


class Frame(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True):
    """The answer to every request that went well."""

    client: ClientSnapshot


class Failure(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True):
    """The answer to a request that went wrong: the name of an error in `wcsim.errors`, and its message."""

    error: str
    message: str


class Bye(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True):
    """The world has ended as asked."""


Request = Open | Join | Act | Respawn | Rebuild | Leave
Reply = Frame | Failure | Bye


def _encode_array(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes())
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot send a {type(value).__name__}")


def _decode_array(kind: Any, value: Any) -> Any:
    if getattr(kind, "__origin__", kind) is np.ndarray:
        dtype, shape, data = value
        return np.frombuffer(data, dtype=np.dtype(dtype)).reshape(shape)
    raise TypeError(f"cannot receive a {kind}")


def joystick_of(act: Act) -> Joystick:
    """The joystick position that an action carries."""
    return Joystick(act.x, act.y)


def encode(message: Request | Reply) -> bytes:
    """A message as bytes."""
    return msgspec.msgpack.encode(message, enc_hook=_encode_array)


def decode_request(data: bytes) -> Request:
    """Bytes as a request. Raises ProtocolError for anything else."""
    request: Request = _decode(data, Request)
    return request


def decode_reply(data: bytes) -> Reply:
    """Bytes as a reply. Raises ProtocolError for anything else."""
    reply: Reply = _decode(data, Reply)
    return reply


def _decode(data: bytes, kind: Any) -> Any:
    try:
        return msgspec.msgpack.decode(data, type=kind, dec_hook=_decode_array)
    except (msgspec.MsgspecError, TypeError, ValueError) as error:
        raise ProtocolError(f"a message does not fit protocol {PROTOCOL}: {error}") from None


def failure_of(error: WcsimError) -> Failure:
    """An error as the message that carries it."""
    return Failure(error=type(error).__name__, message=str(error))


def raise_failure(failure: Failure) -> None:
    """Raise the error that a message carries, under its own name."""
    kind = getattr(errors, failure.error, None)
    known = isinstance(kind, type) and issubclass(kind, WcsimError)
    raise (kind if known else WcsimError)(failure.message)  # type: ignore[misc]
