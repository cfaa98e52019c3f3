"""The shared types: every type that crosses a package border. Import them from here, not from the files behind.

SI units and radians. World frame W: x east, y north, z up, yaw counter-clockwise from east. Body frame B of a
wheelchair: x forward, y left, z up, origin on the ground below the middle of the drive axle. Dataclasses are frozen;
arrays in them are read-only by convention, and those of a `Snapshot` are valid until the next tick.
"""

from __future__ import annotations

from wcsim.types.actors import ActorKind as ActorKind
from wcsim.types.actors import ActorLook as ActorLook
from wcsim.types.actors import ActorState as ActorState
from wcsim.types.actors import SignalState as SignalState
from wcsim.types.actors import chair_actor_id as chair_actor_id
from wcsim.types.arrays import F32 as F32
from wcsim.types.arrays import F64 as F64
from wcsim.types.arrays import I32 as I32
from wcsim.types.arrays import I64 as I64
from wcsim.types.arrays import U8 as U8
from wcsim.types.arrays import Bool as Bool
from wcsim.types.arrays import ComparesArrays as ComparesArrays
from wcsim.types.chair import CameraFrame as CameraFrame
from wcsim.types.chair import Command as Command
from wcsim.types.chair import Contact as Contact
from wcsim.types.chair import ImuFrame as ImuFrame
from wcsim.types.chair import Joystick as Joystick
from wcsim.types.chair import Measure as Measure
from wcsim.types.chair import Outline as Outline
from wcsim.types.chair import PlantState as PlantState
from wcsim.types.chair import Reading as Reading
from wcsim.types.chair import SensorFrame as SensorFrame
from wcsim.types.episode import CLIENT_NAME as CLIENT_NAME
from wcsim.types.episode import ClientSnapshot as ClientSnapshot
from wcsim.types.episode import Drawn as Drawn
from wcsim.types.episode import Events as Events
from wcsim.types.episode import RewardTerms as RewardTerms
from wcsim.types.episode import SeatSpec as SeatSpec
from wcsim.types.episode import Snapshot as Snapshot
from wcsim.types.episode import StartSpec as StartSpec
from wcsim.types.episode import Truth as Truth
from wcsim.types.episode import UserView as UserView
from wcsim.types.episode import Verdict as Verdict
from wcsim.types.street import ClassId as ClassId
from wcsim.types.street import Ground as Ground
from wcsim.types.street import GroundPaint as GroundPaint
from wcsim.types.street import Mark as Mark
from wcsim.types.street import OneTile as OneTile
from wcsim.types.street import Relief as Relief
from wcsim.types.street import Route as Route
from wcsim.types.street import SignalHead as SignalHead
from wcsim.types.street import Street as Street
from wcsim.types.street import StreetGrid as StreetGrid
from wcsim.types.street import StreetMesh as StreetMesh
from wcsim.types.street import TileKey as TileKey
from wcsim.types.street import WalkEdge as WalkEdge
from wcsim.types.street import WalkGraph as WalkGraph
from wcsim.types.street import WayKind as WayKind
