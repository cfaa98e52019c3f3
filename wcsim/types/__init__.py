"""The shared types: every type that crosses a package border. Import them from here.

SI units and radians. World frame W: x east, y north, z up, yaw counter-clockwise from east. Body
frame B of a wheelchair: x forward, y left, z up, origin on the ground below the middle of the drive
axle. Dataclasses are frozen; arrays in them are read-only by convention, and those of a `Snapshot`
are valid until the next tick.
"""

from wcsim.types.actors import ActorKind, ActorLook, ActorState, SignalState, chair_actor_id
from wcsim.types.arrays import F32, F64, I32, I64, U8, Bool, ComparesArrays
from wcsim.types.bounds import CLIENT_NAME
from wcsim.types.chair import (
    CameraFrame,
    Command,
    Contact,
    ImuFrame,
    Joystick,
    Measure,
    Outline,
    PlantState,
    Reading,
    SensorFrame,
)
from wcsim.types.episode import (
    ClientSnapshot,
    Drawn,
    Events,
    RewardTerms,
    SeatSpec,
    Snapshot,
    StartSpec,
    Truth,
    UserView,
    Verdict,
)
from wcsim.types.street import (
    ClassId,
    Ground,
    GroundPaint,
    Mark,
    OneTile,
    Relief,
    Route,
    SignalHead,
    Street,
    StreetGrid,
    StreetMesh,
    TileKey,
    WalkEdge,
    WalkGraph,
    WayKind,
)

__all__ = (
    "CLIENT_NAME",
    "F32",
    "F64",
    "I32",
    "I64",
    "U8",
    "ActorKind",
    "ActorLook",
    "ActorState",
    "Bool",
    "CameraFrame",
    "ClassId",
    "ClientSnapshot",
    "Command",
    "ComparesArrays",
    "Contact",
    "Drawn",
    "Events",
    "Ground",
    "GroundPaint",
    "ImuFrame",
    "Joystick",
    "Mark",
    "Measure",
    "OneTile",
    "Outline",
    "PlantState",
    "Reading",
    "Relief",
    "RewardTerms",
    "Route",
    "SeatSpec",
    "SensorFrame",
    "SignalHead",
    "SignalState",
    "Snapshot",
    "StartSpec",
    "Street",
    "StreetGrid",
    "StreetMesh",
    "TileKey",
    "Truth",
    "UserView",
    "Verdict",
    "WalkEdge",
    "WalkGraph",
    "WayKind",
    "chair_actor_id",
)
