"""Vehicles, people and signals: what moves or changes in the street besides wheelchairs."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from wcsim.types.arrays import F64, ComparesArrays


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

    # That of Enum is Python code, and every tick looks kinds up hundreds of times.
    __hash__ = object.__hash__


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
    """One SUMO vehicle or person after a step.

    The point is the middle of its box, on the ground, deflected.
    """

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
    # Of an articulated vehicle: 0 is the first rigid piece, under SUMO's id; 1... are behind it.
    piece: int = 0

    @property
    def row(self) -> tuple[float, ...]:
        """8 numbers: position, yaw, pitch, velocity."""
        return (*self.p_W_m, self.yaw_rad, self.pitch_rad, *self.v_W_mps)

    @property
    def is_person(self) -> bool:
        """Whether SUMO moves it as a person, whatever its class."""
        return self.id.startswith("p:")

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
        """Whether people may start over a crossing with these links; they may if it is off."""
        return not any(self.colours[link] in "rRyYu" for link in links if link < len(self.colours))


def chair_actor_id(seat: int) -> str:
    """The actor id of the wheelchair of a seat, as other seats see it."""
    return f"w:{seat}"
