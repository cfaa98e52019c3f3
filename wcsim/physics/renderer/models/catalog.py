"""The models of all actors as one table of triangles, each scaled to a unit box that an actor's size stretches."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from enum import IntEnum
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from wcsim.physics.renderer.kernels import ModelArrays
from wcsim.physics.renderer.models import primitives
from wcsim.physics.renderer.models.paint import Paint, paint_table
from wcsim.physics.renderer.models.people import CHILD, GROWN, HELMETED, LONG_HAIRED, STANDING, Posture, figure
from wcsim.physics.renderer.models.primitives import BodyPart, Part
from wcsim.types import F64, U8, ActorKind, ActorLook, ClassId

FIGURES = (GROWN, LONG_HAIRED, CHILD)  # the builds of those on foot


class Template(IntEnum):
    """Row of each model in the table; the postures of each figure of a pedestrian follow one another at the end."""

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


LOOKS = {
    (ActorKind.CAR, ActorLook.VAN): Template.VAN,
    (ActorKind.CAR, ActorLook.TAXI): Template.TAXI,
    (ActorKind.CAR, ActorLook.POLICE): Template.POLICE,
    (ActorKind.TRUCK, ActorLook.AMBULANCE): Template.AMBULANCE,
    (ActorKind.TRUCK, ActorLook.VAN): Template.DELIVERY,
    (ActorKind.TRUCK, ActorLook.FRONT): Template.TRACTOR,
    (ActorKind.TRUCK, ActorLook.MIDDLE): Template.TRAILER,
    (ActorKind.TRUCK, ActorLook.REAR): Template.TRAILER,
    (ActorKind.BUS, ActorLook.COACH): Template.COACH,
    (ActorKind.BUS, ActorLook.FRONT): Template.BUS_FRONT,
    (ActorKind.BUS, ActorLook.MIDDLE): Template.BUS_REAR,
    (ActorKind.BUS, ActorLook.REAR): Template.BUS_REAR,
    (ActorKind.TRAM, ActorLook.FRONT): Template.TRAM_FRONT,
    (ActorKind.TRAM, ActorLook.MIDDLE): Template.TRAM_MIDDLE,
    (ActorKind.TRAM, ActorLook.REAR): Template.TRAM_REAR,
    (ActorKind.MOTORCYCLE, ActorLook.MOPED): Template.MOPED,
}
"""Models of looks; what is not listed looks as usual for its kind."""


def template_of(kind: ActorKind, look: ActorLook = ActorLook.USUAL) -> Template:
    """The model of a kind and look; a pedestrian's first one."""
    return LOOKS.get((kind, look), Template[kind.name])


@cache
def actor_templates() -> ModelArrays:
    """The table; it takes some tens of milliseconds to build, so it is built once a process and never changes."""
    models = [(model, _bounds(model)) for model in (body_parts(template.name) for template in list(Template)[:-1])]
    for build in FIGURES:
        postures = [figure(ClassId.PERSON, build, Posture(**row)) for row in _shapes()["gait"]]
        box = _bounds(postures[STANDING])  # a stride reaches beyond it: SUMO's length of a person is that of the trunk
        models += [(model, box) for model in postures]
    return _table(models)


@cache
def _shapes() -> dict[str, Any]:
    return tomllib.loads((Path(__file__).parent / "shapes.toml").read_text(encoding="utf-8"))


def body_parts(model: str, class_name: str = "", body: str = "BODY") -> list[BodyPart]:
    """The parts of a model of `shapes.toml`, if wanted of another class, and with another paint for its BODY."""
    class_name = class_name or _shapes()[model]["class"]
    found = []
    for row in _shapes()[model]["parts"]:
        part = dict(row)
        if "like" in part:
            found += body_parts(part["like"], class_name, part["body"])
        elif "person" in part:
            build = HELMETED if part.pop("helmet", False) else GROWN
            found += figure(ClassId[part.pop("person")], build, Posture(**part))
        else:
            name = part.pop("paint")
            paint, top = (Paint[body if one == "BODY" else one] for one in (name, part.pop("top", name)))
            found += [BodyPart(solid, ClassId[class_name], paint, top) for solid in _solids(**part)]
    return found


def _solids(shape: str, **numbers: Any) -> Iterator[Part]:
    """A shape once for each of the numbers that its `x` and its `y` list."""
    lists = {name: numbers[name] for name in ("x", "y") if isinstance(numbers.get(name), list)}
    for place in product(*lists.values()):
        yield getattr(primitives, shape)(**numbers | dict(zip(lists, place, strict=True)))


def _bounds(pieces: Sequence[BodyPart]) -> tuple[F64, F64]:
    points = np.concatenate([piece.part.vertices_m for piece in pieces])
    return points.min(axis=0), points.max(axis=0)


def _table(models: Sequence[tuple[Sequence[BodyPart], tuple[F64, F64]]]) -> ModelArrays:
    vertices, faces, classes, paints = [], [], [], []
    vertices_of, faces_of = [0], [0]
    for pieces, (low, high) in models:
        start = 0
        for piece in pieces:
            unit = (piece.part.vertices_m - low) / (high - low) - [0.5, 0.5, 0.0]
            vertices.append(unit)
            faces.append(piece.part.faces + start)
            classes.append(np.full(len(piece.part.faces), piece.class_id))
            paints.append(_paints(piece))
            start += len(unit)
        vertices_of.append(vertices_of[-1] + start)
        faces_of.append(faces_of[-1] + sum(len(piece.part.faces) for piece in pieces))
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


def _paints(piece: BodyPart) -> U8:
    """Paint of every face of a piece (T,)."""
    a, b, c = (piece.part.vertices_m[piece.part.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    # The cosine times the length, not divided by it: a face without area has no top.
    upward = normal @ piece.top_along > piece.top_from * np.linalg.norm(normal, axis=1)
    return np.where(upward, piece.paint if piece.top is None else piece.top, piece.paint).astype(np.uint8)
