"""The parts inside messages, as they travel: rows of bounded fields.

See `server/protocol/frame_codec.py` for what they stand for.
"""

from __future__ import annotations

import struct
from typing import Annotated, Literal

import msgspec

from wcsim.server.protocol import bounds as b

ROW = struct.Struct("=32d")
_Row = Annotated[bytes, msgspec.Meta(min_length=ROW.size, max_length=ROW.size + b.MOST_READINGS * b.MOST_READING_BYTES)]
_Seconds = Annotated[bytes, msgspec.Meta(max_length=8 * 1024)]  # float64, one for each action
_PictureBytes = Annotated[bytes, msgspec.Meta(max_length=b.MOST_PICTURE_BYTES)]


class _Part(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Base of all that travels inside a message."""


class PackedStart(_Part, frozen=True):
    """A `StartSpec`."""

    p_W_m: tuple[b.Metres, b.Metres]
    yaw_rad: b.Radians
    goal_W_m: tuple[b.Metres, b.Metres]


class PackedSpec(_Part, frozen=True):
    """A `SeatSpec`."""

    profile: b.Place
    max_steps: b.Steps
    truth: bool
    truth_visible: bool
    start: PackedStart | None


class PackedPicture(_Part, frozen=True):
    """A camera's picture; all empty when it is in shared memory."""

    name: b.Line
    taken_tick: b.CountOrNone
    height: b.Pixels
    width: b.Pixels
    depth_m: _PictureBytes  # float32
    class_id: _PictureBytes  # uint8
    rgb: _PictureBytes  # uint8, empty without colours


class PackedReading(_Part, frozen=True):
    """A `Reading`."""

    name: b.NameOrNone
    values: Annotated[bytes, msgspec.Meta(max_length=b.MOST_READING_BYTES)]  # float64


PackedReadings = Annotated[tuple[PackedReading, ...], msgspec.Meta(max_length=b.MOST_READINGS)]


class PackedVerdict(_Part, frozen=True):
    """A `Verdict`."""

    danger: bool
    first_s: _Seconds


class PackedTruth(_Part, frozen=True):
    """A `Truth`."""

    x: b.Stick
    y: b.Stick
    danger: bool
    first_s: _Seconds
    clearance_m: b.Number
    progress_m: b.Number
    visible: PackedVerdict | None


class PackedContact(_Part, frozen=True):
    """A `Contact`."""

    kind: b.NameOrNone
    part: b.NameOrNone
    impulse_Ns: b.Number
    cause: Literal["own", "other"]
    actor_id: b.Line


class PackedEvents(_Part, frozen=True):
    """An `Events`."""

    episode: b.CountOrNone
    step: b.Count
    crashed: bool
    crash_reason: b.NameOrNone
    truncated: bool
    arrived: bool
    gave_up: bool
    progress_m: b.Number
    jam_teleports: b.Count
    on_carriageway: bool
    crossed: bool
    entered_red: bool
    crash: b.Line
    help_asked: bool


class PackedDrawn(_Part, frozen=True):
    """A `Drawn`."""

    light: b.Number | None
    friction: b.Number | None
    user_mass_kg: b.Number | None
    camera_shift_m: Annotated[tuple[tuple[b.Number, b.Number, b.Number], ...], msgspec.Meta(max_length=b.MOST_CAMERAS)]
    camera_turn_rad: Annotated[tuple[tuple[b.Radians, b.Radians], ...], msgspec.Meta(max_length=b.MOST_CAMERAS)]
    action_delay_ticks: b.Delay | None
    plant: Annotated[tuple[tuple[b.Key, b.Number], ...], msgspec.Meta(max_length=1024)]
    attention: Annotated[tuple[tuple[b.Key, b.Number], ...], msgspec.Meta(max_length=16)]
    reaction_s: Annotated[tuple[tuple[b.Key, b.Number], ...], msgspec.Meta(max_length=16)]


class PackedClient(_Part, frozen=True):
    """A `ClientSnapshot`; `numbers` are the float64 of plant, IMU and user; `PackedReadings` may follow."""

    seat: b.Seat
    tick: b.Count
    sensor_tick: b.Count
    numbers: _Row
    pictures: Annotated[tuple[PackedPicture, ...], msgspec.Meta(max_length=b.MOST_CAMERAS)]
    contacts: Annotated[tuple[PackedContact, ...], msgspec.Meta(max_length=b.MOST_CONTACTS)]
    events: PackedEvents
    truth: PackedTruth | None
    drawn: PackedDrawn | None
    first: PackedClient | None
