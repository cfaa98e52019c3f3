"""An episode of one client: user, ground truth, events, and the snapshot that holds them."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from wcsim.types import bounds as b
from wcsim.types.actors import ActorState, SignalState
from wcsim.types.arrays import F64, Bool, ComparesArrays
from wcsim.types.chair import Contact, Joystick, PlantState, SensorFrame
from wcsim.types.street import Route

_A_CAMERA = Meta(max_length=b.MOST_CAMERAS)
_Shift = tuple[b.Number, b.Number, b.Number]
_Values = Annotated[tuple[tuple[b.Key, b.Number], ...], Meta(max_length=1024)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UserView(ComparesArrays):
    """Everything that the simulated user may perceive in one tick.

    The world makes it, `users/user.py` reads it.
    """

    time_s: float
    p_W_m: F64  # (3,)
    yaw_rad: float
    speed_mps: float
    route: Route
    actors: tuple[ActorState, ...]  # those that the user can see, other wheelchairs included
    signals: tuple[SignalState, ...]
    # (n, 4) x, y, radius of static obstacles near the route, number of the obstacle.
    obstacles_W_m: F64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict(ComparesArrays):
    """Which commands end in a crash, as judged by the oracle."""

    danger: bool  # holding the user's command for 0.5 s and then braking would end in a crash
    first_s: F64  # (A,) for each action: seconds until it fails, infinity if it is safe

    @property
    def safe_actions(self) -> Bool:
        """(A,) which actions are safe."""
        safe: Bool = np.isinf(self.first_s)
        return safe


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth(Verdict):
    """Ground truth of a tick: for metrics and the oracle, never part of an observation."""

    intent: Joystick  # the user's intent, before the hand's noise
    clearance_m: b.Number  # free distance around the chair now
    progress_m: b.Number  # along the route during this tick
    visible: Verdict | None = None  # as judged with only the actors that the cameras showed lately


@dataclass(frozen=True, slots=True, kw_only=True)
class Events:
    """Events of a seat during a tick; the world decides them once."""

    episode: b.CountOrNone
    step: b.Count  # steps of this episode so far, this one included
    crashed: bool
    crash_reason: b.NameOrNone  # "", "collision", "drop", "acceleration", "tilt"
    truncated: bool
    arrived: bool
    gave_up: bool
    progress_m: b.Number = 0.0  # along the route during this tick
    jam_teleports: b.Count = 0
    on_carriageway: bool = False  # the chair's middle is on a carriageway or a crossing now
    crossed: bool = False  # it finished a crossing, from one pavement to the opposite one
    entered_red: bool = False  # it started over a crossing at red
    crash: b.Line = ""  # in words: the other party, who hit whom, edge and place in SUMO's net
    help_asked: bool = False  # the user asked for help


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """Values drawn for a seat's episode from the ranges of `[vary]`; None or empty where there is no range."""  # noqa: E501

    light: b.Number | None = None  # factor on the usual brightness of colours
    friction: b.Number | None = None  # factor on the friction of wheels and casters
    user_mass_kg: b.Number | None = None
    camera_shift_m: Annotated[tuple[_Shift, ...], _A_CAMERA] = ()  # along x, y, z of B, by camera
    # To the left and up, by camera.
    camera_turn_rad: Annotated[tuple[tuple[b.Radians, b.Radians], ...], _A_CAMERA] = ()
    action_delay_ticks: b.Delay | None = None
    plant: _Values = ()  # by dotted name, sorted
    attention: _Values = ()  # share of drivers that look for this chair, by class or "all"
    reaction_s: _Values = ()  # until an attentive driver brakes for this chair, as above
    sensors: _Values = ()  # the same of [sensors]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientSnapshot:
    """The part of a snapshot that belongs to one seat."""

    seat: b.Seat
    tick: b.Count
    plant: PlantState
    sensors: SensorFrame
    user: Joystick  # the user's stick as the agent sees it (raw)
    contacts: Annotated[tuple[Contact, ...], Meta(max_length=b.MOST_CONTACTS)]
    events: Events
    truth: Truth | None = None
    drawn: Drawn | None = None  # of this episode, when the configuration has ranges
    # The first frame of the next episode, when this one ended with this tick.
    first: ClientSnapshot | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """The world after tick `tick`; viewer, recorder and clients get the same object."""

    epoch: int
    tick: int
    time_s: float
    actors: tuple[ActorState, ...]  # sorted by id, those mirrored near a wheelchair
    signals: tuple[SignalState, ...]
    clients: tuple[ClientSnapshot, ...]  # by seat
    state_hash: str = ""

    def digest(self) -> str:
        """The one hash for golden scenes, journals and replay, as hexadecimal.

        It is 64 bits over the raw numbers of everything that moves.
        """
        digest = hashlib.blake2b(digest_size=8)
        digest.update(struct.pack("<qq", self.epoch, self.tick))
        for client in self.clients:
            digest.update(client.plant.row.tobytes())
            digest.update(struct.pack("<dd", client.user.x, client.user.y))
            digest.update(client.sensors.imu.accel_mean_mps2.tobytes())
            for reading in client.sensors.readings:
                digest.update(reading.name.encode() + reading.values.tobytes())
        for actor in self.actors:
            digest.update(actor.id.encode())
        digest.update(np.array([actor.row for actor in self.actors]).tobytes())
        return digest.hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class RewardTerms:
    """The reward of one step, term by term (Tables 1 and 2 of the paper).

    `extra` is the user's own term.
    """

    base: float
    joystick: float
    accel: float
    tilt: float
    crash: float
    extra: float = 0.0

    @property
    def total(self) -> float:
        """Sum of all terms."""
        return self.base + self.joystick + self.accel + self.tilt + self.crash + self.extra


@dataclass(frozen=True, slots=True, kw_only=True)
class StartSpec:
    """A fixed start for every episode of a seat (scenes); without one, starts and destinations are drawn."""  # noqa: E501

    p_W_m: tuple[b.Metres, b.Metres]
    yaw_rad: b.Radians
    goal_W_m: tuple[b.Metres, b.Metres]


@dataclass(frozen=True, slots=True, kw_only=True)
class SeatSpec:
    """What a client requests when it takes a seat; everything else is in the world's configuration."""  # noqa: E501

    profile: b.Document = "inattentive"  # or FILE.toml, or recorded:FILE
    max_steps: b.Steps = 10_000
    truth: bool = False
    truth_visible: bool = False  # the truth includes `visible`
    # A reading lists what is near, for `env.observation=state`; cameras draw only colours then.
    near: bool = False
    start: StartSpec | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPlace:
    """Where the outputs of a world go, and what else its user requests of SUMO."""

    # A run folder; without one everything SUMO writes is removed when the world closes.
    folder: Path | None = None
    outputs: tuple[str, ...] = ()  # more outputs than the scenario's own: "fcd", "tripinfo", ...
    hook: str = ""  # a user's own module:Class, see `bridge/sumo/step_hook.py`
