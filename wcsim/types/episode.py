"""What passes between a world and its users: actors and signals, a chair and its sensors, episodes, snapshots."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np

from wcsim.types.arrays import F32, F64, U8, Bool, ComparesArrays
from wcsim.types.street import (
    Route,
)


class ActorKind(Enum):
    """Kinds of actors in the street; an unknown SUMO class becomes OTHER."""

    CAR = "car"
    TRUCK = "truck"
    BUS = "bus"
    TRAM = "tram"
    MOTORCYCLE = "motorcycle"
    BICYCLE = "bicycle"
    SCOOTER = "scooter"
    PEDESTRIAN = "pedestrian"
    WHEELCHAIR = "wheelchair"
    OTHER = "other"


class ActorLook(Enum):
    """Variant of an actor's appearance; only the cameras use it."""

    USUAL = "usual"
    VAN = "van"
    TAXI = "taxi"
    POLICE = "police"
    AMBULANCE = "ambulance"
    COACH = "coach"
    MOPED = "moped"
    FRONT = "front"  # the three rigid pieces of an articulated vehicle
    MIDDLE = "middle"
    REAR = "rear"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ActorState(ComparesArrays):
    """One SUMO vehicle or person after a step; the point is the middle of its box, on the ground, deflected."""

    id: str
    kind: ActorKind
    p_W_m: F64  # (3,)
    yaw_rad: float
    pitch_rad: float  # nose up positive
    v_W_mps: F64  # (3,)
    size_lwh_m: tuple[float, float, float]
    signals: int = 0  # SUMO's signal bits, 0 for persons
    deflect_m: float = 0.0  # sideways offset that the bridge added to SUMO's pose, left positive
    look: ActorLook = ActorLook.USUAL
    piece: int = 0  # of an articulated vehicle: 0 is the first rigid piece, under SUMO's id; 1... are those behind it

    @property
    def whole_id(self) -> str:
        """SUMO's id of the whole vehicle, for any of its pieces."""
        return self.id.rpartition("~")[0] if self.piece else self.id


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalState:
    """The colours of one traffic light, in SUMO's letters."""

    tls_id: str
    colours: str

    def frees(self, links: Iterable[int]) -> bool:
        """Whether people may start over a crossing with these links; if the light is off, they may."""
        return not any(self.colours[link] in "rRyYu" for link in links if link < len(self.colours))


def chair_actor_id(seat: int) -> str:
    """The actor id of the wheelchair of a seat, as other seats see it."""
    return f"w:{seat}"


@dataclass(frozen=True, slots=True)
class Joystick:
    """A joystick position: x right, y forward, each in [-1, 1]."""

    x: float
    y: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """The joystick command of a seat for one tick."""

    seat: int
    tick: int
    joystick: Joystick


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlantState(ComparesArrays):
    """The true state of a wheelchair."""

    p_WB_m: F64  # (3,)
    q_WB: F64  # (4,) x, y, z, w
    v_B_mps: F64  # (3,)
    w_B_radps: F64  # (3,)
    wheel_radps: F64  # (2,) left, right drive wheel
    roll_rad: float  # right side down positive
    pitch_rad: float  # nose up positive
    yaw_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline:
    """The box around a wheelchair with its user."""

    length_m: float
    width_m: float
    height_m: float
    middle_x_m: float  # from the drive axle forward to the middle of its length

    @property
    def size_lwh_m(self) -> tuple[float, float, float]:
        """Length, width and height."""
        return self.length_m, self.width_m, self.height_m

    @property
    def half_lw_m(self) -> tuple[float, float]:
        """Half the length and half the width."""
        return 0.5 * self.length_m, 0.5 * self.width_m

    @property
    def front_x_m(self) -> float:
        """Its front, ahead of the drive axle."""
        return self.middle_x_m + 0.5 * self.length_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """A contact in one tick between a part of the wheelchair and something else; impulses are summed over the tick."""

    kind: str  # an ActorKind value, or "ground", "kerb", "building", "static"
    part: str  # "wheel", "caster", "antitip", "footplate", "body"
    impulse_Ns: float
    cause: Literal["own", "other"]
    actor_id: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraFrame(ComparesArrays):
    """One image. A slower camera repeats its last image with the old `taken_tick`."""

    name: str
    taken_tick: int
    depth_m: F32  # (H, W) along the optical axis; range where nothing is hit, 0 where nothing was measured (noise)
    class_id: U8  # (H, W) ClassId, VOID where the noise leaves no class
    rgb: U8 | None = None  # (H, W, 3), only if the camera draws colours


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuFrame(ComparesArrays):
    """Measurements of the IMU and the tilt sensor in one tick."""

    accel_mean_mps2: F64  # (3,) specific force in the sensor frame, tick mean, gravity included
    accel_peak_mps2: F64  # (3,) largest |.| per axis within the tick after the 20 Hz low-pass, gravity removed; exact
    gyro_radps: F64  # (3,) tick mean
    roll_rad: float  # as the tilt sensor measures it; the true tilt is in PlantState
    pitch_rad: float
    yaw_rad: float  # exact


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """Description of a sensor of `[sensors]`: its reading has one float64 for each part, in this order."""

    parts: tuple[str, ...]  # name and unit of each number, as speed_mps
    full_scale: tuple[float, ...]  # of each; the observation holds number / full_scale as float32, cut to [-1, 1]
    mirror: tuple[float, ...]  # 1 or -1: the sign of each if left and right are exchanged


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reading(ComparesArrays):
    """Reading of one sensor of `[sensors]` in one tick; its `Measure` describes the numbers."""

    name: str
    values: F64  # (len(parts),)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFrame:
    """All sensor readings of one seat after a tick."""

    tick: int
    cameras: tuple[CameraFrame, ...]
    imu: ImuFrame
    readings: tuple[Reading, ...] = ()  # of the sensors in `[sensors]`, by name


CLIENT_NAME = r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}"
"""Pattern of a client's name: a plain word, so that it can name a folder and be printed anywhere."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UserView(ComparesArrays):
    """Everything that the simulated user may perceive in one tick: made by World, read by `users/user.py`."""

    time_s: float
    p_W_m: F64  # (3,)
    yaw_rad: float
    speed_mps: float
    route: Route
    actors: tuple[ActorState, ...]  # those that the user can see, other wheelchairs included
    signals: tuple[SignalState, ...]
    obstacles_W_m: F64  # (n, 4) x, y, radius of static obstacles near the route, number of the obstacle


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
    clearance_m: float  # free distance around the chair now
    progress_m: float  # along the route during this tick
    visible: Verdict | None = None  # as judged with only the actors that the cameras showed lately


@dataclass(frozen=True, slots=True, kw_only=True)
class Events:
    """Events of a seat during a tick; the world decides them once."""

    episode: int
    step: int  # steps of this episode so far, this one included
    crashed: bool
    crash_reason: str  # "", "collision", "drop", "acceleration", "tilt"
    truncated: bool
    arrived: bool
    gave_up: bool
    progress_m: float = 0.0  # along the route during this tick
    jam_teleports: int = 0
    on_carriageway: bool = False  # the chair's middle is on a carriageway or a crossing now
    crossed: bool = False  # it finished a crossing, from one pavement to the opposite one
    entered_red: bool = False  # it started over a crossing at red
    crash: str = ""  # in words: the other party, who hit whom, edge and place in SUMO's net
    help_asked: bool = False  # the user asked for help


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """Values drawn for a seat's episode from the ranges of `[vary]`; None or empty where there is no range."""

    light: float | None = None  # factor on the usual brightness of colours
    friction: float | None = None  # factor on the friction of wheels and casters
    user_mass_kg: float | None = None
    camera_shift_m: tuple[tuple[float, float, float], ...] = ()  # along x, y, z of B, by camera
    camera_turn_rad: tuple[tuple[float, float], ...] = ()  # to the left and up, by camera
    action_delay_ticks: int | None = None
    plant: tuple[tuple[str, float], ...] = ()  # by dotted name, sorted
    attention: tuple[tuple[str, float], ...] = ()  # share of drivers that look for this chair, by class or "all"
    reaction_s: tuple[tuple[str, float], ...] = ()  # until an attentive driver brakes for this chair, as above
    sensors: tuple[tuple[str, float], ...] = ()  # the same of [sensors]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientSnapshot:
    """The part of a snapshot that belongs to one seat."""

    seat: int
    tick: int
    plant: PlantState
    sensors: SensorFrame
    user: Joystick  # the user's stick as the agent sees it (raw)
    contacts: tuple[Contact, ...]
    events: Events
    truth: Truth | None = None
    drawn: Drawn | None = None  # of this episode, when the configuration has ranges
    first: ClientSnapshot | None = None  # the first frame of the next episode, when this one ended with this tick


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


@dataclass(frozen=True, slots=True, kw_only=True)
class RewardTerms:
    """The reward of one step, term by term (Tables 1 and 2 of the paper); `extra` is the user's own term."""

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
    """A fixed start for every episode of a seat (scenes); without one, starts and destinations are drawn."""

    p_W_m: tuple[float, float]
    yaw_rad: float
    goal_W_m: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class SeatSpec:
    """What a client requests when it takes a seat; everything else is in the world's configuration."""

    profile: str = "inattentive"  # or FILE.toml, or recorded:FILE
    max_steps: int = 10_000
    truth: bool = False
    truth_visible: bool = False  # the truth includes `visible`
    start: StartSpec | None = None
