"""Bounds of the fields that a peer or a file fills. Each field has one of these types."""

from typing import Annotated, Final

import msgspec

CLIENT_NAME = r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}"
"""Pattern of a client's name: a plain word, which can name a folder and be printed anywhere."""

MOST_SEATS: Final = 64  # of a world
MAX_SEED: Final = (1 << 63) - 1
SESSION_BYTES = 16
MOST_CAMERAS = 64
MOST_CONTACTS = 4096  # of a chair in a tick
MOST_TEXT = 4000  # characters of a message for people
_MAX_COUNT = (1 << 53) - 1  # the largest number that every language counts to
_MAX_PROCESS = 1 << 22  # of Linux
MOST_STEPS = 1_000_000  # of a client's episode, as env.max_steps
MOST_METRES = 1e6
MOST_READINGS = 64  # of a chair in a tick, beside cameras and IMU
MOST_READING_BYTES = 1 << 16  # of one sensor
MOST_ACTIONS = 1024
MOST_SIDE_PX = 2048  # of a picture

Session = Annotated[bytes, msgspec.Meta(min_length=SESSION_BYTES, max_length=SESSION_BYTES)]
# b"" where it is not known.
SessionOrNone = Annotated[bytes, msgspec.Meta(max_length=SESSION_BYTES)]
Claim = Annotated[bytes, msgspec.Meta(max_length=128)]
Count = Annotated[int, msgspec.Meta(ge=0, le=_MAX_COUNT)]
CountOrNone = Annotated[int, msgspec.Meta(ge=-1, le=_MAX_COUNT)]
Seed = Annotated[int, msgspec.Meta(ge=0, le=MAX_SEED)]
Seat = Annotated[int, msgspec.Meta(ge=0, le=MOST_SEATS - 1)]
SeatOrAny = Annotated[int, msgspec.Meta(ge=-1, le=MOST_SEATS - 1)]
Slot = Annotated[int, msgspec.Meta(ge=-1, le=1)]
Process = Annotated[int, msgspec.Meta(ge=0, le=_MAX_PROCESS)]
# Of an episode: some of this machine are endless.
Steps = Annotated[int, msgspec.Meta(ge=1, le=1 << 31)]
Delay = Annotated[int, msgspec.Meta(ge=0, le=10)]  # as world.action_delay_ticks
# The core refuses a stick beyond its range, by name; here only what is no position at all.
Stick = Annotated[float, msgspec.Meta(ge=-2.0, le=2.0)]
Metres = Annotated[float, msgspec.Meta(ge=-MOST_METRES, le=MOST_METRES)]
Radians = Annotated[float, msgspec.Meta(ge=-1e3, le=1e3)]
Number = Annotated[float, msgspec.Meta(ge=-1e12, le=1e12)]
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=1e9)]
Hash = Annotated[str, msgspec.Meta(max_length=64, pattern=r"\A[0-9a-z]*\Z")]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64, pattern=rf"\A{CLIENT_NAME}\Z")]
NameOrNone = Annotated[str, msgspec.Meta(max_length=64, pattern=r"\A[A-Za-z0-9_.-]*\Z")]
Key = Annotated[str, msgspec.Meta(max_length=128, pattern=r"\A[A-Za-z0-9_.*-]*\Z")]
Line = Annotated[str, msgspec.Meta(max_length=256, pattern=r"\A[^\x00-\x1f\x7f-\x9f]*\Z")]
Place = Annotated[str, msgspec.Meta(max_length=4096, pattern=r"\A[^\x00-\x1f\x7f-\x9f]*\Z")]
# Printed only as `reading.escape` gives it.
Text = Annotated[str, msgspec.Meta(max_length=MOST_TEXT)]
Document = Annotated[str, msgspec.Meta(max_length=1 << 20)]
