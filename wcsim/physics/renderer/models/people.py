"""The human figure that walks, rides and sits, and the models of those who do so in the open, in metres, x forward."""

from __future__ import annotations

from dataclasses import dataclass

from wcsim.physics.renderer.models.paint import Paint
from wcsim.physics.renderer.models.primitives import (
    BodyPart,
    Point,
    ball,
    barrel,
    box,
    each,
    limb,
    prism,
    rod,
    wheel,
)
from wcsim.types import ClassId


@dataclass(frozen=True, slots=True, kw_only=True)
class _Posture:
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
class _Build:
    """What differs from figure to figure."""

    head: float = 1.0  # size of the head against a grown-up's
    long_hair: bool = False
    helmet: bool = False


GROWN, LONG_HAIRED, CHILD, HELMETED = _Build(), _Build(long_hair=True), _Build(head=_CHILD_HEAD), _Build(helmet=True)


def _figure(posture: _Posture, class_id: ClassId, build: _Build = GROWN) -> list[BodyPart]:
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


def walker(phase: int, build: _Build = GROWN) -> list[BodyPart]:
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
    posture = _Posture(
        hip=(0.0, 0.0, 0.88),
        lean_m=0.02,
        hands=((0.02 + swing, 0.235, 0.80), (0.02 - swing, -0.235, 0.80)),
        knees=((left[0][0], 0.10, left[0][1]), (right[0][0], -0.10, right[0][1])),
        ankles=((left[1][0], 0.10, left[1][1]), (right[1][0], -0.10, right[1][1])),
    )
    return _figure(posture, ClassId.PERSON, build)


def bicycle() -> list[BodyPart]:
    """A bicycle with its rider, 1.7 x 0.6 x 1.75 m, at most 350 triangles."""
    saddle, crank, head = (-0.2, 0.0, 0.9), (-0.05, 0.0, 0.3), (0.38, 0.0, 0.88)
    rods = [
        rod((-0.53, 0.0, 0.34), crank),
        rod(crank, saddle),
        rod((-0.16, 0.0, 0.78), head),
        rod(crank, head),
        rod((0.53, 0.0, 0.34), (0.36, 0.0, 1.02)),
        rod((0.34, -0.28, 1.02), (0.34, 0.28, 1.02)),
    ]
    rider = _Posture(
        hip=(-0.2, 0.0, 0.98),
        lean_m=0.26,
        hands=((0.34, 0.24, 1.04), (0.34, -0.24, 1.04)),
        knees=((0.18, 0.11, 0.86), (0.12, -0.11, 0.66)),
        ankles=((-0.02, 0.11, 0.5), (-0.06, -0.11, 0.2)),
    )
    wheels = [wheel(x, 0.0, 0.34, 0.04, 10) for x in (-0.53, 0.53)]
    return [
        *each(wheels, ClassId.BICYCLE, Paint.TYRE),
        *each(rods, ClassId.BICYCLE, Paint.BODY),
        *_figure(rider, ClassId.RIDER),
    ]


def motorcycle() -> list[BodyPart]:
    """A motorcycle with its rider, 2.2 x 0.8 x 1.6 m."""
    body = prism([(-0.35, 0.35), (0.35, 0.3), (0.5, 0.72), (0.25, 0.92), (-0.2, 0.8)], 0.15)
    seat = box((-0.85, -0.13, 0.72), (-0.1, 0.13, 0.84))
    rods = [rod((0.75, y, 0.33), (0.5, y, 0.98), 0.035) for y in (-0.09, 0.09)]
    bar = rod((0.45, -0.38, 1.0), (0.45, 0.38, 1.0), 0.025)
    rider = _Posture(
        hip=(-0.3, 0.0, 0.88),
        lean_m=0.22,
        hands=((0.42, 0.34, 1.02), (0.42, -0.34, 1.02)),
        knees=((0.12, 0.2, 0.72), (0.12, -0.2, 0.72)),
        ankles=((-0.1, 0.2, 0.37), (-0.1, -0.2, 0.37)),
    )
    return [
        *each([wheel(x, 0.0, 0.33, 0.13, 10) for x in (-0.77, 0.77)], ClassId.MOTORCYCLE, Paint.TYRE),
        BodyPart(body, ClassId.MOTORCYCLE, Paint.BODY),
        BodyPart(seat, ClassId.MOTORCYCLE, Paint.DARK),
        *each([*rods, bar], ClassId.MOTORCYCLE, Paint.METAL),
        *_figure(rider, ClassId.RIDER, HELMETED),
    ]


def moped() -> list[BodyPart]:
    """A motor scooter with its rider, 2.1 x 0.78 x 1.7 m: small wheels, a leg shield, a floor for the feet."""
    solid = [
        prism([(-0.85, 0.4), (-0.2, 0.35), (-0.1, 0.72), (-0.8, 0.78)], 0.19, 0.8),  # engine cover
        box((-0.2, -0.2, 0.24), (0.4, 0.2, 0.32)),  # floor
        prism([(0.35, 0.25), (0.45, 0.25), (0.62, 0.95), (0.5, 0.95)], 0.24, 0.6),  # leg shield
    ]
    bar = rod((0.45, -0.34, 1.03), (0.45, 0.34, 1.03), 0.025)
    fork = rod((0.66, 0.0, 0.24), (0.55, 0.0, 0.95), 0.05)
    rider = _Posture(
        hip=(-0.4, 0.0, 0.86),
        lean_m=0.1,
        hands=((0.4, 0.32, 1.05), (0.4, -0.32, 1.05)),
        knees=((0.06, 0.16, 0.8), (0.06, -0.16, 0.8)),
        ankles=((0.1, 0.13, 0.39), (0.1, -0.13, 0.39)),
    )
    return [
        *each([wheel(x, 0.0, 0.22, 0.11, 10) for x in (-0.62, 0.68)], ClassId.MOTORCYCLE, Paint.TYRE),
        *each(solid, ClassId.MOTORCYCLE, Paint.BODY),
        BodyPart(box((-0.78, -0.15, 0.77), (-0.12, 0.15, 0.84)), ClassId.MOTORCYCLE, Paint.DARK),
        *each([bar, fork], ClassId.MOTORCYCLE, Paint.METAL),
        *_figure(rider, ClassId.RIDER, HELMETED),
    ]


def scooter() -> list[BodyPart]:
    """A kick scooter with its standing rider, 1.15 x 0.55 x 1.9 m; Cityscapes files scooters under motorcycle."""
    deck = box((-0.4, -0.09, 0.1), (0.36, 0.09, 0.15))
    stem = rod((0.44, 0.0, 0.12), (0.34, 0.0, 1.1), 0.03)
    bar = rod((0.34, -0.26, 1.1), (0.34, 0.26, 1.1), 0.02)
    rider = _Posture(
        hip=(-0.05, 0.0, 1.02),
        lean_m=0.06,
        hands=((0.32, 0.23, 1.12), (0.32, -0.23, 1.12)),
        knees=((0.06, 0.09, 0.58), (-0.1, -0.09, 0.58)),
        ankles=((0.05, 0.06, 0.22), (-0.22, -0.06, 0.22)),
    )
    return [
        *each([wheel(x, 0.0, 0.1, 0.05, 8) for x in (-0.45, 0.47)], ClassId.MOTORCYCLE, Paint.TYRE),
        *each([deck, stem, bar], ClassId.MOTORCYCLE, Paint.DARK),
        *_figure(rider, ClassId.RIDER),
    ]


def wheelchair() -> list[BodyPart]:
    """A power wheelchair with its user, 1.12 x 0.62 x 1.45 m; the drive axle is 0.24 m behind the middle of the box."""
    axle = -0.24
    solid = [
        box((axle - 0.18, -0.2, 0.2), (axle + 0.5, 0.2, 0.42)),  # batteries and motors
        box((axle - 0.12, -0.22, 0.43), (axle + 0.42, 0.22, 0.5)),  # seat
        box((axle - 0.24, -0.21, 0.5), (axle - 0.16, 0.21, 1.0)),  # back
        box((axle - 0.12, 0.23, 0.68), (axle + 0.28, 0.3, 0.73)),
        box((axle - 0.12, -0.3, 0.68), (axle + 0.28, -0.23, 0.73)),
        box((axle + 0.6, -0.18, 0.1), (axle + 0.8, 0.18, 0.14)),  # footplate
        rod((axle + 0.42, 0.0, 0.45), (axle + 0.64, 0.0, 0.13), 0.03),
        rod((axle + 0.28, -0.265, 0.73), (axle + 0.3, -0.265, 0.84), 0.02),  # joystick
    ]
    wheels = [wheel(axle, y, 0.178, 0.08, 8) for y in (-0.27, 0.27)]
    casters = [wheel(axle + 0.44, y, 0.1, 0.05, 6) for y in (-0.25, 0.25)]
    tips = [box((axle - 0.32, y - 0.03, 0.04), (axle - 0.15, y + 0.03, 0.24)) for y in (-0.18, 0.18)]
    person = _Posture(
        hip=(axle, 0.0, 0.57),
        lean_m=-0.04,
        hands=((axle + 0.24, 0.265, 0.78), (axle + 0.27, -0.265, 0.82)),
        knees=((axle + 0.47, 0.1, 0.57), (axle + 0.47, -0.1, 0.57)),
        ankles=((axle + 0.62, 0.1, 0.21), (axle + 0.62, -0.1, 0.21)),
    )
    return [
        BodyPart(solid[0], ClassId.DYNAMIC, Paint.BODY),
        *each([*solid[1:], *tips], ClassId.DYNAMIC, Paint.DARK),
        *each([*wheels, *casters], ClassId.DYNAMIC, Paint.TYRE),
        *_figure(person, ClassId.PERSON),
    ]
