"""The light state of a street after a tick: enough to draw it from anywhere, a kilobyte instead of a world.

A source says what it is (`FilmAbout`), then a `FilmStep` a tick, and lines in between (`FilmLine`). Bodies, ways and
the colours of signals are said once and numbered from 0 on, in the order in which they come.
"""

from __future__ import annotations

from enum import IntFlag
from typing import Final

import msgspec
import numpy as np

from wcsim.types import ActorKind, ActorLook, ActorState, Outline, Route, SignalState

ACTOR_ROW: Final = np.dtype(
    [
        ("body", "<i4"),
        ("p_W_m", "<f4", 3),
        ("yaw_rad", "<f4"),
        ("pitch_rad", "<f4"),
        ("v_W_mps", "<f4", 2),
        ("lamps", "<i4"),
    ]
)
"""An actor of a tick; `body` is its number. 0.5 mm are lost at 8 km from the town's origin."""
XY = tuple[float, float]


class Flag(IntFlag):
    """What happened to a chair in a tick, and what shone."""

    CRASHED = 1
    DROPPED = 2  # beside `CRASHED`: it fell off a kerb
    ARRIVED = 4
    GAVE_UP = 8
    TRUNCATED = 16
    WARNING = 32
    INTERVENING = 64
    OVERRULED = 128
    HELPED = 256
    ALONE = 512  # the user drives alone, before a handover
    UNAIDED = 1024  # no policy has a say: there is none, it is off, or follows the stick whatever comes


class FilmBody(msgspec.Struct, frozen=True, array_like=True):
    """What an actor is; see `ActorState`."""

    id: str
    kind: str
    size_lwh_m: tuple[float, float, float]
    look: str = ActorLook.USUAL.value
    piece: int = 0


class FilmChair(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """A chair after a tick; None is what a source does not know."""

    seat: int
    p_WB_m: tuple[float, float, float]
    q_WB: tuple[float, float, float, float]
    outline: tuple[float, float, float, float]  # length, width, height, middle ahead of the axle
    speed_mps: float
    stick: XY | None = None  # what its user asked for in this tick
    commanded: XY | None = None  # what it was given
    flags: int = 0
    reason: str = ""  # of a crash, as `Events.crash`
    episode: int = -1
    step: int = -1  # of the episode, 1 after its first tick
    way: int = -1  # number of its route, -1 where it is not known
    done_m: float = 0.0
    left_m: float = -1.0
    unsafe: list[int] | None = None  # actions that its policy holds for unsafe


class FilmFrame(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """The street after a tick."""

    epoch: int
    tick: int
    time_s: float
    actors: bytes  # rows of `ACTOR_ROW`
    signals: int  # number of their colours, -1 where they are not known
    chairs: list[FilmChair]


class FilmStep(msgspec.Struct, frozen=True, tag="step", kw_only=True):
    """A tick, and what is named in it for the first time."""

    frame: FilmFrame
    bodies: list[FilmBody] = []
    ways: list[bytes] = []  # points (n, 2) float32 each
    signals: list[list[tuple[str, str]]] = []


class FilmAbout(msgspec.Struct, frozen=True, tag="about", kw_only=True):
    """What a source shows."""

    title: str
    town: str  # address
    tick_s: float
    camera: str = ""  # JSON of the chairs' front camera, "" where it is not known
    actions: str = ""  # name of the action set, "" where it is not known
    unknown: list[str] = []  # what this kind of source does not know, in words
    ticks: int = 0  # that are to come, 0 where that is not known
    tells_unsafe: bool = False
    warns: bool = False
    tells_who: bool = False  # decides
    live: bool = False


class FilmLine(msgspec.Struct, frozen=True, tag="line", kw_only=True):
    """Something to say: `kind` is "now" for what goes on, "mark" for the time line, "bad", or "end"."""

    kind: str
    told: str


class FilmNames(msgspec.Struct, frozen=True, tag="names", kw_only=True):
    """Who sits where."""

    names: dict[int, str]


Said = FilmAbout | FilmStep | FilmLine | FilmNames
_SAID: Final = msgspec.msgpack.Decoder(Said)
_ENCODER: Final = msgspec.msgpack.Encoder()


def said_bytes(said: Said) -> bytes:
    """What a source says, as bytes."""
    return _ENCODER.encode(said)


def said_of(data: bytes) -> Said:
    """What a source says, see `said_bytes`."""
    said: Said = _SAID.decode(data)
    return said


def actors_of(rows: bytes, bodies: list[FilmBody]) -> tuple[ActorState, ...]:
    """The actors of a frame."""
    return tuple(_actor(row, bodies[row["body"]]) for row in np.frombuffer(rows, ACTOR_ROW))


def _actor(row: np.void, body: FilmBody) -> ActorState:
    vx_mps, vy_mps = row["v_W_mps"].tolist()
    return ActorState(
        id=body.id,
        kind=ActorKind(body.kind),
        p_W_m=row["p_W_m"].astype(np.float64),
        yaw_rad=float(row["yaw_rad"]),
        pitch_rad=float(row["pitch_rad"]),
        v_W_mps=np.array([vx_mps, vy_mps, 0.0]),
        size_lwh_m=body.size_lwh_m,
        signals=int(row["lamps"]),
        look=ActorLook(body.look),
        piece=body.piece,
    )


def route_of(points: bytes) -> Route:
    """A way, without the edges it goes along."""
    xy = np.frombuffer(points, "<f4").reshape(-1, 2).astype(np.float64)
    arc_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(xy, axis=0).T)))
    return Route(points_W_m=xy, arc_m=arc_m, edge_index=np.zeros(len(xy), np.int32))


def signals_of(colours: list[tuple[str, str]]) -> tuple[SignalState, ...]:
    """The signals of a frame."""
    return tuple(SignalState(tls_id=name, colours=letters) for name, letters in colours)


def outline_of(chair: FilmChair) -> Outline:
    """The box around a chair."""
    length_m, width_m, height_m, middle_x_m = chair.outline
    return Outline(length_m=length_m, width_m=width_m, height_m=height_m, middle_x_m=middle_x_m)
