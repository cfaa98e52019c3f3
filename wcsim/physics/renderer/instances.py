"""The moving things of one moment as rows of numbers: model, place, size and colours."""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cache

import numpy as np

from wcsim.physics.renderer.kernels import InstanceArrays, U32Array, place_models, put_round
from wcsim.physics.renderer.models.catalog import (
    GAIT_PHASES,
    POSTURES,
    STANDING,
    Template,
    template_of,
)
from wcsim.types import F64, I32, ActorKind, ActorLook, ActorState, Outline, PlantState

_STRIDE = 0.8  # length of two steps against a walker's height
_WALKING_MPS = 0.2  # slower than this, a pedestrian stands
_GAIT_HEADINGS = 16
_CHILD_BELOW_M = 1.45


@dataclass(frozen=True, slots=True, kw_only=True)
class Instances:
    """n placed models: turned by roll, pitch (nose up), yaw, with the foot's middle at p_W_m."""

    template: I32  # (n,) Template, for pedestrians plus figure and posture
    p_W_m: F64  # (n, 3)
    yaw_rad: F64  # (n,)
    pitch_rad: F64  # (n,) nose up positive
    roll_rad: F64  # (n,) left side up positive
    scale_m: F64  # (n, 3) length, width, height
    colour_seed: U32Array  # (n,)
    lamps: I32  # (n,) SUMO's vehicle signals, for brake lights and turn lamps
    # Made here, for all pictures of them.
    placed: InstanceArrays = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        T_WM, balls = np.empty((len(self), 3, 4)), np.empty((len(self), 4), np.float32)
        place_models(self.p_W_m, self.yaw_rad, self.pitch_rad, self.roll_rad, self.scale_m, T_WM)
        put_round(T_WM, balls)
        placed = InstanceArrays(self.template, T_WM, balls, self.colour_seed, self.lamps)
        object.__setattr__(self, "placed", placed)

    def __len__(self) -> int:
        return len(self.template)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChairPose:
    """Where the wheelchair of a seat stands."""

    seat: int
    p_WB_m: F64  # (3,) below the middle of the drive axle
    q_WB: F64  # (4,) x, y, z, w
    outline: Outline


def chair_pose(seat: int, plant: PlantState, outline: Outline) -> ChairPose:
    """The pose of a seat's wheelchair for the cameras."""
    return ChairPose(seat=seat, p_WB_m=plant.p_WB_m, q_WB=plant.q_WB, outline=outline)


@cache
def _usual_templates() -> dict[ActorKind, int]:
    return {kind: int(template_of(kind)) for kind in ActorKind}


def actor_instances(actors: Sequence[ActorState]) -> Instances:
    """Models for the actors; the id gives a car its paint, and all parts of a tram the same."""
    # 1. A checksum for the colours, and not `hash`, which differs from process to process.
    seed = np.array([zlib.crc32(a.whole_id.encode()) for a in actors], np.uint32)
    p_W_m = _rows([actor.p_W_m for actor in actors])
    v_W_mps = _rows([actor.v_W_mps for actor in actors])
    yaw_rad = np.array([actor.yaw_rad for actor in actors], np.float64)
    scale_m = np.array([actor.size_lwh_m for actor in actors], np.float64).reshape(-1, 3)

    # 2. The models, those of pedestrians in the postures of their steps.
    usual = _usual_templates()
    models = [
        usual[a.kind] if a.look is ActorLook.USUAL else template_of(a.kind, a.look) for a in actors
    ]
    template = np.array(models, np.int32)
    walks = template == Template.PEDESTRIAN
    speed_mps = np.hypot(v_W_mps[walks, 0], v_W_mps[walks, 1])
    tall_m, own = scale_m[walks, 2], seed[walks]
    template[walks] += _gait_phases(p_W_m[walks], yaw_rad[walks], speed_mps, own, _STRIDE * tall_m)
    template[walks] += POSTURES * _figures(tall_m, own)
    return Instances(
        template=template,
        p_W_m=p_W_m,
        yaw_rad=yaw_rad,
        pitch_rad=np.array([actor.pitch_rad for actor in actors], np.float64),
        roll_rad=np.zeros(len(actors)),
        scale_m=scale_m,
        colour_seed=seed,
        lamps=np.array([actor.signals for actor in actors], np.int64).astype(np.int32),
    )


def chair_instances(chairs: Sequence[ChairPose]) -> Instances:
    """Models for the wheelchairs of other seats."""
    turns = [rotation_of(chair.q_WB) for chair in chairs]
    places = [
        chair.p_WB_m + chair.outline.middle_x_m * R_WB[:, 0]
        for chair, R_WB in zip(chairs, turns, strict=True)
    ]
    sizes_m = [chair.outline.size_lwh_m for chair in chairs]
    return Instances(
        template=np.full(len(chairs), Template.WHEELCHAIR, np.int32),
        p_W_m=np.array(places, np.float64).reshape(-1, 3),
        yaw_rad=np.array([math.atan2(R[1, 0], R[0, 0]) for R in turns], np.float64),
        # Rounding may leave a sine a hair beyond 1.
        pitch_rad=np.array([math.asin(min(1.0, max(-1.0, R[2, 0]))) for R in turns], np.float64),
        roll_rad=np.array([math.atan2(R[2, 1], R[2, 2]) for R in turns], np.float64),
        scale_m=np.array(sizes_m, np.float64).reshape(-1, 3),
        colour_seed=np.array([zlib.crc32(b"chair %d" % chair.seat) for chair in chairs], np.uint32),
        lamps=np.zeros(len(chairs), np.int32),
    )


def joined(*parts: Instances) -> Instances:
    """The rows of all parts, at least one, one part after another."""
    some = [part for part in parts if len(part)]
    # The models of one part alone are placed already.
    if len(some) < 2:
        return (*some, *parts)[0]
    columns = [column.name for column in fields(Instances) if column.init]
    return Instances(
        **{name: np.concatenate([getattr(part, name) for part in some]) for name in columns}
    )


def rotation_of(q: F64) -> F64:
    """Rotation matrix (3, 3) of a quaternion (4,) x, y, z, w of any length but zero."""
    x, y, z, w = (np.asarray(q, np.float64) / math.sqrt(np.dot(q, q))).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _gait_phases(p_W_m: F64, yaw_rad: F64, speed_mps: F64, seed: U32Array, stride_m: F64) -> I32:
    """Phase (n,) in 0..3 of each walker's step, 4 for one that stands.

    It follows from the place (n, 3) alone, so that one snapshot always gives one picture. The
    distance walked is read off along the nearest of 16 headings: a walker that turns a little does
    not skip phases. The seed lets people out of step.
    """
    sector = np.rint(yaw_rad * (_GAIT_HEADINGS / (2 * np.pi))) % _GAIT_HEADINGS
    heading = sector * (2 * np.pi / _GAIT_HEADINGS)
    walked_m = p_W_m[:, 0] * np.cos(heading) + p_W_m[:, 1] * np.sin(heading)
    steps = np.floor((walked_m / stride_m + (seed & 255) / 256.0) * GAIT_PHASES)
    return np.where(speed_mps < _WALKING_MPS, STANDING, steps % GAIT_PHASES).astype(np.int32)


def _figures(height_m: F64, seed: U32Array) -> I32:
    """Which figure (n,) of `catalog.FIGURES` each person is: a child, or one of two grown-ups."""
    return np.where(height_m < _CHILD_BELOW_M, 2, (seed >> 13) & 1).astype(np.int32)


def _rows(vectors: Sequence[F64]) -> F64:
    """Vectors (3,) as the rows of one array (n, 3)."""
    # An empty array more, as concatenate refuses an empty list.
    return np.concatenate([*vectors, np.zeros(0)]).reshape(-1, 3)
