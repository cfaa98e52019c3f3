"""The models of all actors as one table of triangles, each scaled to a unit box that an actor's size stretches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache, partial

import numpy as np

from wcsim.physics.renderer.models import people, vehicles
from wcsim.physics.renderer.models.paint import Paint
from wcsim.physics.renderer.models.people import CHILD, GROWN, LONG_HAIRED, POSTURES, STANDING, walker
from wcsim.physics.renderer.models.primitives import BodyPart
from wcsim.types import F32, F64, I32, U8, ActorKind, ActorLook, ClassId

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


@dataclass(frozen=True, slots=True, kw_only=True)
class ActorTemplates:
    """Triangles of all models; template t owns faces `faces_of[t]:faces_of[t + 1]`, likewise its vertices.

    A model fills x, y in [-0.5, 0.5] and z in [0, 1], x forward, so that scaling by `size_lwh_m` gives the actor's box;
    the hands and feet of a walking pedestrian reach out of it to front and rear.
    """

    vertices: F32  # (V, 3)
    faces: I32  # (T, 3) indices from the template's first vertex on, counter-clockwise seen from outside
    face_class: U8  # (T,) ClassId
    face_paint: U8  # (T,) Paint
    vertices_of: I32  # (n + 1,)
    faces_of: I32  # (n + 1,)

    @property
    def count(self) -> int:
        """Number of templates."""
        return len(self.faces_of) - 1


def template_of(kind: ActorKind, look: ActorLook = ActorLook.USUAL) -> Template:
    """The model of a kind and look; a pedestrian's first one."""
    return LOOKS.get((kind, look), Template[kind.name])


@cache
def actor_templates() -> ActorTemplates:
    """The table; it takes some tens of milliseconds to build, so it is built once a process and never changes."""
    makers = _makers()
    models = [(model, _bounds(model)) for model in (makers[template]() for template in list(Template)[:-1])]
    for build in FIGURES:
        postures = [walker(posture, build) for posture in range(POSTURES)]
        box = _bounds(postures[STANDING])  # a stride reaches beyond it: SUMO's length of a person is that of the trunk
        models += [(model, box) for model in postures]
    return _table(models)


def _makers() -> dict[Template, Callable[[], list[BodyPart]]]:
    red_amber_green = (Paint.RED_LIGHT, Paint.AMBER_LIGHT, Paint.GREEN_LIGHT)
    red_green = (Paint.RED_LIGHT, Paint.GREEN_LIGHT)
    return {
        Template.CAR: vehicles.car,
        Template.TRUCK: vehicles.truck,
        Template.BUS: vehicles.bus,
        Template.TRAM: vehicles.tram,
        Template.MOTORCYCLE: people.motorcycle,
        Template.BICYCLE: people.bicycle,
        Template.SCOOTER: people.scooter,
        Template.WHEELCHAIR: people.wheelchair,
        Template.OTHER: vehicles.other,
        Template.VAN: partial(vehicles.van, ClassId.CAR),
        Template.TAXI: vehicles.taxi,
        Template.POLICE: vehicles.police,
        Template.AMBULANCE: vehicles.ambulance,
        Template.DELIVERY: partial(vehicles.van, ClassId.TRUCK),
        Template.COACH: vehicles.coach,
        Template.MOPED: people.moped,
        Template.TRACTOR: vehicles.tractor,
        Template.TRAILER: vehicles.trailer,
        Template.BUS_FRONT: vehicles.bus_front,
        Template.BUS_REAR: vehicles.bus_rear,
        Template.TRAM_FRONT: vehicles.tram_front,
        Template.TRAM_MIDDLE: vehicles.tram_middle,
        Template.TRAM_REAR: vehicles.tram_rear,
        Template.SIGNAL_OFF: partial(vehicles.signal_lamps, (False, False, False), red_amber_green),
        Template.SIGNAL_RED: partial(vehicles.signal_lamps, (True, False, False), red_amber_green),
        Template.SIGNAL_RED_AMBER: partial(vehicles.signal_lamps, (True, True, False), red_amber_green),
        Template.SIGNAL_AMBER: partial(vehicles.signal_lamps, (False, True, False), red_amber_green),
        Template.SIGNAL_GREEN: partial(vehicles.signal_lamps, (False, False, True), red_amber_green),
        Template.WALK_OFF: partial(vehicles.signal_lamps, (False, False), red_green),
        Template.WALK_RED: partial(vehicles.signal_lamps, (True, False), red_green),
        Template.WALK_GREEN: partial(vehicles.signal_lamps, (False, True), red_green),
    }


def _bounds(pieces: Sequence[BodyPart]) -> tuple[F64, F64]:
    points = np.concatenate([piece.part.vertices_m for piece in pieces])
    return points.min(axis=0), points.max(axis=0)


def _table(models: Sequence[tuple[Sequence[BodyPart], tuple[F64, F64]]]) -> ActorTemplates:
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
    table = ActorTemplates(
        vertices=np.concatenate(vertices).astype(np.float32),
        faces=np.concatenate(faces).astype(np.int32),
        face_class=np.concatenate(classes).astype(np.uint8),
        face_paint=np.concatenate(paints).astype(np.uint8),
        vertices_of=np.array(vertices_of, np.int32),
        faces_of=np.array(faces_of, np.int32),
    )
    # All renderers of the process share it, some of them in threads.
    for array in (table.vertices, table.faces, table.face_class, table.face_paint, table.vertices_of, table.faces_of):
        array.setflags(write=False)
    return table


def _paints(piece: BodyPart) -> U8:
    """Paint of every face of a piece (T,)."""
    a, b, c = (piece.part.vertices_m[piece.part.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    # The cosine times the length, not divided by it: a face without area has no top.
    upward = normal @ piece.top_along > piece.top_from * np.linalg.norm(normal, axis=1)
    top = piece.paint if piece.top is None else piece.top
    return np.where(upward, top, piece.paint).astype(np.uint8)
