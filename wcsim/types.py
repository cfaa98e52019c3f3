"""The vocabulary: every type that crosses a package border.

SI units and radians. World frame W: x east, y north, z up, yaw counter-clockwise from east. Body frame B of a
wheelchair: x forward, y left, z up, origin on the ground below the middle of the drive axle. Dataclasses are frozen;
arrays in them are read-only by convention, and those of a `Snapshot` are valid until the next tick.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np

from wcsim.arrays import F32 as F32
from wcsim.arrays import F64 as F64
from wcsim.arrays import I32 as I32
from wcsim.arrays import U8 as U8
from wcsim.arrays import Bool as Bool
from wcsim.arrays import ComparesArrays as ComparesArrays
from wcsim.streets import ClassId as ClassId
from wcsim.streets import Ground as Ground
from wcsim.streets import OneTile as OneTile
from wcsim.streets import Relief as Relief
from wcsim.streets import Route as Route
from wcsim.streets import SignalHead as SignalHead
from wcsim.streets import Street as Street
from wcsim.streets import StreetGrid as StreetGrid
from wcsim.streets import StreetMesh as StreetMesh
from wcsim.streets import StreetTiles as StreetTiles
from wcsim.streets import TileKey as TileKey
from wcsim.streets import WalkEdge as WalkEdge
from wcsim.streets import WalkGraph as WalkGraph
from wcsim.streets import WayKind as WayKind

CLIENT_NAME = r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}"
"""What a client may be called: a plain word, so that it can name a folder and be printed anywhere."""


class ActorKind(Enum):
    """What moves in the street; a SUMO class that is not known here becomes OTHER."""

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
    """How an actor differs from the usual one of its kind; only the cameras care."""

    USUAL = "usual"
    VAN = "van"
    TAXI = "taxi"
    POLICE = "police"
    AMBULANCE = "ambulance"
    COACH = "coach"
    MOPED = "moped"
    FRONT = "front"  # the three rigid pieces of something articulated
    MIDDLE = "middle"
    REAR = "rear"


# --- what moves ---


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
    piece: int = 0  # of something articulated: 0 its first rigid piece, under SUMO's id, 1... those behind it

    @property
    def whole_id(self) -> str:
        """SUMO's id of the whole, whichever piece this is."""
        return self.id.rpartition("~")[0] if self.piece else self.id


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalState:
    """The colours of one traffic light, in SUMO's letters."""

    tls_id: str
    colours: str


# --- the wheelchair ---


def chair_actor_id(seat: int) -> str:
    """The name under which others meet the wheelchair of a seat."""
    return f"w:{seat}"


@dataclass(frozen=True, slots=True)
class Joystick:
    """A joystick position: x right, y forward, each in [-1, 1]."""

    x: float
    y: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """What a seat wants its wheelchair to do during a tick."""

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
    """A touch during one tick between a part of the wheelchair and something else, impulses summed over the tick."""

    kind: str  # an ActorKind value, or "ground", "kerb", "building", "static"
    part: str  # "wheel", "caster", "antitip", "footplate", "body"
    impulse_Ns: float
    cause: Literal["own", "other"]
    actor_id: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraFrame(ComparesArrays):
    """One image; a slower camera repeats its last one with its old `taken_tick`."""

    name: str
    taken_tick: int
    depth_m: F32  # (H, W) along the optical axis; range where nothing is hit, 0 where nothing was measured (noise)
    class_id: U8  # (H, W) ClassId, VOID where the noise leaves no class
    rgb: U8 | None = None  # (H, W, 3), only when the camera asks for it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuFrame(ComparesArrays):
    """What the IMU and the tilt sensor say of one tick."""

    accel_mean_mps2: F64  # (3,) specific force in the sensor frame, tick mean, gravity included
    accel_peak_mps2: F64  # (3,) largest |.| per axis within the tick after the 20 Hz low-pass, gravity removed; exact
    gyro_radps: F64  # (3,) tick mean
    roll_rad: float  # as the tilt sensor says; the true tilt is in PlantState
    pitch_rad: float
    yaw_rad: float  # exact


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFrame:
    """Everything that the sensors of one seat say after a tick."""

    tick: int
    cameras: tuple[CameraFrame, ...]
    imu: ImuFrame


# --- the user, the truth, the judgement ---


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UserView(ComparesArrays):
    """What the simulated user may know: made by World, read by `supervisor/user.py` once a tick."""

    time_s: float
    p_W_m: F64  # (3,)
    yaw_rad: float
    speed_mps: float
    route: Route
    actors: tuple[ActorState, ...]  # those within the user's sight, other wheelchairs among them
    signals: tuple[SignalState, ...]
    obstacles_W_m: F64  # (n, 4) x, y, radius of static things near the way, number of the thing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict(ComparesArrays):
    """What ends badly, as the oracle says it."""

    danger: bool  # holding the user's command for 0.5 s and then braking would end badly
    first_s: F64  # (A,) for each action of the set: seconds until that would go wrong, infinity when it ends well

    @property
    def safe_actions(self) -> Bool:
        """(A,) which actions end well."""
        safe: Bool = np.isinf(self.first_s)
        return safe


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth(Verdict):
    """What only a simulator knows; for metrics and the oracle, never part of an observation."""

    intent: Joystick  # the user's clean intent
    clearance_m: float  # free distance around the chair now
    progress_m: float  # along the route during this tick
    visible: Verdict | None = None  # of an oracle that knows only those of the others whom the cameras showed lately


@dataclass(frozen=True, slots=True, kw_only=True)
class Events:
    """What happened to a seat during a tick, decided once, in the world."""

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
    crossed: bool = False  # it got over a crossing: in from one pavement, out on the opposite one
    entered_red: bool = False  # its footplate passed the kerb line of a crossing that has red


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """What was drawn for a seat's episode from the ranges of `[vary]`; None and empty where there is no range."""

    light: float | None = None  # times the usual brightness of colours
    friction: float | None = None  # times that of wheels and casters
    user_mass_kg: float | None = None
    camera_shift_m: tuple[tuple[float, float, float], ...] = ()  # along x, y, z of B, by camera
    camera_turn_rad: tuple[tuple[float, float], ...] = ()  # to the left and up, by camera
    action_delay_ticks: int | None = None
    plant: tuple[tuple[str, float], ...] = ()  # by dotted name, sorted
    attention: tuple[tuple[str, float], ...] = ()  # share of those who look for this chair, by class or "all", sorted
    reaction_s: tuple[tuple[str, float], ...] = ()  # until who looks brakes for this chair, as above


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientSnapshot:
    """One seat's share of a snapshot."""

    seat: int
    tick: int
    plant: PlantState
    sensors: SensorFrame
    user: Joystick  # as the agent sees it (raw)
    contacts: tuple[Contact, ...]
    events: Events
    truth: Truth | None = None
    drawn: Drawn | None = None  # of this episode, when the configuration has ranges
    first: ClientSnapshot | None = None  # the first frame of the next episode, when this one ended with this tick


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """The world after tick `tick` was reached; the viewer, the recorder and the clients get the same object."""

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
    """What a client asks for when it takes a seat; everything else is in the world's configuration."""

    profile: str = "inattentive"  # or recorded:FILE.csv
    max_steps: int = 10_000
    truth: bool = False
    truth_visible: bool = False  # the truth with its part `visible`
    start: StartSpec | None = None
