"""Models of what drives in the street, in metres, x forward; the sizes are SUMO's defaults of their vehicle class."""

from __future__ import annotations

from wcsim.physics.renderer.models.paint import Paint
from wcsim.physics.renderer.models.people import BodyPart
from wcsim.physics.renderer.models.primitives import Part, Point, box, decal, limb, prism, wheel
from wcsim.types import ClassId

_SKIN_M = 0.01  # decals float this far above the body, enough for the depth buffer within a camera's range


def car(paint: Paint = Paint.BODY) -> list[BodyPart]:
    """A passenger car of 5.0 x 1.8 x 1.5 m, 148 triangles."""
    body = prism(
        [(-2.4, 0.22), (2.4, 0.22), (2.49, 0.45), (2.42, 0.72), (1.0, 0.95), (-2.3, 0.98), (-2.49, 0.6)], 0.9, 0.94
    )
    cabin = prism([(-2.1, 0.93), (1.25, 0.93), (0.3, 1.48), (-1.5, 1.5)], 0.82, 0.8)
    wheels = [wheel(x, y, 0.32, 0.2, 7) for x in (-1.45, 1.5) for y in (-0.8, 0.8)]
    lights = [plate(2.47, 0.6 * s, 0.6, 0.18, 0.06, 1) for s in (-1, 1)]
    rear = [plate(-2.45, 0.68 * s, 0.74, 0.14, 0.07, -1) for s in (-1, 1)]
    return [
        BodyPart(body, ClassId.CAR, paint),
        BodyPart(cabin, ClassId.CAR, Paint.GLASS, top=paint),
        *each(wheels, ClassId.CAR, Paint.TYRE),
        *each(lights, ClassId.CAR, Paint.HEADLIGHT),
        *each(rear, ClassId.CAR, Paint.TAILLIGHT),
        *turn_lamps(ClassId.CAR, (2.48, 0.8, 0.5), (-2.46, 0.8, 0.6)),
    ]


def truck() -> list[BodyPart]:
    """A lorry or van of 7.1 x 2.4 x 2.4 m: a cab before a box."""
    cab = prism([(1.75, 0.4), (3.5, 0.4), (3.54, 0.9), (3.2, 2.1), (1.75, 2.2)], 1.16, 0.94)
    cargo = box((-3.55, -1.2, 0.65), (1.7, 1.2, 2.4))
    frame = box((-3.4, -0.5, 0.35), (3.2, 0.5, 0.68))
    screen = decal([(3.5, -0.95, 1.2), (3.5, 0.95, 1.2), (3.24, 0.92, 2.0), (3.24, -0.92, 2.0)])
    windows = [pane(2.1, 3.0, 1.16, s, 1.15, 1.95) for s in (-1, 1)]
    wheels = [wheel(x, y, 0.45, 0.3, 8) for x in (-2.4, 2.5) for y in (-1.04, 1.04)]
    lights = [plate(3.545, 0.85 * s, 0.7, 0.16, 0.08, 1) for s in (-1, 1)]
    rear = [plate(-3.56, 1.0 * s, 0.85, 0.12, 0.08, -1) for s in (-1, 1)]
    return [
        BodyPart(cab, ClassId.TRUCK, Paint.BODY),
        BodyPart(cargo, ClassId.TRUCK, Paint.CARGO),
        BodyPart(frame, ClassId.TRUCK, Paint.DARK),
        *each([screen, *windows], ClassId.TRUCK, Paint.GLASS),
        *each(wheels, ClassId.TRUCK, Paint.TYRE),
        *each(lights, ClassId.TRUCK, Paint.HEADLIGHT),
        *each(rear, ClassId.TRUCK, Paint.TAILLIGHT),
    ]


def bus() -> list[BodyPart]:
    """A city bus of 12 x 2.5 x 3.4 m, 108 triangles."""
    body = box((-6.0, -1.25, 0.3), (6.0, 1.25, 3.4))
    windows = [pane(-5.6, 5.3, 1.25, 1, 1.35, 2.75), pane(-5.6, -3.0, 1.25, -1, 1.35, 2.75)]
    windows += [pane(-1.3, 2.6, 1.25, -1, 1.35, 2.75)]
    doors = [pane(-2.7, -1.6, 1.25, -1, 0.45, 2.75), pane(4.2, 5.4, 1.25, -1, 0.45, 2.75)]
    screen = plate(6.0, 0.0, 2.05, 1.12, 0.8, 1)
    sign = plate(6.0, 0.0, 3.1, 0.8, 0.16, 1)
    back = plate(-6.0, 0.0, 2.4, 0.95, 0.45, -1)
    wheels = [wheel(x, y, 0.5, 0.3, 6) for x in (-3.4, 3.4) for y in (-1.09, 1.09)]
    return [
        BodyPart(body, ClassId.BUS, Paint.BUS),
        *each([*windows, *doors, screen, back], ClassId.BUS, Paint.GLASS),
        BodyPart(sign, ClassId.BUS, Paint.HEADLIGHT),
        *each(wheels, ClassId.BUS, Paint.TYRE),
        *each([plate(-6.0, 1.05 * s, 1.0, 0.12, 0.25, -1) for s in (-1, 1)], ClassId.BUS, Paint.TAILLIGHT),
    ]


def tram() -> list[BodyPart]:
    """A tram of 22 x 2.4 x 3.2 m: three bodies with bellows between them."""
    bodies = [
        prism([(3.9, 0.35), (10.9, 0.35), (11.0, 1.2), (10.2, 2.95), (9.9, 3.2), (3.9, 3.2)], 1.2),
        box((-3.4, -1.2, 0.35), (3.4, 1.2, 3.2)),
        prism([(-3.9, 3.2), (-9.9, 3.2), (-10.2, 2.95), (-11.0, 1.2), (-10.9, 0.35), (-3.9, 0.35)], 1.2),
    ]
    bellows = [box((x - 0.27, -1.05, 0.4), (x + 0.27, 1.05, 3.05)) for x in (-3.65, 3.65)]
    bogies = [box((x - 1.2, -0.9, 0.0), (x + 1.2, 0.9, 0.4)) for x in (-7.4, 0.0, 7.4)]
    spans = ((4.3, 9.9), (-3.1, 3.1), (-9.9, -4.3))
    windows = [pane(x0, x1, 1.2, s, 1.3, 2.6) for x0, x1 in spans for s in (-1, 1)]
    screens = [
        decal([(11.0, -1.0, 1.35), (11.0, 1.0, 1.35), (10.32, 1.0, 2.8), (10.32, -1.0, 2.8)]),
        decal([(-11.0, 1.0, 1.35), (-11.0, -1.0, 1.35), (-10.32, -1.0, 2.8), (-10.32, 1.0, 2.8)]),
    ]
    return [
        *each(bodies, ClassId.TRAIN, Paint.TRAM),
        *each([*bellows, *bogies], ClassId.TRAIN, Paint.DARK),
        *each([*windows, *screens], ClassId.TRAIN, Paint.GLASS),
    ]


def other() -> list[BodyPart]:
    """A plain box for what has no model of its own."""
    return [BodyPart(box((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0)), ClassId.DYNAMIC, Paint.CARGO)]


def each(parts: list[Part], class_id: ClassId, paint: Paint) -> list[BodyPart]:
    """Parts of one class and paint."""
    return [BodyPart(part, class_id, paint) for part in parts]


def turn_lamps(class_id: ClassId, front: Point, back: Point) -> list[BodyPart]:
    """The four lamps that say where a vehicle turns; `front` and `back` are the middles of the left ones."""
    pieces = []
    for side, paint in ((1, Paint.LEFT_LAMP), (-1, Paint.RIGHT_LAMP)):
        for (x, y, z), facing in ((front, 1), (back, -1)):
            pieces.append(BodyPart(plate(x, side * y, z, 0.06, 0.05, facing), class_id, paint))
    return pieces


def rod(start: Point, end: Point, radius: float = 0.022) -> Part:
    """A tube."""
    return limb(start, end, radius, radius, sides=4)


def plate(x: float, y: float, z: float, half_width: float, half_height: float, facing: int) -> Part:
    """A rectangle across x that faces forward (1) or backward (-1)."""
    x += _SKIN_M * facing
    near, far = y - half_width * facing, y + half_width * facing
    low, high = z - half_height, z + half_height
    return decal([(x, near, low), (x, far, low), (x, far, high), (x, near, high)])


def pane(x0: float, x1: float, y: float, side: int, low: float, high: float) -> Part:
    """A rectangle along x on the left (1) or right (-1) side of a body of half width y."""
    y = (y + _SKIN_M) * side
    start, end = (x1, x0) if side > 0 else (x0, x1)
    return decal([(start, y, low), (end, y, low), (end, y, high), (start, y, high)])
