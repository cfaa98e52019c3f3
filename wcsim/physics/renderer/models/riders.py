"""Models of those who sit or stand in the open on what they drive, in metres, x forward."""

from __future__ import annotations

from wcsim.physics.renderer.models.paint import Paint
from wcsim.physics.renderer.models.people import HELMETED, BodyPart, Posture, figure
from wcsim.physics.renderer.models.primitives import box, prism, wheel
from wcsim.physics.renderer.models.vehicles import each, rod
from wcsim.types import ClassId


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
    rider = Posture(
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
        *figure(rider, ClassId.RIDER),
    ]


def motorcycle() -> list[BodyPart]:
    """A motorcycle with its rider, 2.2 x 0.8 x 1.6 m."""
    body = prism([(-0.35, 0.35), (0.35, 0.3), (0.5, 0.72), (0.25, 0.92), (-0.2, 0.8)], 0.15)
    seat = box((-0.85, -0.13, 0.72), (-0.1, 0.13, 0.84))
    rods = [rod((0.75, y, 0.33), (0.5, y, 0.98), 0.035) for y in (-0.09, 0.09)]
    bar = rod((0.45, -0.38, 1.0), (0.45, 0.38, 1.0), 0.025)
    rider = Posture(
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
        *figure(rider, ClassId.RIDER, HELMETED),
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
    rider = Posture(
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
        *figure(rider, ClassId.RIDER, HELMETED),
    ]


def scooter() -> list[BodyPart]:
    """A kick scooter with its standing rider, 1.15 x 0.55 x 1.9 m; Cityscapes files scooters under motorcycle."""
    deck = box((-0.4, -0.09, 0.1), (0.36, 0.09, 0.15))
    stem = rod((0.44, 0.0, 0.12), (0.34, 0.0, 1.1), 0.03)
    bar = rod((0.34, -0.26, 1.1), (0.34, 0.26, 1.1), 0.02)
    rider = Posture(
        hip=(-0.05, 0.0, 1.02),
        lean_m=0.06,
        hands=((0.32, 0.23, 1.12), (0.32, -0.23, 1.12)),
        knees=((0.06, 0.09, 0.58), (-0.1, -0.09, 0.58)),
        ankles=((0.05, 0.06, 0.22), (-0.22, -0.06, 0.22)),
    )
    return [
        *each([wheel(x, 0.0, 0.1, 0.05, 8) for x in (-0.45, 0.47)], ClassId.MOTORCYCLE, Paint.TYRE),
        *each([deck, stem, bar], ClassId.MOTORCYCLE, Paint.DARK),
        *figure(rider, ClassId.RIDER),
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
    person = Posture(
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
        *figure(person, ClassId.PERSON),
    ]
