"""The models of all actors as one table of triangles, each scaled to a unit box that an actor's size stretches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from wcsim.physics.renderer import vehicles
from wcsim.physics.renderer.models import Piece, walker
from wcsim.types import F32, F64, I32, U8, ActorKind

GAIT_PHASES = 4


class Template(IntEnum):
    """Row of each model in the table; the four phases of a pedestrian's step follow one another."""

    CAR = 0
    TRUCK = 1
    BUS = 2
    TRAM = 3
    MOTORCYCLE = 4
    BICYCLE = 5
    SCOOTER = 6
    WHEELCHAIR = 7
    OTHER = 8
    PEDESTRIAN = 9  # to 12


@dataclass(frozen=True, slots=True, kw_only=True)
class ActorTemplates:
    """Triangles of all models; template t owns faces `faces_of[t]:faces_of[t + 1]`, likewise its vertices.

    A model fills x, y in [-0.5, 0.5] and z in [0, 1], x forward, so that scaling by `size_lwh_m` gives the actor's box.
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


def template_of(kind: ActorKind) -> Template:
    """The model of a kind; a pedestrian's first phase."""
    return Template[kind.name]


def actor_templates() -> ActorTemplates:
    """Build the table; takes a few milliseconds."""
    singles = [
        vehicles.car(), vehicles.truck(), vehicles.bus(), vehicles.tram(), vehicles.motorcycle(), vehicles.bicycle(),
        vehicles.scooter(), vehicles.wheelchair(), vehicles.other(),
    ]  # fmt: skip
    walkers = [walker(phase) for phase in range(GAIT_PHASES)]
    stride_box = _bounds([piece for model in walkers for piece in model])  # one box, or the body would pump in length
    models = [(model, _bounds(model)) for model in singles] + [(model, stride_box) for model in walkers]
    return _table(models)


def _bounds(pieces: Sequence[Piece]) -> tuple[F64, F64]:
    points = np.concatenate([piece.part.vertices_m for piece in pieces])
    return points.min(axis=0), points.max(axis=0)


def _table(models: Sequence[tuple[Sequence[Piece], tuple[F64, F64]]]) -> ActorTemplates:
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
    return ActorTemplates(
        vertices=np.concatenate(vertices).astype(np.float32),
        faces=np.concatenate(faces).astype(np.int32),
        face_class=np.concatenate(classes).astype(np.uint8),
        face_paint=np.concatenate(paints).astype(np.uint8),
        vertices_of=np.array(vertices_of, np.int32),
        faces_of=np.array(faces_of, np.int32),
    )


def _paints(piece: Piece) -> U8:
    """Paint of every face of a piece (T,)."""
    a, b, c = (piece.part.vertices_m[piece.part.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    upward = normal @ piece.top_along > piece.top_from * np.linalg.norm(normal, axis=1)
    top = piece.paint if piece.top is None else piece.top
    return np.where(upward, top, piece.paint).astype(np.uint8)
