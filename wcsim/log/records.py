"""What a log holds: a header, and records of inputs, states, drives or frames that a client saw.

The header is JSON, a record is MessagePack; every number of both is bounded as it is read.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, Final, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, Struct

from wcsim.core.reading import MOST_JSON_BYTES
from wcsim.errors import WcsimError
from wcsim.types import (
    F64,
    ActorKind,
    ActorState,
    ClientSnapshot,
    Command,
    Joystick,
    SeatSpec,
    Snapshot,
    StartSpec,
)
from wcsim.types.bounds import MAX_SEED, MOST_SEATS

MAGIC: Final = "wcsim-log-1"
MOST_SAMPLES: Final = 480  # of the stick in a tick: as many as a tick may have physics steps
MOST_DETAIL: Final = 1000  # characters of a note
NO_ACTION: Final = -1
_LARGEST: Final = 1e9
_STICK_LIMIT: Final = 1.0 + 1e-6  # of an axis, with what rounding adds
_STATE_BYTES: Final = 32 << 20  # names, bodies and numbers of some 100,000 actors
# Control characters, and what turns a line round.
_NO_XML: Final = r"\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ufffe\uffff"
_DIGEST_VERSION: Final = 1  # of what the digest is over
# Of this format, and of older ones.
HEADER_STARTS: Final = (b'{"magic":"wcsim-', b'{"magic": "wcsim-')
"""With these begins the first record of a log, of whatever version."""
# The tags of these records in a payload, behind the byte that counts the fields.
TICK_TAG: Final = b"\xa1t"
"""The second and third byte of a record of `Ticked`."""
_STATE_TAG: Final = b"\xa1s"

S = TypeVar("S", bound=Struct)
LogKind = Literal["journal", "trace", "drive", "ledger"]
Count = Annotated[int, Meta(ge=0, le=1 << 62)]
Seed = Annotated[int, Meta(ge=0, le=MAX_SEED)]
Seat = Annotated[int, Meta(ge=0, le=MOST_SEATS - 1)]
Number = Annotated[float, Meta(ge=-_LARGEST, le=_LARGEST)]
Document = Annotated[str, Meta(max_length=MOST_JSON_BYTES)]
Hash = Annotated[str, Meta(max_length=64)]
Printable = Annotated[str, Meta(max_length=4096, pattern=rf"\A[^{_NO_XML}]*\Z")]


class DriveHeader(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The driver of a drive; its records are what was done to its world."""

    wcsim: Document  # version
    # Of the simulated user; "" where a person drove, and a simulated user only gave the route.
    profile: Document = ""
    policy: Document = ""  # that assisted; "" for none
    level: Document = ""  # of the assistance
    episode: Document = ""  # of a suite: its name, block and seat
    scene: Document = ""  # family, seed and SHA-256 of a generated scene; "" for a town

    @property
    def driver(self) -> str:
        """The simulated user's profile, or "person"."""
        return self.profile or "person"


class Header(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="magic", tag=MAGIC
):
    """What the world of a log is made from.

    `fingerprint` names the versions for which its exact hashes hold.
    """

    name: Document = ""  # of the run
    town: Document  # what `find_town` takes
    town_name: Document = ""
    town_sha256: Document = ""  # see `towns_hash`
    more_towns: tuple[Document, ...] = ()  # that take turns with it, an epoch each
    config: Document = ""  # resolved, as JSON; "" where no world can be made of this log
    seed: Seed  # the root of all epochs' seeds
    seats: Annotated[int, Meta(ge=0, le=MOST_SEATS)]  # taken or free
    tick_s: Annotated[float, Meta(ge=1e-3, le=10.0)]
    fingerprint: Document
    hook: Document = ""  # the user's own step hook, module:Class
    recovery: Document = "new_epoch"  # of older logs, golden traces among them
    origin_m: tuple[Number, Number] = (0.0, 0.0)  # W's origin in the town's net coordinates
    origin_z_m: Number = 0.0
    # Length of a wheelchair, and its middle ahead of the drive axle.
    chair_box_m: tuple[Number, Number] | None = None
    drive: DriveHeader | None = None  # where the log is of one chair's ticks
    client: Document | None = None  # its name, where the log is of the frames that it saw

    @property
    def kind(self) -> LogKind:
        """Ledger: frames that a client saw; drive: ticks of a chair; journal, trace: a world.

        A journal holds the inputs of its world, which can be made again; a trace holds states.
        """
        if self.client is not None:
            return "ledger"
        if self.drive is not None:
            return "drive"
        return "journal" if self.config else "trace"


class _Record(Struct, frozen=True, kw_only=True, array_like=True, forbid_unknown_fields=True):
    """A record: a tag, then its fields in their order."""


class EpochBegun(_Record, frozen=True, kw_only=True, tag="e"):
    """The world was made, or made again; seats stay taken unless it is `fresh`."""

    epoch: Count
    seed: Seed
    fresh: bool = False


class Admitted(_Record, frozen=True, kw_only=True, tag="a"):
    """A client took a seat at this tick."""

    epoch: Count
    tick: Count
    seat: Seat
    spec: SeatSpec
    name: Document = ""
    claim: Document = ""  # of older logs


class Dismissed(_Record, frozen=True, kw_only=True, tag="d"):
    """A seat became free at this tick."""

    epoch: Count
    tick: Count
    seat: Seat
    reason: Document = ""


class Respawned(_Record, frozen=True, kw_only=True, tag="r"):
    """The next episode of a seat started at this tick, before any step."""

    epoch: Count
    tick: Count
    seat: Seat
    start: StartSpec | None = None  # of that episode; None for the seat's own


class Ticked(_Record, frozen=True, kw_only=True, tag="t"):
    """The world reached `tick` by these commands of tick - 1, one for each taken seat."""

    epoch: Count
    tick: Count
    seats: Annotated[tuple[Seat, ...], Meta(max_length=MOST_SEATS)]
    # x right, y forward
    sticks: Annotated[tuple[tuple[Number, Number], ...], Meta(max_length=MOST_SEATS)]
    state_hash: Hash

    @property
    def commands(self) -> tuple[Command, ...]:
        """The commands, by seat."""
        return tuple(
            Command(seat=seat, tick=self.tick - 1, joystick=Joystick(x, y))
            for seat, (x, y) in zip(self.seats, self.sticks, strict=True)
        )


class Ended(_Record, frozen=True, kw_only=True, tag="z"):
    """The server ended in good order."""

    reason: Document = ""


class ActorBody(Struct, frozen=True, kw_only=True, array_like=True, forbid_unknown_fields=True):
    """What a replay needs to know of an actor."""

    id: Printable
    kind: ActorKind
    size_lwh_m: tuple[Number, Number, Number]
    piece: Count = 0  # as in `ActorState`


class WorldState(_Record, frozen=True, kw_only=True, tag="s", eq=False):
    """One tick: the commands, and where everything was afterwards."""

    epoch: Count
    tick: Count
    commands: F64  # (seats, 2) x, y
    plants: F64  # (seats, 15) position, quaternion, velocity, angular velocity, wheel speeds
    actor_ids: tuple[Printable, ...]
    actors: F64  # (n, 8) position, yaw, pitch, velocity
    state_hash: Hash
    time_s: Number = 0.0  # SUMO's own time
    # One for each actor, in their order; in a file those that are new or changed.
    bodies: tuple[ActorBody, ...] = ()
    # Of the commands and plants; empty when they are 0, 1, 2, ...
    seats: tuple[Seat, ...] = ()


class DriveTick(_Record, frozen=True, kw_only=True, tag="k", eq=False):
    """A tick of a drive: what was done in it, and where the chair was at its end."""

    tick: Count  # at its end, of the world
    episode: Count
    time_s: Annotated[float, Meta(ge=0.0, le=_LARGEST)]  # at its end, of the drive
    stick: Joystick  # the person's at its beginning, which the policy answered
    intent: Joystick | None = None  # of the person during it, where that is known
    # (S, 2) within it at equal times
    sticks: F64 = msgspec.field(default_factory=lambda: np.zeros((0, 2)))
    commanded: Joystick  # what the chair was given
    chosen: Joystick  # by the policy: as commanded unless overruled
    action: Annotated[int, Meta(ge=NO_ACTION, le=1 << 16)] = NO_ACTION  # of the set, as chosen
    p_WB_m: F64  # (3,) at its end, as all that follows
    yaw_rad: Number
    roll_rad: Number = 0.0
    pitch_rad: Number = 0.0
    speed_mps: Number
    warning: bool = False
    intervening: bool = False
    overruled: bool = False
    helped: bool = False  # the person asked for help
    # Times real time: below 1 is slow motion.
    pace: Annotated[float, Meta(ge=0.0, le=_LARGEST)] = 1.0
    arrived: bool = False
    gave_up: bool = False
    crashed: bool = False
    truncated: bool = False

    @property
    def epoch(self) -> int:
        """The epoch of its world: a drive has one."""
        return 0

    @property
    def commands(self) -> tuple[Command, ...]:
        """The command that led to it, as of `Ticked`."""
        return (Command(seat=0, tick=self.tick - 1, joystick=self.commanded),)

    @property
    def by_person(self) -> bool:
        """Whether a person drove: the intent of a simulated user is always known."""
        return self.intent is None

    @property
    def ends(self) -> bool:
        """Whether an episode ended with it."""
        return self.crashed or self.truncated

    def __eq__(self, other: object) -> bool:
        return type(other) is DriveTick and _ENCODER.encode(self) == _ENCODER.encode(other)


def end_fields_from_snapshot(after: ClientSnapshot) -> dict[str, Any]:
    """The fields of a `DriveTick` of its end: where the chair is, and what has ended."""
    plant = after.plant
    events = after.events
    turns = {name: getattr(plant, name) for name in ("yaw_rad", "roll_rad", "pitch_rad")}
    ends = {name: getattr(events, name) for name in ("arrived", "gave_up", "crashed", "truncated")}
    return {"p_WB_m": plant.p_WB_m.copy(), "speed_mps": float(plant.v_B_mps[0]), **turns, **ends}


class Note(_Record, frozen=True, kw_only=True, tag="n"):
    """Something that happened beside the ticks."""

    tick: Count  # of the world
    time_s: Number  # of the drive
    kind: Annotated[str, Meta(max_length=40)]  # one word
    detail: Annotated[str, Meta(max_length=MOST_DETAIL)] = ""


class SeenFrame(_Record, frozen=True, kw_only=True, tag="f"):
    """A client saw the frame of this tick."""

    epoch: Count
    tick: Count
    stepped: bool  # by the client's own action, not by a join, a respawn or a new epoch


WorldTick = Ticked | DriveTick
"""What carries a world on by a tick."""
Input = EpochBegun | Admitted | Dismissed | Respawned | WorldTick | Ended
LogRecord = Input | WorldState | Note | SeenFrame


def make_ticked_record(
    epoch: int, tick: int, commands: tuple[Command, ...], state_hash: str
) -> Ticked:
    """The record of a world that reached a tick by these commands."""
    return Ticked(
        epoch=epoch,
        tick=tick,
        seats=tuple(command.seat for command in commands),
        sticks=tuple((command.joystick.x, command.joystick.y) for command in commands),
        state_hash=state_hash,
    )


def world_state_from_snapshot(
    snapshot: Snapshot, commands: Sequence[Command], actors: Sequence[ActorState] | None = None
) -> WorldState:
    """The state after a tick, from its commands and the snapshot to which they led.

    `actors` are those to record, such as all of the town; by default those of the snapshot, which
    are near the chairs.
    """
    actors = snapshot.actors if actors is None else actors
    seats = tuple(client.seat for client in snapshot.clients)
    return WorldState(
        epoch=snapshot.epoch,
        tick=snapshot.tick,
        commands=np.array([(c.joystick.x, c.joystick.y) for c in commands]).reshape(-1, 2),
        plants=np.array([c.plant.row for c in snapshot.clients]).reshape(-1, 15),
        actor_ids=tuple(a.id for a in actors),
        actors=np.array([a.row for a in actors]).reshape(-1, 8),
        state_hash=snapshot.state_hash,
        time_s=snapshot.time_s,
        bodies=tuple(
            ActorBody(id=a.id, kind=a.kind, size_lwh_m=a.size_lwh_m, piece=a.piece) for a in actors
        ),
        seats=() if seats == tuple(range(len(seats))) else seats,
    )


def header_to_bytes(header: Header) -> bytes:
    """A header as a payload."""
    return msgspec.json.encode(header)


def header_from_bytes(payload: bytes) -> Header:
    """A payload as a header. Raises WcsimError when it is none of this version."""
    if not payload.startswith(HEADER_STARTS):
        raise WcsimError("is not a log; expected a file written by wcsim")
    if len(payload) > MOST_JSON_BYTES:
        raise WcsimError(
            f"its header has {len(payload)} bytes of JSON; expected at most {MOST_JSON_BYTES}"
        )
    try:
        header = _HEADERS.decode(payload)
        _require(not header.config or header.seats > 0)
        if header.drive is not None:
            _require(header.config != "")
    except (msgspec.MsgspecError, UnicodeError, RecursionError, ValueError) as error:
        named = payload[:80].split(b'"')[3].decode("ascii", "replace")
        if named != MAGIC:
            raise WcsimError(
                f"is of format {named!r}; expected {MAGIC!r}: use the wcsim that made it, or "
                "record it again"
            ) from None
        raise WcsimError(
            f"its header cannot be used: {error}; expected one as wcsim writes it"
        ) from None
    return header


def encode_header_for_comparison(header: Header) -> bytes:
    """What the headers of two equal runs share, for the digest: no names, places or versions."""
    same = ("town_sha256", "config", "seed", "seats", "tick_s", "hook", "recovery")
    return msgspec.json.encode(
        {"version": _DIGEST_VERSION, **{name: getattr(header, name) for name in same}}
    )


def record_to_bytes(record: LogRecord) -> bytes:
    """A record as a payload."""
    return _ENCODER.encode(record)


def strip_uncompared_fields(record: LogRecord) -> LogRecord:
    """A record without what may differ between equal runs: names, reasons, claims.

    `hash_log` and `wcsim log compare` both compare such records.
    """
    if isinstance(record, Admitted):
        return with_fields(record, name="", claim="")
    return with_fields(record, reason="") if isinstance(record, Dismissed | Ended) else record


def with_fields(record: S, **fields: Any) -> S:
    """A record or header with other values in some fields, as by `dataclasses.replace`."""
    return msgspec.structs.replace(record, **fields)


def record_from_bytes(payload: bytes) -> LogRecord:
    """A payload as a record. Raises WcsimError when it is none."""
    most = _STATE_BYTES if payload[1:3] == _STATE_TAG else MOST_JSON_BYTES
    if len(payload) > most:
        raise WcsimError(f"a record has {len(payload)} bytes; expected at most {most}")
    try:
        record: LogRecord = _RECORDS.decode(payload)
        _require_whole(record)
    except (msgspec.MsgspecError, UnicodeError, RecursionError, ValueError) as error:
        raise WcsimError(f"a record does not belong in a log: {error}") from None
    return record


def _require_whole(record: LogRecord) -> None:
    """Refuse what no type excludes: wrong shapes, and numbers in them. Raises ValueError."""
    match record:
        case Ticked():
            _require(len(record.seats) == len(record.sticks))
        case WorldState():
            count = len(record.plants)
            _require(
                record.commands.shape == (count, 2),
                record.plants.shape == (count, 15),
                record.actors.shape == (len(record.actor_ids), 8),
                count <= MOST_SEATS and len(record.seats) in (0, count),
            )
        case DriveTick():
            sticks = (record.stick, record.intent or record.stick, record.commanded, record.chosen)
            _require(
                record.p_WB_m.shape == (3,),
                record.sticks.shape == (len(record.sticks), 2)
                and len(record.sticks) <= MOST_SAMPLES,
                bool((np.abs(record.sticks) <= _STICK_LIMIT).all()),
                all(
                    abs(stick.x) <= _STICK_LIMIT and abs(stick.y) <= _STICK_LIMIT
                    for stick in sticks
                ),
            )


def _require(*facts: bool) -> None:
    if not all(facts):
        raise ValueError("out of bounds")


def _array_bytes(array: Any) -> Any:
    """An array as its shape, the bytes of a number, and all numbers, little-endian."""
    if not isinstance(array, np.ndarray):
        raise NotImplementedError(type(array))
    return array.shape, array.itemsize, array.astype(f"<f{array.itemsize}", copy=False).tobytes()


def _array_of(_: type, encoded: Any) -> F64:
    """What `_array_bytes` wrote, as float64. Raises ValueError."""
    shape, size, data = msgspec.convert(
        encoded, tuple[tuple[int, ...], Literal[4, 8], bytes], strict=True
    )
    _require(
        1 <= len(shape) <= 2, all(side >= 0 for side in shape), math.prod(shape) * size == len(data)
    )
    numbers: F64 = np.frombuffer(data, f"<f{size}").astype(np.float64, copy=False).reshape(shape)
    _require(bool((np.abs(numbers) <= _LARGEST).all()))
    return numbers


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_array_bytes)
_HEADERS = msgspec.json.Decoder(Header)
_RECORDS = msgspec.msgpack.Decoder(LogRecord, dec_hook=_array_of)
