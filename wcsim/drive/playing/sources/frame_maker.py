"""Makes the light states of a film out of what a world shows after a tick."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.bridge.world import World
from wcsim.config import RewardConfig
from wcsim.drive.playing.film_states import ACTOR_ROW, XY, FilmBody, FilmChair, FilmFrame, FilmStep, Flag
from wcsim.supervisor.fault import crash_words
from wcsim.supervisor.kpi import FOLLOWED
from wcsim.types import ActorState, ClientSnapshot, Joystick, Outline, Route, SignalState

_DIGITS: Final = 4
_NO_FLAGS: Final = Flag(0)


@dataclass(frozen=True, slots=True, kw_only=True)
class TickSays:
    """What was asked and given in a tick for one chair, and what its policy said; None is what is not known."""

    stick: Joystick | None = None
    commanded: Joystick | None = None
    flags: Flag = _NO_FLAGS  # of policies and people; what happened is the world's to say
    unsafe: tuple[int, ...] | None = None


NOTHING_SAID: Final = TickSays()


class FrameMaker:
    """Numbers what comes up, and remembers which way each chair was on."""

    def __init__(self) -> None:
        self._bodies: dict[FilmBody, int] = {}
        self._ways: dict[int, tuple[Route, int]] = {}  # by seat: the newest, and its number
        self._numbered = 0  # of ways
        self._signals: dict[Hashable, int] = {}
        self._on: dict[int, tuple[int, float, float]] = {}  # by seat: its way, what is done of it, what is left
        self._new = FilmStep(frame=FilmFrame(epoch=0, tick=0, time_s=0.0, actors=b"", signals=-1, chairs=[]))

    def begin(self, world: World) -> None:
        """The world before a tick: the ways that the chairs are on now, for those that end with it."""
        for seat in world.seats:
            self._note_way(seat.index, seat.route, seat.user.route_progress_m)

    def step_of(self, world: World, said: Mapping[int, TickSays]) -> FilmStep:
        """The world after a tick; `said` by seat."""
        now = world.snapshot
        outlines = {seat.index: seat.chair.outline for seat in world.seats}
        for client in now.clients:
            if client.first is None:
                seat = next(seat for seat in world.seats if seat.index == client.seat)
                self._note_way(seat.index, seat.route, seat.user.route_progress_m)
        chairs = [
            self._chair(client, outlines[client.seat], said.get(client.seat, NOTHING_SAID), world.config.reward)
            for client in now.clients
        ]
        return self.step(now.epoch, now.tick, now.time_s, now.actors, chairs, now.signals)

    def step(
        self,
        epoch: int,
        tick: int,
        time_s: float,
        actors: Sequence[ActorState],
        chairs: list[FilmChair],
        signals: Iterable[SignalState] | None = None,
    ) -> FilmStep:
        """A tick of these actors and chairs, with all that is new in it; `signals` None where they are not known."""
        frame = FilmFrame(
            epoch=epoch,
            tick=tick,
            time_s=time_s,
            actors=self._rows(actors),
            signals=-1 if signals is None else self._colours(signals),
            chairs=chairs,
        )
        new = self._new
        self._new = FilmStep(frame=frame, bodies=[], ways=[], signals=[])
        return FilmStep(frame=frame, bodies=new.bodies, ways=new.ways, signals=new.signals)

    def _rows(self, actors: Sequence[ActorState]) -> bytes:
        rows = np.zeros(len(actors), ACTOR_ROW)
        for row, actor in zip(rows, actors, strict=True):
            row["body"] = self._body(actor)
            row["p_W_m"], row["v_W_mps"] = actor.p_W_m, actor.v_W_mps[:2]
            row["yaw_rad"], row["pitch_rad"], row["lamps"] = actor.yaw_rad, actor.pitch_rad, actor.signals
        return rows.tobytes()

    def _body(self, actor: ActorState) -> int:
        length_m, width_m, height_m = (float(size) for size in actor.size_lwh_m)
        body = FilmBody(actor.id, actor.kind.value, (length_m, width_m, height_m), actor.look.value, actor.piece)
        number = self._bodies.get(body)
        if number is None:
            number = self._bodies[body] = len(self._bodies)
            self._new.bodies.append(body)
        return number

    def _colours(self, signals: Iterable[SignalState]) -> int:
        said = tuple((signal.tls_id, signal.colours) for signal in signals)
        number = self._signals.get(said)
        if number is None:
            number = self._signals[said] = len(self._signals)
            self._new.signals.append(list(said))
        return number

    def _note_way(self, seat: int, route: Route, done_m: float) -> None:
        newest, number = self._ways.get(seat, (None, -1))
        if newest is not route:
            number, self._numbered = self._numbered, self._numbered + 1
            self._ways[seat] = route, number
            self._new.ways.append(route.points_W_m.astype("<f4").tobytes())
        self._on[seat] = (number, done_m, max(0.0, float(route.arc_m[-1]) - done_m))

    def _chair(self, client: ClientSnapshot, outline: Outline, said: TickSays, reward: RewardConfig) -> FilmChair:
        events, plant = client.events, client.plant
        way, done_m, left_m = self._on.get(client.seat, (-1, 0.0, -1.0))
        flags = said.flags
        for flag, is_so in (
            (Flag.CRASHED, events.crashed),
            (Flag.DROPPED, events.crashed and events.crash_reason == "drop"),
            (Flag.ARRIVED, events.arrived),
            (Flag.GAVE_UP, events.gave_up),
            (Flag.TRUNCATED, events.truncated),
        ):
            flags |= flag if is_so else Flag(0)
        return FilmChair(
            seat=client.seat,
            p_WB_m=_rounded3(plant.p_WB_m.tolist()),
            q_WB=quaternion(plant.q_WB.tolist()),
            outline=(outline.length_m, outline.width_m, outline.height_m, outline.middle_x_m),
            speed_mps=round(float(plant.v_B_mps[0]), _DIGITS),
            stick=stick_of(said.stick),
            commanded=stick_of(said.commanded),
            flags=int(flags),
            reason=crash_words(client, reward) if events.crashed else "",
            episode=events.episode,
            step=events.step,
            way=way,
            done_m=round(done_m, 2),
            left_m=round(left_m, 2),
            unsafe=None if said.unsafe is None else list(said.unsafe),
        )


def intervening(stick: Joystick | None, commanded: Joystick) -> Flag:
    """Whether what a chair was given follows its user's stick no more, by the tolerance of KPI 1."""
    if stick is None:
        return Flag(0)
    far = math.hypot(stick.x - commanded.x, stick.y - commanded.y) > FOLLOWED
    return Flag.INTERVENING if far else Flag(0)


def stick_of(stick: Joystick | None) -> XY | None:
    """A stick as a film holds it."""
    return None if stick is None else (round(stick.x, _DIGITS), round(stick.y, _DIGITS))


def quaternion(values: Sequence[float]) -> tuple[float, float, float, float]:
    """A turn as a film holds it."""
    x, y, z, w = (round(value, _DIGITS + 2) for value in values)
    return x, y, z, w


def _rounded3(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = (round(value, _DIGITS) for value in values)
    return x, y, z


def asked_before(clients: Iterable[ClientSnapshot]) -> dict[int, Joystick]:
    """The sticks that the next tick answers, by seat."""
    return {client.seat: (client.first or client).user for client in clients}
