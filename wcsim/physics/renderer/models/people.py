"""The human figure that walks, rides and sits, in metres, x forward."""

from __future__ import annotations

from dataclasses import dataclass

from wcsim.physics.renderer.models.paint import Paint
from wcsim.physics.renderer.models.primitives import BodyPart, Point, ball, barrel, box, limb
from wcsim.types import ClassId


@dataclass(frozen=True, slots=True, kw_only=True)
class Posture:
    """Where the joints of a figure are, metres; left first, feet point along x."""

    hip: Point  # middle of the pelvis
    lean_m: float  # how far the shoulders are ahead of the hip
    hands: tuple[Point, Point]
    knees: tuple[Point, Point]
    ankles: tuple[Point, Point]


_TORSO_M = 0.56  # hip to shoulders
HEAD_M = 0.19  # shoulders to the middle of the head
_HAIR_ALONG = (-0.6, 0.0, 0.8)
_CHILD_HEAD = 1.4  # a child of seven is six and a half heads high, a grown-up seven and a half; it is narrow besides


@dataclass(frozen=True, slots=True, kw_only=True)
class Build:
    """What differs from figure to figure."""

    head: float = 1.0  # size of the head against a grown-up's
    long_hair: bool = False
    helmet: bool = False


GROWN, LONG_HAIRED, CHILD, HELMETED = Build(), Build(long_hair=True), Build(head=_CHILD_HEAD), Build(helmet=True)


def figure(class_id: ClassId, build: Build, posture: Posture) -> list[BodyPart]:
    """A person of about 1.75 m in a posture, 196 triangles, 216 with long hair; a rider 172."""
    hip_x, _, hip_z = posture.hip
    shoulder_x, shoulder_z = hip_x + posture.lean_m, hip_z + _TORSO_M
    torso = barrel(hip_z - 0.06, shoulder_z, (0.1, 0.135), (0.09, 0.18), hip_x, posture.lean_m, 6)
    k = build.head
    face = (shoulder_x + 0.02, 0.0, shoulder_z + HEAD_M + 0.135 * (k - 1.0))
    head = ball(face, (0.105 * k, 0.085 * k, 0.135 * k))
    chin = (shoulder_x + 0.01, 0.0, shoulder_z + HEAD_M - 0.06)
    neck = limb((shoulder_x, 0.0, shoulder_z - 0.01), chin, 0.07, 0.05, sides=4)
    cap = Paint.BODY if build.helmet else Paint.HAIR
    pieces = [
        BodyPart(torso, class_id, Paint.SHIRT),
        BodyPart(neck, class_id, Paint.SKIN),
        BodyPart(head, class_id, Paint.SKIN, top=cap, top_along=_HAIR_ALONG, top_from=0.1),
    ]
    if build.long_hair:
        hair = ball((shoulder_x - 0.06, 0.0, shoulder_z + HEAD_M - 0.05), (0.08, 0.105, 0.2), around=5, rings=2)
        pieces.append(BodyPart(hair, class_id, Paint.HAIR))
    for side, hand, knee, ankle in zip((1.0, -1.0), posture.hands, posture.knees, posture.ankles, strict=True):
        shoulder = (shoulder_x, 0.2 * side, shoulder_z - 0.06)
        pieces.append(BodyPart(limb(shoulder, hand, 0.06, 0.036, sides=4), class_id, Paint.SHIRT))
        if class_id is ClassId.PERSON:  # a rider's are at the handlebar
            x, y, z = hand
            palm = box((x - 0.04, y - 0.025, z - 0.08), (x + 0.04, y + 0.025, z + 0.02))
            pieces.append(BodyPart(palm, class_id, Paint.SKIN))
        pieces.append(BodyPart(limb((hip_x, 0.09 * side, hip_z), knee, 0.085, 0.062), class_id, Paint.TROUSERS))
        pieces.append(BodyPart(limb(knee, ankle, 0.066, 0.048, sides=4), class_id, Paint.TROUSERS))
        x, y, z = ankle
        pieces.append(BodyPart(box((x - 0.07, y - 0.045, z - 0.07), (x + 0.15, y + 0.045, z)), class_id, Paint.SHOE))
    return pieces


GAIT_PHASES = 4  # left foot ahead, right swings, right foot ahead, left swings
STANDING = GAIT_PHASES  # the number of the posture of who does not walk
POSTURES = GAIT_PHASES + 1
