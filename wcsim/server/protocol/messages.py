"""What travels between clients and a server: typed msgpack messages, never pickle, every field bounded.

Every request carries the session of its client, and what it is about: epoch, tick and life (the number of respawns at
that tick). The bounds are those of `types/bounds.py`. Nothing is "the next", so a request that comes twice,
or late, does nothing twice.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Annotated, Any, Protocol

import msgspec
import numpy as np
import numpy.typing as npt

from wcsim import errors
from wcsim.core.reading import escaped
from wcsim.errors import ProtocolError, WcsimError
from wcsim.physics.buffers import Images
from wcsim.types import F32, F64, CameraFrame, ClientSnapshot, SeatSpec, Truth, Verdict
from wcsim.types import bounds as b

PROTOCOL = 8
MAX_REQUEST_BYTES = 1 << 13  # a server refuses more; the longest join has less
MAX_REPLY_BYTES = (
    64 << 20
)  # a client refuses more: pictures travel inside when there is no shared memory
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


class Act(_Message, frozen=True):
    """Drive through a tick; that of the master is the paper's tick request, granted once the barrier is full."""

    session: b.Session
    epoch: b.Count
    tick: b.Count
    life: b.Count
    x: b.Stick
    y: b.Stick


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
    master: b.Seat  # of the client that carries the simulators on
    ring: b.Place = ""  # where the seat's pictures are, for a client on the same machine
    config_json: b.Document = ""  # the world's configuration
    town: b.Place = ""


class TickDone(_Message, frozen=True):
    """The simulation has reached this tick (the paper's end of simulation)."""

    epoch: b.Count
    tick: b.Count
    master: b.Seat  # of the client that is the master from now on
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
    late: Annotated[tuple[b.Name, ...], msgspec.Meta(max_length=b.MOST_SEATS)]


class Failure(_Message, frozen=True):
    """A request went wrong: the name of an error in `wcsim.errors`, and its message."""

    error: b.Name
    message: b.Text
    session: b.SessionOrNone = b""


class Bye(_Message, frozen=True):
    """The client has left as asked, or the server ends."""

    session: b.SessionOrNone
    reason: b.Text = ""


Request = Join | Act | Respawn | Rebuild | Beat | Leave
Reply = Welcome | TickDone | Frame | Restarted | Waiting | Failure | Bye


# --- the arrays of a frame as they travel, and what no type says of them; the rest msgspec packs by its types ---

_SIZES = [3, 4, 3, 3, 2, 3, 3, 3]  # of the arrays of a plant and an IMU


class _Pictures(Protocol):
    """Where pictures are that did not travel."""

    def pictures(self, slot: int, first: bool) -> Sequence[Images]:
        """Those of a slot, one a camera; with `first` those of an episode's first frame. Raises ProtocolError."""


def _packed(value: Any) -> Any:
    """An array as its bytes, behind its shape where it has more than one dimension; a NumPy number as a plain one."""
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.ndim == 1 else (value.shape, value.tobytes())
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(type(value))


def _packed_without_pictures(value: Any) -> Any:
    """The same; of pictures, which lie in shared memory, nothing."""
    return ((0, 0), b"") if isinstance(value, np.ndarray) and value.ndim > 1 else _packed(value)


def _unpacked(kind: Any, told: Any) -> npt.NDArray[Any]:
    """What `_packed` made of an array, numbers as a row. Raises TypeError or ValueError for anything else."""
    if kind == F64:
        return np.frombuffer(told, np.float64)
    shape, data = told
    return np.frombuffer(data, np.float32 if kind == F32 else np.uint8).reshape(shape)


def _require_whole(client: ClientSnapshot) -> None:
    """Refuse a frame for what no type says: the shapes of its arrays, and numbers inside them. Raises ProtocolError."""
    plant, imu = client.plant, client.sensors.imu
    arrays = [plant.p_WB_m, plant.q_WB, plant.v_B_mps, plant.w_B_radps, plant.wheel_radps]
    arrays += [imu.accel_mean_mps2, imu.accel_peak_mps2, imu.gyro_radps]
    if [array.size for array in arrays] != _SIZES:
        raise ProtocolError(
            "a frame has arrays of other sizes than those of a wheelchair and its IMU"
        )
    readings = [reading.values for reading in client.sensors.readings]
    if any([values.nbytes > b.MOST_READING_BYTES for values in readings]):
        raise ProtocolError(
            f"a sensor reading has too many numbers; expected {b.MOST_READING_BYTES} bytes at most"
        )
    if not np.isfinite(np.concatenate(arrays + readings)).all():
        raise ProtocolError(
            "a frame or a sensor reading has numbers that are not finite; expected finite ones"
        )
    if client.truth is not None:
        _require_verdict(client.truth)
    for camera in client.sensors.cameras:
        _require_picture(camera)
    if client.first is not None:
        _require_whole(client.first)


def _require_verdict(verdict: Verdict) -> None:
    if len(verdict.first_s) > b.MOST_ACTIONS or not (verdict.first_s >= 0.0).all():
        raise ProtocolError(
            "the truth has too many seconds, or negative ones; expected one >= 0 for each action"
        )
    if isinstance(verdict, Truth) and verdict.visible is not None:
        _require_verdict(verdict.visible)


def _with_pictures(client: ClientSnapshot, slot: int, shared: _Pictures) -> ClientSnapshot:
    """A frame with its pictures out of shared memory. Raises ProtocolError when they are of other cameras."""
    images, cameras = shared.pictures(slot, client.events.step == 0), client.sensors.cameras
    if not cameras:  # of a seat without pictures
        return client
    if len(images) != len(cameras):
        raise ProtocolError(
            f"a frame has {len(cameras)} cameras; the shared memory has {len(images)}"
        )
    seen = tuple(
        [
            replace(camera, depth_m=here.depth_m, class_id=here.class_id, rgb=here.rgb)
            for camera, here in zip(cameras, images, strict=True)
        ]
    )
    first = None if client.first is None else _with_pictures(client.first, slot, shared)
    return replace(client, sensors=replace(client.sensors, cameras=seen), first=first)


def _require_picture(camera: CameraFrame) -> None:
    shape, rgb = camera.depth_m.shape, camera.rgb
    sound = len(shape) == 2 and max(shape) <= b.MOST_SIDE_PX and camera.class_id.shape == shape
    empty = (
        camera.depth_m.size == 0
    )  # as of a picture in shared memory, whose colours do not travel either
    if not sound or (
        rgb is not None and rgb.shape != (*shape, 3) and not (empty and rgb.size == 0)
    ):
        raise ProtocolError(
            f"the depth of a picture has shape {shape}; expected (H, W), and the same of its classes"
        )


# --- as bytes ---

_ENCODER = msgspec.msgpack.Encoder(enc_hook=_packed)
_WITHOUT_PICTURES = msgspec.msgpack.Encoder(enc_hook=_packed_without_pictures)
_REQUESTS: msgspec.msgpack.Decoder[Request] = msgspec.msgpack.Decoder(Request)
_REPLIES: msgspec.msgpack.Decoder[Reply] = msgspec.msgpack.Decoder(Reply, dec_hook=_unpacked)


@cache
def schema_hash() -> str:
    """A short hash of all fields of all messages: two programs with the same one understand each other."""
    kinds = (*Request.__args__, *Reply.__args__)
    _, parts = msgspec.json.schema_components(
        kinds, schema_hook=lambda array: {"title": str(array)}
    )
    text = msgspec.json.encode(parts, order="deterministic")
    return hashlib.blake2b(text, digest_size=8).hexdigest()


def encode(message: Request | Reply) -> bytes:
    """A message as bytes; a frame has its pictures inside unless they are in a slot of shared memory."""
    outside = isinstance(message, Frame) and message.slot >= 0
    return (_WITHOUT_PICTURES if outside else _ENCODER).encode(message)


def decode_request(data: bytes) -> Request:
    """Bytes as a request. Raises OverloadedError when there are too many, ProtocolError for anything else."""
    request: Request = _decode(data, _REQUESTS, MAX_REQUEST_BYTES)
    return request


def decode_reply(data: bytes, shared: _Pictures | None = None) -> Reply:
    """Bytes as a reply; pictures that did not travel are taken from `shared`, or empty.

    Raises OverloadedError when there are too many bytes, ProtocolError for anything else that is no reply.
    """
    reply: Reply = _decode(data, _REPLIES, MAX_REPLY_BYTES)
    if not isinstance(reply, Frame) or reply.client is None:
        return reply
    _require_whole(reply.client)
    if reply.slot < 0 or shared is None:
        return reply
    return msgspec.structs.replace(reply, client=_with_pictures(reply.client, reply.slot, shared))


def _decode(data: bytes, decoder: msgspec.msgpack.Decoder[Any], limit_bytes: int) -> Any:
    if len(data) > limit_bytes:
        raise errors.OverloadedError(
            f"a message has {len(data)} bytes; expected at most {limit_bytes}"
        )
    try:
        message = decoder.decode(data)
        if isinstance(message, Join):
            _require_plain(message.spec, data)
        return message
    except (msgspec.MsgspecError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        raise ProtocolError(
            f"a message does not fit protocol {PROTOCOL}: {escaped(error, 200)}"
        ) from None


def _require_plain(spec: SeatSpec, data: bytes) -> None:
    """Refuse what the types of a join leave open: msgspec passes over fields that a dataclass does not have."""
    msgspec.convert(spec.profile, b.Place)
    sent = msgspec.msgpack.decode(data)[1 + Join.__struct_fields__.index("spec")]
    if msgspec.msgpack.decode(_ENCODER.encode(spec)) != sent:
        raise ValueError("a seat is asked for with fields of another protocol")


def failure_of(error: WcsimError, session: bytes = b"") -> Failure:
    """An error as the message that carries it."""
    return Failure(error=type(error).__name__, message=str(error)[: b.MOST_TEXT], session=session)


def error_of(failure: Failure) -> WcsimError:
    """The error that a message carries, under its own name; its text is printable, whoever wrote it."""
    kind = getattr(errors, failure.error, None)
    known = isinstance(kind, type) and issubclass(kind, WcsimError)
    return (kind if known else WcsimError)(escaped(failure.message, b.MOST_TEXT))  # type: ignore[misc]
