"""The vocabulary: every type that crosses a package border.

SI units and radians. World frame W: x east, y north, z up, yaw counter-clockwise from east. Body frame B of a
wheelchair: x forward, y left, z up, origin on the ground below the middle of the drive axle. Dataclasses are frozen;
arrays in them are read-only by convention, and those of a `Snapshot` are valid until the next tick.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum, IntEnum
from typing import Literal

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]
F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]


class ComparesArrays:
    """Equality that holds for arrays too: same type, equal fields, arrays equal element by element."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return False
        return all(
            bool(np.array_equal(a, b)) if isinstance(a, np.ndarray) else a == b
            for a, b in ((getattr(self, item.name), getattr(other, item.name)) for item in fields(self))  # type: ignore[arg-type]
        )


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


class ClassId(IntEnum):
    """Pixel classes: Cityscapes labelIds, and three of our own from 34 on (folded by `class_fold_table`)."""

    VOID = 0
    STATIC = 4
    DYNAMIC = 5
    GROUND = 6
    ROAD = 7
    SIDEWALK = 8
    PARKING = 9
    RAIL_TRACK = 10
    BUILDING = 11
    WALL = 12
    FENCE = 13
    POLE = 17
    TRAFFIC_LIGHT = 19
    TRAFFIC_SIGN = 20
    VEGETATION = 21
    TERRAIN = 22
    SKY = 23
    PERSON = 24
    RIDER = 25
    CAR = 26
    TRUCK = 27
    BUS = 28
    TRAIN = 31
    MOTORCYCLE = 32
    BICYCLE = 33
    KERB = 34
    LOWERED_KERB = 35
    CROSSWALK = 36


# --- the street as it stands ---


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StreetMesh(ComparesArrays):
    """Everything that stands still, as one triangle soup for wheels and cameras alike.

    Triangles are sorted by chunk; chunk c owns faces `chunk_faces[c]:chunk_faces[c + 1]` and uses only vertices
    `chunk_vertices[c]:chunk_vertices[c + 1]`, so that it can be culled (camera) and merged (collision) alone.
    """

    vertices_W_m: F32  # (V, 3)
    faces: I32  # (F, 3) indices into vertices_W_m, counter-clockwise seen from outside (up for ground)
    face_class: U8  # (F,) ClassId
    chunk_vertices: I32  # (C + 1,)
    chunk_faces: I32  # (C + 1,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StreetGrid(ComparesArrays):
    """The same street seen straight from above, as rasters for quick questions (oracle, spawn, walking people).

    Cell (row, col) covers x from origin_W_m[0] + col * cell_m and y from origin_W_m[1] + row * cell_m.
    """

    origin_W_m: tuple[float, float]
    cell_m: float
    height_cm: U8  # (rows, cols) ground height above z_base_m, centimetres
    z_base_m: float
    ground_class: U8  # (rows, cols) ClassId of the ground surface
    clearance_dm: U8  # (rows, cols) distance to the nearest solid thing (wall, trunk, pole), decimetres, 255 = far

    def cells(self, p_W_m: F64) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Rows and columns of the points (..., 2 or 3); points outside fall on the nearest border cell."""
        rows, cols = self.height_cm.shape
        col = np.floor((p_W_m[..., 0] - self.origin_W_m[0]) / self.cell_m).astype(np.intp)
        row = np.floor((p_W_m[..., 1] - self.origin_W_m[1]) / self.cell_m).astype(np.intp)
        return np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)

    def height_at(self, p_W_m: F64) -> F64:
        """Ground height in metres under the points (..., 2 or 3)."""
        return np.asarray(self.z_base_m + self.height_cm[self.cells(p_W_m)] * 0.01, np.float64)

    def clearance_at(self, p_W_m: F64) -> F64:
        """Distance in metres from the points (..., 2 or 3) to the nearest solid thing, at most 25.5."""
        return np.asarray(self.clearance_dm[self.cells(p_W_m)] * 0.1, np.float64)

    def class_at(self, p_W_m: F64) -> U8:
        """ClassId of the ground under the points (..., 2 or 3)."""
        return self.ground_class[self.cells(p_W_m)]


class WayKind(Enum):
    """What kind of ground a piece of a walking route runs over."""

    SIDEWALK = "sidewalk"
    WALKINGAREA = "walkingarea"
    CROSSING = "crossing"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkEdge(ComparesArrays):
    """One piece of the walking network, passable both ways."""

    sumo_id: str
    kind: WayKind
    start: int  # node index
    end: int
    points_W_m: F64  # (K, 2), from start to end
    width_m: float
    tls_id: str = ""  # the traffic light that governs it, "" for none
    tls_links: tuple[int, ...] = ()  # indices of its signals in that light's state string


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkGraph(ComparesArrays):
    """Where a wheelchair may drive: pavements, walking areas and crossings, as nodes and edges."""

    nodes_W_m: F64  # (N, 2)
    edges: tuple[WalkEdge, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Route(ComparesArrays):
    """A way for the simulated user: a polyline over the walk graph."""

    points_W_m: F64  # (K, 2)
    arc_m: F64  # (K,) distance from the start
    edge_index: I32  # (K,) index into WalkGraph.edges of the piece that starts at this point


@dataclass(frozen=True, slots=True, kw_only=True)
class Street:
    """What `towns` makes of a town for the others."""

    mesh: StreetMesh
    grid: StreetGrid
    walk: WalkGraph


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
    depth_m: F32  # (H, W) distance along the optical axis, 0..range; range where nothing is hit
    class_id: U8  # (H, W) ClassId
    rgb: U8 | None = None  # (H, W, 3), only when the camera asks for it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuFrame(ComparesArrays):
    """What the IMU and the tilt sensor say of one tick."""

    accel_mean_mps2: F64  # (3,) specific force in the sensor frame, tick mean, gravity included
    accel_peak_mps2: F64  # (3,) largest |.| per axis within the tick after the 20 Hz low-pass, gravity removed
    gyro_radps: F64  # (3,)
    roll_rad: float
    pitch_rad: float
    yaw_rad: float


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
class Truth(ComparesArrays):
    """What only a simulator knows; for metrics and the oracle, never part of an observation."""

    intent: Joystick  # the user's clean intent
    danger: bool  # holding the user's command for 0.5 s and then braking would end badly
    safe_actions: Bool  # (A,) the same question for each action of the set
    clearance_m: float  # free distance around the chair now
    progress_m: float  # along the route during this tick


@dataclass(frozen=True, slots=True, kw_only=True)
class Events:
    """What happened to a seat during a tick, decided once, in the world."""

    episode: int
    step: int  # steps of this episode so far, this one included
    crashed: bool
    crash_reason: str  # "", "collision", "acceleration", "tilt"
    truncated: bool
    arrived: bool
    gave_up: bool
    progress_m: float = 0.0  # along the route during this tick
    jam_teleports: int = 0


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

    profile: str = "inattentive"
    max_steps: int = 10_000
    truth: bool = False
    start: StartSpec | None = None
