"""The light state of a street after a tick: a few kilobytes that suffice to draw it from anywhere.

A source sends what it is (`FilmAbout`), then a `FilmFrame` each tick, with lines in between
(`FilmLine`). What stays the same is sent again in each tick: packed, it takes next to nothing.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import msgspec
import numpy as np

from wcsim.bridge.world import World
from wcsim.supervisor.kpi import DROP
from wcsim.types import (
    ActorKind,
    ActorLook,
    ActorState,
    ClientSnapshot,
    Outline,
    Route,
    SignalState,
    Snapshot,
)

XY = tuple[float, float]
_DIGITS: Final = 4


class _FilmBody(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """What an actor is; see `ActorState`."""

    id: str
    kind: ActorKind
    piece: int = 0
    look: ActorLook = ActorLook.USUAL
    signals: int = 0


class TickSays(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The sticks of one chair in a tick, and what its policy said; None where it is not known."""

    stick: XY | None = None  # what its user asked for in this tick
    commanded: XY | None = None  # what it was given
    unsafe: list[int] | None = None  # actions that its policy holds for unsafe
    warning: bool = False
    intervening: bool = False
    overruled: bool = False
    helped: bool = False
    alone: bool = False  # the user drives alone, before a handover
    # No policy has a say: there is none, it is off, or it always follows the stick.
    unaided: bool = False


class FilmChair(TickSays, frozen=True, kw_only=True, omit_defaults=True):
    """A chair after a tick; None is what a source does not know."""

    seat: int
    p_WB_m: list[float]  # 3
    q_WB: list[float]  # 4
    outline: Outline
    speed_mps: float
    crashed: bool = False
    dropped: bool = False  # beside `crashed`: it fell off a kerb
    arrived: bool = False
    gave_up: bool = False
    truncated: bool = False
    reason: str = ""  # of a crash, as `Events.crash`
    step: int = -1  # of the episode, 1 after its first tick
    done_m: float = 0.0  # of its route
    left_m: float | None = None


class FilmFrame(msgspec.Struct, frozen=True, kw_only=True):
    """The street after a tick."""

    epoch: int
    tick: int
    time_s: float
    bodies: list[_FilmBody]  # of the actors
    # (n, 11) float32 of them: position, yaw, pitch, velocity, size; 8 km from the origin to 0.5 mm
    rows: bytes
    chairs: list[FilmChair]
    ways: dict[int, bytes] = {}  # by seat: its route's points, (n, 2) float32
    signals: tuple[SignalState, ...] = ()

    @property
    def actors(self) -> tuple[ActorState, ...]:
        """The actors."""
        rows = np.frombuffer(self.rows, "<f4").reshape(len(self.bodies), 11).astype(np.float64)
        return tuple(
            ActorState(
                **msgspec.structs.asdict(body),
                p_W_m=row[:3],
                yaw_rad=float(row[3]),
                pitch_rad=float(row[4]),
                v_W_mps=row[5:8],
                size_lwh_m=(float(row[8]), float(row[9]), float(row[10])),
            )
            for body, row in zip(self.bodies, rows, strict=True)
        )

    def route(self, seat: int) -> Route | None:
        """A chair's way, without the edges it goes along; None where it is not known."""
        if seat not in self.ways:
            return None
        xy = np.frombuffer(self.ways[seat], "<f4").reshape(-1, 2).astype(np.float64)
        arc_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(xy, axis=0).T)))
        return Route(points_W_m=xy, arc_m=arc_m, edge_index=np.zeros(len(xy), np.int32))


class FilmAbout(msgspec.Struct, frozen=True, kw_only=True):
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


class FilmLine(msgspec.Struct, frozen=True, kw_only=True):
    """A message: `kind` is "now" (what goes on), "mark" (of the time line), "bad" or "end"."""

    kind: str
    told: str


class FilmNames(msgspec.Struct, frozen=True, kw_only=True):
    """Who sits where."""

    names: dict[int, str]


Said = FilmAbout | FilmFrame | FilmLine | FilmNames


class FrameMaker:
    """Makes frames of a world. It keeps each chair's way, which changes as an episode ends."""

    def __init__(self) -> None:
        # By seat: its box, its way, and what is done of that.
        self._on: dict[int, tuple[Outline, Route, float]] = {}

    def begin(self, world: World) -> None:
        """Note the ways of the chairs before a tick, for episodes that end with it."""
        self._look(world, ())

    def look(self, world: World) -> None:
        """The world after a tick."""
        self._look(
            world, {client.seat for client in world.snapshot.clients if client.first is not None}
        )

    def frame(self, now: Snapshot, said: Mapping[int, TickSays]) -> FilmFrame:
        """A tick that `look` has seen; `said` by seat."""
        rows = [(*a.p_W_m, a.yaw_rad, a.pitch_rad, *a.v_W_mps, *a.size_lwh_m) for a in now.actors]
        return FilmFrame(
            epoch=now.epoch,
            tick=now.tick,
            time_s=now.time_s,
            bodies=bodies_of(now.actors),
            rows=np.array(rows, "<f4").tobytes(),
            signals=now.signals,
            chairs=[
                self._chair(client, said.get(client.seat, TickSays())) for client in now.clients
            ],
            ways={
                client.seat: self._on[client.seat][1].points_W_m.astype("<f4").tobytes()
                for client in now.clients
            },
        )

    def _look(self, world: World, ended: Iterable[int]) -> None:
        for seat in world.seats:
            if seat.index not in ended or seat.index not in self._on:
                self._on[seat.index] = seat.chair.outline, seat.route, seat.user.route_progress_m

    def _chair(self, client: ClientSnapshot, said: TickSays) -> FilmChair:
        events, plant = client.events, client.plant
        outline, route, done_m = self._on[client.seat]
        return FilmChair(
            **msgspec.structs.asdict(said),
            seat=client.seat,
            p_WB_m=plant.p_WB_m.round(_DIGITS).tolist(),
            q_WB=plant.q_WB.round(_DIGITS + 2).tolist(),
            outline=outline,
            speed_mps=round(float(plant.v_B_mps[0]), _DIGITS),
            **{
                name: getattr(events, name)
                for name in ("crashed", "arrived", "gave_up", "truncated", "step")
            },
            dropped=events.crashed and events.crash_reason == DROP,
            reason=events.crash,
            done_m=round(done_m, 2),
            left_m=round(max(0.0, float(route.arc_m[-1]) - done_m), 2),
        )


def bodies_of(actors: Sequence[object]) -> list[_FilmBody]:
    """What these actors are, or bodies of a trace."""
    return msgspec.convert(actors, list[_FilmBody], from_attributes=True)
