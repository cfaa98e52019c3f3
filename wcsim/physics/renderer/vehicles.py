"""Models of what drives in the street, in metres, x forward; the sizes are SUMO's defaults of their vehicle class."""

from __future__ import annotations

from wcsim.physics.renderer.models import Piece, Posture, figure
from wcsim.physics.renderer.paint import Paint
from wcsim.physics.renderer.shapes import Part, Point, box, decal, limb, prism, wheel
from wcsim.types import ClassId

SKIN_M = 0.01  # decals float this far above the body, enough for the depth buffer within a camera's range


def car() -> list[Piece]:
    """A passenger car of 5.0 x 1.8 x 1.5 m, 140 triangles."""
    body = prism(
        [(-2.4, 0.22), (2.4, 0.22), (2.49, 0.45), (2.42, 0.72), (1.0, 0.95), (-2.3, 0.98), (-2.49, 0.6)], 0.9, 0.94
    )
    cabin = prism([(-2.1, 0.93), (1.25, 0.93), (0.3, 1.48), (-1.5, 1.5)], 0.82, 0.8)
    wheels = [wheel(x, y, 0.32, 0.2, 7) for x in (-1.45, 1.5) for y in (-0.8, 0.8)]
    lights = [_plate(2.47, 0.6 * s, 0.6, 0.18, 0.06, 1) for s in (-1, 1)]
    rear = [_plate(-2.45, 0.68 * s, 0.74, 0.14, 0.07, -1) for s in (-1, 1)]
    return [
        Piece(body, ClassId.CAR, Paint.BODY),
        Piece(cabin, ClassId.CAR, Paint.GLASS, top=Paint.BODY),
        *_each(wheels, ClassId.CAR, Paint.TYRE),
        *_each(lights, ClassId.CAR, Paint.HEADLIGHT),
        *_each(rear, ClassId.CAR, Paint.TAILLIGHT),
    ]


def truck() -> list[Piece]:
    """A lorry or van of 7.1 x 2.4 x 2.4 m: a cab before a box."""
    cab = prism([(1.75, 0.4), (3.5, 0.4), (3.54, 0.9), (3.2, 2.1), (1.75, 2.2)], 1.16, 0.94)
    cargo = box((-3.55, -1.2, 0.65), (1.7, 1.2, 2.4))
    frame = box((-3.4, -0.5, 0.35), (3.2, 0.5, 0.68))
    screen = decal([(3.5, -0.95, 1.2), (3.5, 0.95, 1.2), (3.24, 0.92, 2.0), (3.24, -0.92, 2.0)])
    windows = [_pane(2.1, 3.0, 1.16, s, 1.15, 1.95) for s in (-1, 1)]
    wheels = [wheel(x, y, 0.45, 0.3, 8) for x in (-2.4, 2.5) for y in (-1.04, 1.04)]
    lights = [_plate(3.545, 0.85 * s, 0.7, 0.16, 0.08, 1) for s in (-1, 1)]
    rear = [_plate(-3.56, 1.0 * s, 0.85, 0.12, 0.08, -1) for s in (-1, 1)]
    return [
        Piece(cab, ClassId.TRUCK, Paint.BODY),
        Piece(cargo, ClassId.TRUCK, Paint.CARGO),
        Piece(frame, ClassId.TRUCK, Paint.DARK),
        *_each([screen, *windows], ClassId.TRUCK, Paint.GLASS),
        *_each(wheels, ClassId.TRUCK, Paint.TYRE),
        *_each(lights, ClassId.TRUCK, Paint.HEADLIGHT),
        *_each(rear, ClassId.TRUCK, Paint.TAILLIGHT),
    ]


def bus() -> list[Piece]:
    """A city bus of 12 x 2.5 x 3.4 m, 108 triangles."""
    body = box((-6.0, -1.25, 0.3), (6.0, 1.25, 3.4))
    windows = [_pane(-5.6, 5.3, 1.25, 1, 1.35, 2.75), _pane(-5.6, -3.0, 1.25, -1, 1.35, 2.75)]
    windows += [_pane(-1.3, 2.6, 1.25, -1, 1.35, 2.75)]
    doors = [_pane(-2.7, -1.6, 1.25, -1, 0.45, 2.75), _pane(4.2, 5.4, 1.25, -1, 0.45, 2.75)]
    screen = _plate(6.0, 0.0, 2.05, 1.12, 0.8, 1)
    sign = _plate(6.0, 0.0, 3.1, 0.8, 0.16, 1)
    back = _plate(-6.0, 0.0, 2.4, 0.95, 0.45, -1)
    wheels = [wheel(x, y, 0.5, 0.3, 6) for x in (-3.4, 3.4) for y in (-1.09, 1.09)]
    return [
        Piece(body, ClassId.BUS, Paint.BUS),
        *_each([*windows, *doors, screen, back], ClassId.BUS, Paint.GLASS),
        Piece(sign, ClassId.BUS, Paint.HEADLIGHT),
        *_each(wheels, ClassId.BUS, Paint.TYRE),
        *_each([_plate(-6.0, 1.05 * s, 1.0, 0.12, 0.25, -1) for s in (-1, 1)], ClassId.BUS, Paint.TAILLIGHT),
    ]


def tram() -> list[Piece]:
    """A tram of 22 x 2.4 x 3.2 m: three bodies with bellows between them."""
    bodies = [
        prism([(3.9, 0.35), (10.9, 0.35), (11.0, 1.2), (10.2, 2.95), (9.9, 3.2), (3.9, 3.2)], 1.2),
        box((-3.4, -1.2, 0.35), (3.4, 1.2, 3.2)),
        prism([(-3.9, 3.2), (-9.9, 3.2), (-10.2, 2.95), (-11.0, 1.2), (-10.9, 0.35), (-3.9, 0.35)], 1.2),
    ]
    bellows = [box((x - 0.27, -1.05, 0.4), (x + 0.27, 1.05, 3.05)) for x in (-3.65, 3.65)]
    bogies = [box((x - 1.2, -0.9, 0.0), (x + 1.2, 0.9, 0.4)) for x in (-7.4, 0.0, 7.4)]
    spans = ((4.3, 9.9), (-3.1, 3.1), (-9.9, -4.3))
    windows = [_pane(x0, x1, 1.2, s, 1.3, 2.6) for x0, x1 in spans for s in (-1, 1)]
    screens = [
        decal([(11.0, -1.0, 1.35), (11.0, 1.0, 1.35), (10.32, 1.0, 2.8), (10.32, -1.0, 2.8)]),
        decal([(-11.0, 1.0, 1.35), (-11.0, -1.0, 1.35), (-10.32, -1.0, 2.8), (-10.32, 1.0, 2.8)]),
    ]
    return [
        *_each(bodies, ClassId.TRAIN, Paint.TRAM),
        *_each([*bellows, *bogies], ClassId.TRAIN, Paint.DARK),
        *_each([*windows, *screens], ClassId.TRAIN, Paint.GLASS),
    ]


def bicycle() -> list[Piece]:
    """A bicycle with its rider, 1.7 x 0.6 x 1.75 m, at most 350 triangles."""
    saddle, crank, head = (-0.2, 0.0, 0.9), (-0.05, 0.0, 0.3), (0.38, 0.0, 0.88)
    rods = [
        _rod((-0.53, 0.0, 0.34), crank),
        _rod(crank, saddle),
        _rod((-0.16, 0.0, 0.78), head),
        _rod(crank, head),
        _rod((0.53, 0.0, 0.34), (0.36, 0.0, 1.02)),
        _rod((0.34, -0.28, 1.02), (0.34, 0.28, 1.02)),
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
        *_each(wheels, ClassId.BICYCLE, Paint.TYRE),
        *_each(rods, ClassId.BICYCLE, Paint.BODY),
        *figure(rider, ClassId.RIDER),
    ]


def motorcycle() -> list[Piece]:
    """A motorcycle with its rider, 2.2 x 0.8 x 1.6 m."""
    body = prism([(-0.35, 0.35), (0.35, 0.3), (0.5, 0.72), (0.25, 0.92), (-0.2, 0.8)], 0.15)
    seat = box((-0.85, -0.13, 0.72), (-0.1, 0.13, 0.84))
    rods = [_rod((0.75, y, 0.33), (0.5, y, 0.98), 0.035) for y in (-0.09, 0.09)]
    bar = _rod((0.45, -0.38, 1.0), (0.45, 0.38, 1.0), 0.025)
    rider = Posture(
        hip=(-0.3, 0.0, 0.88),
        lean_m=0.22,
        hands=((0.42, 0.34, 1.02), (0.42, -0.34, 1.02)),
        knees=((0.12, 0.2, 0.72), (0.12, -0.2, 0.72)),
        ankles=((-0.1, 0.2, 0.37), (-0.1, -0.2, 0.37)),
    )
    return [
        *_each([wheel(x, 0.0, 0.33, 0.13, 10) for x in (-0.77, 0.77)], ClassId.MOTORCYCLE, Paint.TYRE),
        Piece(body, ClassId.MOTORCYCLE, Paint.BODY),
        Piece(seat, ClassId.MOTORCYCLE, Paint.DARK),
        *_each([*rods, bar], ClassId.MOTORCYCLE, Paint.METAL),
        *figure(rider, ClassId.RIDER, helmet=True),
    ]


def scooter() -> list[Piece]:
    """A kick scooter with its standing rider, 1.15 x 0.55 x 1.9 m; Cityscapes files scooters under motorcycle."""
    deck = box((-0.4, -0.09, 0.1), (0.36, 0.09, 0.15))
    stem = _rod((0.44, 0.0, 0.12), (0.34, 0.0, 1.1), 0.03)
    bar = _rod((0.34, -0.26, 1.1), (0.34, 0.26, 1.1), 0.02)
    rider = Posture(
        hip=(-0.05, 0.0, 1.02),
        lean_m=0.06,
        hands=((0.32, 0.23, 1.12), (0.32, -0.23, 1.12)),
        knees=((0.06, 0.09, 0.58), (-0.1, -0.09, 0.58)),
        ankles=((0.05, 0.06, 0.22), (-0.22, -0.06, 0.22)),
    )
    return [
        *_each([wheel(x, 0.0, 0.1, 0.05, 8) for x in (-0.45, 0.47)], ClassId.MOTORCYCLE, Paint.TYRE),
        *_each([deck, stem, bar], ClassId.MOTORCYCLE, Paint.DARK),
        *figure(rider, ClassId.RIDER),
    ]


def wheelchair() -> list[Piece]:
    """A power wheelchair with its user, 1.12 x 0.62 x 1.45 m; the drive axle is 0.24 m behind the middle of the box."""
    axle = -0.24
    solid = [
        box((axle - 0.18, -0.2, 0.2), (axle + 0.5, 0.2, 0.42)),  # batteries and motors
        box((axle - 0.12, -0.22, 0.43), (axle + 0.42, 0.22, 0.5)),  # seat
        box((axle - 0.24, -0.21, 0.5), (axle - 0.16, 0.21, 1.0)),  # back
        box((axle - 0.12, 0.23, 0.68), (axle + 0.28, 0.3, 0.73)),
        box((axle - 0.12, -0.3, 0.68), (axle + 0.28, -0.23, 0.73)),
        box((axle + 0.6, -0.18, 0.1), (axle + 0.8, 0.18, 0.14)),  # footplate
        _rod((axle + 0.42, 0.0, 0.45), (axle + 0.64, 0.0, 0.13), 0.03),
        _rod((axle + 0.28, -0.265, 0.73), (axle + 0.3, -0.265, 0.84), 0.02),  # joystick
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
        Piece(solid[0], ClassId.DYNAMIC, Paint.BODY),
        *_each([*solid[1:], *tips], ClassId.DYNAMIC, Paint.DARK),
        *_each([*wheels, *casters], ClassId.DYNAMIC, Paint.TYRE),
        *figure(person, ClassId.PERSON),
    ]


def other() -> list[Piece]:
    """A plain box for what has no model of its own."""
    return [Piece(box((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0)), ClassId.DYNAMIC, Paint.CARGO)]


def _each(parts: list[Part], class_id: ClassId, paint: Paint) -> list[Piece]:
    return [Piece(part, class_id, paint) for part in parts]


def _rod(start: Point, end: Point, radius: float = 0.022) -> Part:
    return limb(start, end, radius, radius, sides=4)


def _plate(x: float, y: float, z: float, half_width: float, half_height: float, facing: int) -> Part:
    """A rectangle across x that faces forward (1) or backward (-1)."""
    x += SKIN_M * facing
    near, far = y - half_width * facing, y + half_width * facing
    low, high = z - half_height, z + half_height
    return decal([(x, near, low), (x, far, low), (x, far, high), (x, near, high)])


def _pane(x0: float, x1: float, y: float, side: int, low: float, high: float) -> Part:
    """A rectangle along x on the left (1) or right (-1) side of a body of half width y."""
    y = (y + SKIN_M) * side
    start, end = (x1, x0) if side > 0 else (x0, x1)
    return decal([(start, y, low), (end, y, low), (end, y, high), (start, y, high)])
