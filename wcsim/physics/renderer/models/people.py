"""What the pieces of an actor's model are made of, and the human figure that walks, rides and sits in them."""

from __future__ import annotations

from dataclasses import dataclass

from wcsim.physics.renderer.models.paint import Paint
from wcsim.physics.renderer.models.primitives import Part, Point, ball, barrel, box, limb
from wcsim.types import ClassId


@dataclass(frozen=True, slots=True)
class BodyPart:
    """A part of a model with its class and paint; faces that look towards `top_along` take the paint `top`."""

    part: Part
    class_id: ClassId
    paint: Paint
    top: Paint | None = None
    top_along: Point = (0.0, 0.0, 1.0)  # unit vector
    top_from: float = 0.9  # least cosine between a face's normal and it


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


def figure(posture: Posture, class_id: ClassId, build: Build = GROWN) -> list[BodyPart]:
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


GAIT_PHASES = 4
STANDING = GAIT_PHASES  # the number of the posture of who does not walk
POSTURES = GAIT_PHASES + 1


def walker(phase: int, build: Build = GROWN) -> list[BodyPart]:
    """A pedestrian standing, or in a phase of a step: left foot ahead, right swings, right foot ahead, left swings."""
    left_ahead = phase in (0, 3)
    if phase == STANDING:
        fore = back = ((0.01, 0.46), (-0.01, 0.07))
        reach = 0.0
    elif phase % 2 == 0:
        fore = ((0.19, 0.47), (0.27, 0.08))  # knee and ankle (x, z) of the leg ahead
        back = ((-0.05, 0.46), (-0.31, 0.16))
        reach = 0.2
    else:
        fore = ((0.02, 0.46), (-0.02, 0.07))  # the standing leg
        back = ((0.14, 0.49), (-0.1, 0.2))  # the swinging one
        reach = 0.05
    left, right = (fore, back) if left_ahead else (back, fore)
    swing = -reach if left_ahead else reach  # arms swing against the legs
    posture = Posture(
        hip=(0.0, 0.0, 0.88),
        lean_m=0.02,
        hands=((0.02 + swing, 0.235, 0.80), (0.02 - swing, -0.235, 0.80)),
        knees=((left[0][0], 0.10, left[0][1]), (right[0][0], -0.10, right[0][1])),
        ankles=((left[1][0], 0.10, left[1][1]), (right[1][0], -0.10, right[1][1])),
    )
    return figure(posture, ClassId.PERSON, build)
