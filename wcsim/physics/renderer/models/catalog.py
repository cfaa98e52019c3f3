"""The models of all actors as one table of triangles, in unit boxes that an actor's size stretches.

Models are lists of convex primitives in metres, with class and paint. Every primitive is closed and
its faces are counter-clockwise seen from outside: the rasteriser may skip back faces.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from wcsim.core.reading import read_module_toml
from wcsim.physics.renderer.kernels import ModelArrays
from wcsim.physics.renderer.models.paint import Paint, paint_table
from wcsim.types import F64, I64, ActorKind, ActorLook, ClassId

_Point = tuple[float, float, float]
LAMP_RADIUS_M = 0.1  # of a traffic light
LAMP_APART_M = 0.26
LAMP_DEPTH_M = 0.05
# Plates and panes are so far above the body: enough for the depth buffer in a camera's range.
_SKIN_M = 0.01
_TORSO_M = 0.56  # hip to shoulders
_HEAD_M = 0.19  # shoulders to the middle of the head
_HAIR_ALONG = (-0.6, 0.0, 0.8)
# A child of seven is six and a half heads high, a grown-up seven and a half; it is narrow besides.
_CHILD_HEAD = 1.4
GAIT_PHASES = 4  # left foot ahead, right swings, right foot ahead, left swings
STANDING = GAIT_PHASES  # the number of the posture of one that does not walk
POSTURES = GAIT_PHASES + 1


@dataclass(frozen=True, slots=True)
class _Part:
    """One closed convex piece (or a flat decal) of a model."""

    vertices_m: F64  # (V, 3)
    faces: I64  # (T, 3) indices into vertices_m, counter-clockwise seen from outside


@dataclass(frozen=True, slots=True)
class _BodyPart:
    """A part of a model with class and paint; faces towards `top_along` take the paint `top`."""

    part: _Part
    class_id: ClassId
    paint: Paint
    top: Paint | None = None
    top_along: _Point = (0.0, 0.0, 1.0)  # unit vector
    top_from: float = 0.9  # least cosine between a face's normal and it


@dataclass(frozen=True, slots=True, kw_only=True)
class _Posture:
    """Where the joints of a figure are, metres; left first, feet point along x."""

    hip: _Point  # middle of the pelvis
    lean_m: float  # how far the shoulders are ahead of the hip
    hands: tuple[_Point, _Point]
    knees: tuple[_Point, _Point]
    ankles: tuple[_Point, _Point]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Build:
    """What differs from figure to figure."""

    head: float = 1.0  # size of the head against a grown-up's
    long_hair: bool = False
    helmet: bool = False


_GROWN, _HELMETED = _Build(), _Build(helmet=True)
FIGURES = (_GROWN, _Build(long_hair=True), _Build(head=_CHILD_HEAD))  # of pedestrians


class Template(IntEnum):
    """Row of each model in the table; the postures of pedestrians are at the end."""

    CAR = 0
    TRUCK = 1
    BUS = 2
    TRAM = 3
    MOTORCYCLE = 4
    BICYCLE = 5
    SCOOTER = 6
    WHEELCHAIR = 7
    OTHER = 8
    VAN = 9
    TAXI = 10
    POLICE = 11
    AMBULANCE = 12
    DELIVERY = 13
    COACH = 14
    MOPED = 15
    TRACTOR = 16
    TRAILER = 17
    BUS_FRONT = 18
    BUS_REAR = 19
    TRAM_FRONT = 20
    TRAM_MIDDLE = 21
    TRAM_REAR = 22
    SIGNAL_OFF = 23
    SIGNAL_RED = 24
    SIGNAL_RED_AMBER = 25
    SIGNAL_AMBER = 26
    SIGNAL_GREEN = 27
    WALK_OFF = 28
    WALK_RED = 29
    WALK_GREEN = 30
    PEDESTRIAN = 31  # figure f in posture k is 31 + POSTURES * f + k


def template_of(kind: ActorKind, look: ActorLook = ActorLook.USUAL) -> Template:
    """The model of a kind and look (`looks` of `shapes.toml`); a pedestrian's first one."""
    return Template[_shapes()["looks"].get(kind.name, {}).get(look.name, kind.name)]


@cache
def actor_templates() -> ModelArrays:
    """The table; building it takes some tens of milliseconds, so each process does it once."""
    # 1. The models and their boxes. A stride reaches out of its box: SUMO's length of a person is
    # that of the trunk.
    bodies = [_body_parts(template.name) for template in list(Template)[:-1]]
    models = [(model, _bounds(model)) for model in bodies]
    for build in FIGURES:
        postures = [_figure(ClassId.PERSON, build, _Posture(**row)) for row in _shapes()["gait"]]
        box = _bounds(postures[STANDING])
        models += [(model, box) for model in postures]

    # 2. Their triangles. The cosine of a face's top is not divided by the length: a face without
    # area has no top.
    vertices, faces, classes, paints = [], [], [], []
    vertices_of, faces_of = [0], [0]
    for pieces, (low, high) in models:
        start = 0
        for piece in pieces:
            corners, index = piece.part.vertices_m, piece.part.faces
            a, b, c = (corners[index[:, k]] for k in range(3))
            normal = np.cross(b - a, c - a)
            upward = normal @ piece.top_along > piece.top_from * np.linalg.norm(normal, axis=1)
            top = piece.paint if piece.top is None else piece.top
            vertices.append((corners - low) / (high - low) - [0.5, 0.5, 0.0])
            faces.append(index + start)
            classes.append(np.full(len(index), piece.class_id))
            paints.append(np.where(upward, top, piece.paint))
            start += len(corners)
        vertices_of.append(sum(map(len, vertices)))
        faces_of.append(sum(map(len, faces)))
    table = ModelArrays(
        vertices=np.concatenate(vertices).astype(np.float32),
        faces=np.concatenate(faces).astype(np.int32),
        face_class=np.concatenate(classes).astype(np.uint8),
        face_paint=np.concatenate(paints).astype(np.uint8),
        vertices_of=np.array(vertices_of, np.int32),
        faces_of=np.array(faces_of, np.int32),
        paints=paint_table(),
    )
    # All renderers of the process share it, some of them in threads.
    for array in table:
        array.setflags(write=False)
    return table


@cache
def _shapes() -> dict[str, Any]:
    return read_module_toml(Path(__file__).with_name("shapes"))


def _body_parts(model: str, class_name: str = "", body: str = "BODY") -> list[_BodyPart]:
    """The parts of a model of `shapes.toml`, of another class, and with another paint for BODY."""
    class_name = class_name or _shapes()[model]["class"]
    found = []
    for row in _shapes()[model]["parts"]:
        part = dict(row)
        if "like" in part:
            found += _body_parts(part["like"], class_name, part["body"])
        elif "person" in part:
            build = _HELMETED if part.pop("helmet", False) else _GROWN
            found += _figure(ClassId[part.pop("person")], build, _Posture(**part))
        else:
            name, shape = part.pop("paint"), part.pop("shape")
            names = name, part.pop("top", name)
            paint, top = (Paint[body if each == "BODY" else each] for each in names)
            # Once for each of the numbers that its `x` and its `y` list.
            lists = {axis: part[axis] for axis in "xy" if isinstance(part.get(axis), list)}
            for place in product(*lists.values()):
                solid = _SHAPES[shape](**part | dict(zip(lists, place, strict=True)))
                found.append(_BodyPart(solid, ClassId[class_name], paint, top))
    return found


def _figure(class_id: ClassId, build: _Build, posture: _Posture) -> list[_BodyPart]:
    """A person of about 1.75 m in a posture, 196 triangles, 216 with long hair; a rider 172."""
    # 1. Torso and head.
    hip_x, _, hip_z = posture.hip
    shoulder_x, shoulder_z = hip_x + posture.lean_m, hip_z + _TORSO_M
    torso = _barrel(hip_z - 0.06, shoulder_z, (0.1, 0.135), (0.09, 0.18), hip_x, posture.lean_m, 6)
    k = build.head
    face = (shoulder_x + 0.02, 0.0, shoulder_z + _HEAD_M + 0.135 * (k - 1.0))
    head = _ball(face, (0.105 * k, 0.085 * k, 0.135 * k))
    chin = (shoulder_x + 0.01, 0.0, shoulder_z + _HEAD_M - 0.06)
    neck = _limb((shoulder_x, 0.0, shoulder_z - 0.01), chin, 0.07, 0.05, sides=4)
    cap = Paint.BODY if build.helmet else Paint.HAIR
    pieces = [
        _BodyPart(torso, class_id, Paint.SHIRT),
        _BodyPart(neck, class_id, Paint.SKIN),
        _BodyPart(head, class_id, Paint.SKIN, top=cap, top_along=_HAIR_ALONG, top_from=0.1),
    ]
    if build.long_hair:
        behind = (shoulder_x - 0.06, 0.0, shoulder_z + _HEAD_M - 0.05)
        hair = _ball(behind, (0.08, 0.105, 0.2), around=5, rings=2)
        pieces.append(_BodyPart(hair, class_id, Paint.HAIR))

    # 2. Arms and legs. The hands of a rider are at the handlebar.
    sides = zip((1.0, -1.0), posture.hands, posture.knees, posture.ankles, strict=True)
    for side, hand, knee, ankle in sides:
        shoulder = (shoulder_x, 0.2 * side, shoulder_z - 0.06)
        limbs = [(_limb(shoulder, hand, 0.06, 0.036, sides=4), Paint.SHIRT)]
        if class_id is ClassId.PERSON:
            x, y, z = hand
            palm = _box((x - 0.04, y - 0.025, z - 0.08), (x + 0.04, y + 0.025, z + 0.02))
            limbs.append((palm, Paint.SKIN))
        x, y, z = ankle
        limbs += [
            (_limb((hip_x, 0.09 * side, hip_z), knee, 0.085, 0.062), Paint.TROUSERS),
            (_limb(knee, ankle, 0.066, 0.048, sides=4), Paint.TROUSERS),
            (_box((x - 0.07, y - 0.045, z - 0.07), (x + 0.15, y + 0.045, z)), Paint.SHOE),
        ]
        pieces += [_BodyPart(limb, class_id, paint) for limb, paint in limbs]
    return pieces


def _bounds(pieces: Sequence[_BodyPart]) -> tuple[F64, F64]:
    points = np.concatenate([piece.part.vertices_m for piece in pieces])
    return points.min(axis=0), points.max(axis=0)


def _box(low: _Point, high: _Point) -> _Part:
    """A box between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return _between_rings([(x, y, z0) for x, y in ring], [(x, y, z1) for x, y in ring])


def _prism(
    profile_xz: Sequence[tuple[float, float]], half_width: float, taper: float = 1.0
) -> _Part:
    """A convex profile (x, z), pushed out along y to +-half_width; `taper` narrows its top."""
    heights = [z for _, z in profile_xz]
    low, high = min(heights), max(heights)
    left = [
        (x, half_width * (1.0 + (taper - 1.0) * (z - low) / (high - low)), z) for x, z in profile_xz
    ]
    return _between_rings([(x, -y, z) for x, y, z in left], left)


def _wheel(x: float, y: float, radius: float, width: float, sides: int) -> _Part:
    """A wheel that stands on the ground at (x, y), axle along y."""
    turn = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    # The polygon's flat sides, not its corners, stand on the ground.
    grow = 1.0 / np.cos(np.pi / sides)
    ring = [(x + grow * radius * np.cos(a), radius * (1.0 + grow * np.sin(a))) for a in turn]
    edges = (y - 0.5 * width, y + 0.5 * width)
    return _between_rings(*([(px, edge, max(pz, 0.0)) for px, pz in ring] for edge in edges))


def _limb(
    start: _Point, end: _Point, start_radius: float, end_radius: float, sides: int = 5
) -> _Part:
    """A tapered rod between two points: arms, legs, tubes of a frame."""
    a, b = np.array(start), np.array(end)
    axis = (b - a) / np.linalg.norm(b - a)
    # Any direction across will do but one along the axis, whose cross product is 0.
    side = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    turns = 2.0 * np.pi * np.arange(sides) / sides
    around = np.outer(np.cos(turns), side) + np.outer(np.sin(turns), other)
    return _between_rings(a + start_radius * around, b + end_radius * around)


def _rod(start: _Point, end: _Point, radius: float = 0.022) -> _Part:
    """A tube."""
    return _limb(start, end, radius, radius, sides=4)


def _barrel(
    low_z: float,
    high_z: float,
    low: tuple[float, float],
    high: tuple[float, float],
    x: float,
    lean: float,
    sides: int,
) -> _Part:
    """A trunk between half axes (x, y) of its ends, of which `lean` shifts the upper one in x."""
    turns = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    ring = np.c_[np.cos(turns), np.sin(turns)] / np.cos(np.pi / sides)
    lower = np.c_[x + low[0] * ring[:, 0], low[1] * ring[:, 1], np.full(sides, low_z)]
    upper = np.c_[x + lean + high[0] * ring[:, 0], high[1] * ring[:, 1], np.full(sides, high_z)]
    return _between_rings(lower, upper)


def _ball(centre: _Point, half_axes: _Point, around: int = 6, rings: int = 3) -> _Part:
    """An ellipsoid of `rings` rings between two poles."""
    turns = 2.0 * np.pi * np.arange(around) / around
    tilts = np.pi * (np.arange(rings) + 1) / (rings + 1)
    unit = [(np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)) for t in tilts for a in turns]
    unit += [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
    top, bottom = around * rings, around * rings + 1
    faces = []
    for i in range(around):
        j = (i + 1) % around
        faces += [(top, i, j), (bottom, around * (rings - 1) + j, around * (rings - 1) + i)]
        for ring in range(rings - 1):
            p, q = around * ring, around * (ring + 1)
            faces += [(p + i, q + i, q + j), (p + i, q + j, p + j)]
    return _outward(np.array(unit) * half_axes + np.array(centre), faces)


def _decal(corners: Sequence[_Point]) -> _Part:
    """A flat rectangle on the skin of a model, four corners counter-clockwise seen from outside."""
    return _Part(np.array(corners, np.float64), np.array([(0, 1, 2), (0, 2, 3)], np.int64))


def _plate(
    x: float, y: float, z: float, half_width: float, half_height: float, facing: int
) -> _Part:
    """A rectangle across x that faces forward (1) or backward (-1)."""
    x += _SKIN_M * facing
    near, far = y - half_width * facing, y + half_width * facing
    low, high = z - half_height, z + half_height
    return _decal([(x, near, low), (x, far, low), (x, far, high), (x, near, high)])


def _pane(x0: float, x1: float, y: float, low: float, high: float) -> _Part:
    """A rectangle along x on the left (y > 0) or right side of a body."""
    y += math.copysign(_SKIN_M, y)
    start, end = (x1, x0) if y > 0 else (x0, x1)
    return _decal([(start, y, low), (end, y, low), (end, y, high), (start, y, high)])


def _lamp(z: float) -> _Part:
    """A lamp of a traffic light, its middle at a height; it shines along x."""
    return _limb((0.0, 0.0, z), (LAMP_DEPTH_M, 0.0, z), LAMP_RADIUS_M, LAMP_RADIUS_M, sides=8)


def _between_rings(first: Any, second: Any) -> _Part:
    """The hull between two convex rings of as many corners."""
    n = len(first)
    faces = []
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j, n + j), (i, n + j, n + i)]
    for i in range(1, n - 1):
        faces += [(0, i, i + 1), (n, n + i, n + i + 1)]
    return _outward(
        np.concatenate([np.asarray(first, np.float64), np.asarray(second, np.float64)]), faces
    )


def _outward(vertices: F64, faces: Sequence[tuple[int, int, int]]) -> _Part:
    """Turn every face of a convex piece so that its normal points away from the middle."""
    index = np.array(faces, np.int64)
    a, b, c = (vertices[index[:, k]] for k in range(3))
    # Each face of a convex piece looks away from the middle, so corners may have any order.
    outward = (a + b + c) / 3.0 - vertices.mean(axis=0)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), outward) < 0.0
    index[inward] = index[inward][:, [0, 2, 1]]
    return _Part(vertices, index)


_SHAPES: dict[str, Callable[..., _Part]] = {
    make.__name__.removeprefix("_"): make
    for make in (_box, _prism, _wheel, _rod, _decal, _plate, _pane, _lamp)
}
