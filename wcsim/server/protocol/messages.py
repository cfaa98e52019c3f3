"""Messages between clients and a server: typed msgpack, never pickle, every field bounded.

Every request has the session of its client, and what it is about: epoch, tick and life (the number
of respawns at that tick). The bounds are those of `types/bounds.py`. No request is for "the next"
tick, so one that comes twice, or late, has no second effect.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Annotated, Any, Final, Protocol

import msgspec
import numpy as np
import numpy.typing as npt

from wcsim import errors
from wcsim.core.reading import escape
from wcsim.errors import ProtocolError, WcsimError
from wcsim.physics.buffers import Images
from wcsim.types import F32, F64, CameraFrame, ClientSnapshot, SeatSpec, Truth, Verdict
from wcsim.types import bounds as b

PROTOCOL: Final = 8
MAX_REQUEST_BYTES: Final = 1 << 13  # a server refuses more; the longest join has less
# A client refuses more. Pictures are inside when there is no shared memory.
MAX_REPLY_BYTES: Final = 64 << 20
SESSION_BYTES: Final = b.SESSION_BYTES
ANY_SEAT: Final = -1
_SIZES: Final = [3, 4, 3, 3, 2, 3, 3, 3]  # of the arrays of a plant and an IMU


class _Message(msgspec.Struct, tag=True, frozen=True, forbid_unknown_fields=True, array_like=True):
    """Base of all messages: a tagged array, unknown fields refused."""


# --- requests ---


class Join(_Message, frozen=True):
    """A client wants a seat."""

    protocol: b.Count
    schema: b.Hash
    config: b.Hash  # hash of the configuration that the client expects of the world, "" for any
    session: b.Session  # drawn anew for every connection
    claim: b.Claim  # drawn once by a client or its launcher; with it, a client gets its seat back
    seat: b.SeatOrAny  # or ANY_SEAT
    name: b.Name
    spec: SeatSpec
    # Of a client on the same machine, which gets its pictures through shared memory; else 0.
    pid: b.Process = 0


class Act(_Message, frozen=True):
    """Drive through a tick; that of the master is the paper's tick request, granted once the barrier is full."""  # noqa: E501

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
    """The client works: a counter that its training moves on, so that a hung one is not taken for a slow one."""  # noqa: E501

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
    master: b.Seat  # of the client whose action is the tick request
    ring: b.Place = ""  # where the seat's pictures are, for a client on the same machine
    config_json: b.Document = ""  # the world's configuration
    town: b.Place = ""


class TickDone(_Message, frozen=True):
    """The simulation has reached this tick (the paper's end of simulation)."""

    epoch: b.Count
    tick: b.Count
    master: b.Seat  # of the client that is the master from now on
    step_s: b.Seconds = 0.0  # duration of the world's step


class Frame(_Message, frozen=True):
    """What the sensors of the seat say; with a slot, the pictures lie there in the seat's shared memory."""  # noqa: E501

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


class _Pictures(Protocol):
    """Where pictures are that are not inside a message."""

    def pictures(self, slot: int, first: bool) -> Sequence[Images]:
        """Those of a slot, one a camera; with `first` those of an episode's first frame.

        Raises ProtocolError.
        """


# --- as bytes ---


def _pack(value: Any) -> Any:
    """An array as its bytes, after its shape if it has more than one dimension.

    A NumPy number as a plain one.
    """
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.ndim == 1 else (value.shape, value.tobytes())
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(type(value))


def _pack_without_pictures(value: Any) -> Any:
    """As `_pack`, but pictures are empty: they are in shared memory."""
    is_picture = isinstance(value, np.ndarray) and value.ndim > 1
    return ((0, 0), b"") if is_picture else _pack(value)


def _unpack(kind: Any, packed: Any) -> npt.NDArray[Any]:
    """The array of what `_pack` returned, numbers as a row.

    Raises TypeError or ValueError for anything else.
    """
    if kind == F64:
        return np.frombuffer(packed, np.float64)
    shape, data = packed
    return np.frombuffer(data, np.float32 if kind == F32 else np.uint8).reshape(shape)


_ENCODER: Final = msgspec.msgpack.Encoder(enc_hook=_pack)
_WITHOUT_PICTURES: Final = msgspec.msgpack.Encoder(enc_hook=_pack_without_pictures)
_REQUESTS: Final[msgspec.msgpack.Decoder[Request]] = msgspec.msgpack.Decoder(Request)
_REPLIES: Final[msgspec.msgpack.Decoder[Reply]] = msgspec.msgpack.Decoder(Reply, dec_hook=_unpack)


@cache
def hash_message_schema() -> str:
    """A short hash of all fields of all messages: with the same one, programs fit each other."""
    # The classes' docstrings count, too: to change one shuts out all clients of other versions.
    kinds = (*Request.__args__, *Reply.__args__)
    _, parts = msgspec.json.schema_components(
        kinds, schema_hook=lambda array: {"title": str(array)}
    )
    text = msgspec.json.encode(parts, order="deterministic")
    return hashlib.blake2b(text, digest_size=8).hexdigest()


def encode_message(message: Request | Reply) -> bytes:
    """A message as bytes; a frame has its pictures inside unless it has a slot."""
    is_outside = isinstance(message, Frame) and message.slot >= 0
    return (_WITHOUT_PICTURES if is_outside else _ENCODER).encode(message)


def decode_request(data: bytes) -> Request:
    """Bytes as a request.

    Raises OverloadedError when there are too many, ProtocolError for anything else.
    """
    request: Request = _decode(data, _REQUESTS, MAX_REQUEST_BYTES)
    return request


def decode_reply(data: bytes, shared: _Pictures | None = None) -> Reply:
    """Bytes as a reply; pictures that are not inside are taken from `shared`, or empty.

    Raises OverloadedError when there are too many bytes, ProtocolError for anything else that is no
    reply.
    """
    reply: Reply = _decode(data, _REPLIES, MAX_REPLY_BYTES)
    if not isinstance(reply, Frame) or reply.client is None:
        return reply
    _require_whole(reply.client)
    if reply.slot < 0 or shared is None:
        return reply
    client = _with_pictures(reply.client, reply.slot, shared)
    return msgspec.structs.replace(reply, client=client)


def failure_from_error(error: WcsimError, session: bytes = b"") -> Failure:
    """The message for an error."""
    return Failure(error=type(error).__name__, message=str(error)[: b.MOST_TEXT], session=session)


def error_from_failure(failure: Failure) -> WcsimError:
    """The error of a message, of the class that it names; its text is printable, whatever came."""
    kind = getattr(errors, failure.error, None)
    is_known = isinstance(kind, type) and issubclass(kind, WcsimError)
    return (kind if is_known else WcsimError)(escape(failure.message, b.MOST_TEXT))  # type: ignore[misc]


def _decode(data: bytes, decoder: msgspec.msgpack.Decoder[Any], limit_bytes: int) -> Any:
    if len(data) > limit_bytes:
        raise errors.OverloadedError(
            f"a message has {len(data)} bytes; expected at most {limit_bytes}"
        )
    try:
        message = decoder.decode(data)
        if isinstance(message, Join):
            # msgspec passes over fields that a dataclass does not have.
            msgspec.convert(message.spec.profile, b.Place)
            received = msgspec.msgpack.decode(data)[1 + Join.__struct_fields__.index("spec")]
            if msgspec.msgpack.decode(_ENCODER.encode(message.spec)) != received:
                raise ValueError("a seat is asked for with fields of another protocol")
        return message
    except (msgspec.MsgspecError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        raise ProtocolError(
            f"a message does not fit protocol {PROTOCOL}: {escape(error, 200)}"
        ) from None


def _require_whole(client: ClientSnapshot) -> None:
    """Refuse a frame for what no type says: the shapes of its arrays, and the numbers in them.

    Raises ProtocolError.
    """
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


def _require_picture(camera: CameraFrame) -> None:
    shape, rgb = camera.depth_m.shape, camera.rgb
    fits = len(shape) == 2 and max(shape) <= b.MOST_SIDE_PX and camera.class_id.shape == shape
    # A picture in shared memory is empty here, and its colours are too.
    is_empty = camera.depth_m.size == 0 and rgb is not None and rgb.size == 0
    has_colours = rgb is not None and rgb.shape == (*shape, 3)
    if not fits or not (rgb is None or has_colours or is_empty):
        raise ProtocolError(
            f"the depth of a picture has shape {shape}; "
            "expected (H, W), and the same of its classes"
        )


def _with_pictures(client: ClientSnapshot, slot: int, shared: _Pictures) -> ClientSnapshot:
    """A frame with its pictures from shared memory.

    Raises ProtocolError when they are of other cameras.
    """
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
