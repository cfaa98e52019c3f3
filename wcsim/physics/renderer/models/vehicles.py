"""Models of what drives in the street, in metres, x forward, and of the rigid pieces of vehicles that bend.

The sizes are SUMO's defaults of their vehicle class.
"""

from __future__ import annotations

from wcsim.physics.renderer.models.paint import Paint
from wcsim.physics.renderer.models.primitives import BodyPart, Part, Point, box, decal, each, limb, prism, wheel
from wcsim.types import ClassId

_SKIN_M = 0.01  # decals float this far above the body, enough for the depth buffer within a camera's range


def car(paint: Paint = Paint.BODY) -> list[BodyPart]:
    """A passenger car of 5.0 x 1.8 x 1.5 m, 148 triangles."""
    body = prism(
        [(-2.4, 0.22), (2.4, 0.22), (2.49, 0.45), (2.42, 0.72), (1.0, 0.95), (-2.3, 0.98), (-2.49, 0.6)], 0.9, 0.94
    )
    cabin = prism([(-2.1, 0.93), (1.25, 0.93), (0.3, 1.48), (-1.5, 1.5)], 0.82, 0.8)
    wheels = [wheel(x, y, 0.32, 0.2, 7) for x in (-1.45, 1.5) for y in (-0.8, 0.8)]
    lights = [_plate(2.47, 0.6 * s, 0.6, 0.18, 0.06, 1) for s in (-1, 1)]
    rear = [_plate(-2.45, 0.68 * s, 0.74, 0.14, 0.07, -1) for s in (-1, 1)]
    return [
        BodyPart(body, ClassId.CAR, paint),
        BodyPart(cabin, ClassId.CAR, Paint.GLASS, top=paint),
        *each(wheels, ClassId.CAR, Paint.TYRE),
        *each(lights, ClassId.CAR, Paint.HEADLIGHT),
        *each(rear, ClassId.CAR, Paint.TAILLIGHT),
        *_turn_lamps(ClassId.CAR, (2.48, 0.8, 0.5), (-2.46, 0.8, 0.6)),
    ]


def truck() -> list[BodyPart]:
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
    windows = [_pane(-5.6, 5.3, 1.25, 1, 1.35, 2.75), _pane(-5.6, -3.0, 1.25, -1, 1.35, 2.75)]
    windows += [_pane(-1.3, 2.6, 1.25, -1, 1.35, 2.75)]
    doors = [_pane(-2.7, -1.6, 1.25, -1, 0.45, 2.75), _pane(4.2, 5.4, 1.25, -1, 0.45, 2.75)]
    screen = _plate(6.0, 0.0, 2.05, 1.12, 0.8, 1)
    sign = _plate(6.0, 0.0, 3.1, 0.8, 0.16, 1)
    back = _plate(-6.0, 0.0, 2.4, 0.95, 0.45, -1)
    wheels = [wheel(x, y, 0.5, 0.3, 6) for x in (-3.4, 3.4) for y in (-1.09, 1.09)]
    return [
        BodyPart(body, ClassId.BUS, Paint.BUS),
        *each([*windows, *doors, screen, back], ClassId.BUS, Paint.GLASS),
        BodyPart(sign, ClassId.BUS, Paint.HEADLIGHT),
        *each(wheels, ClassId.BUS, Paint.TYRE),
        *each([_plate(-6.0, 1.05 * s, 1.0, 0.12, 0.25, -1) for s in (-1, 1)], ClassId.BUS, Paint.TAILLIGHT),
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
    windows = [_pane(x0, x1, 1.2, s, 1.3, 2.6) for x0, x1 in spans for s in (-1, 1)]
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


def _turn_lamps(class_id: ClassId, front: Point, back: Point) -> list[BodyPart]:
    """The four lamps that say where a vehicle turns; `front` and `back` are the middles of the left ones."""
    pieces = []
    for side, paint in ((1, Paint.LEFT_LAMP), (-1, Paint.RIGHT_LAMP)):
        for (x, y, z), facing in ((front, 1), (back, -1)):
            pieces.append(BodyPart(_plate(x, side * y, z, 0.06, 0.05, facing), class_id, paint))
    return pieces


def _plate(x: float, y: float, z: float, half_width: float, half_height: float, facing: int) -> Part:
    """A rectangle across x that faces forward (1) or backward (-1)."""
    x += _SKIN_M * facing
    near, far = y - half_width * facing, y + half_width * facing
    low, high = z - half_height, z + half_height
    return decal([(x, near, low), (x, far, low), (x, far, high), (x, near, high)])


def _pane(x0: float, x1: float, y: float, side: int, low: float, high: float) -> Part:
    """A rectangle along x on the left (1) or right (-1) side of a body of half width y."""
    y = (y + _SKIN_M) * side
    start, end = (x1, x0) if side > 0 else (x0, x1)
    return decal([(start, y, low), (end, y, low), (end, y, high), (start, y, high)])


LAMP_RADIUS_M = 0.1  # of a traffic light
LAMP_APART_M = 0.26
LAMP_DEPTH_M = 0.05


def van(class_id: ClassId, paint: Paint = Paint.BODY) -> list[BodyPart]:
    """A van of 5.4 x 2.0 x 2.3 m: one body with a short nose."""
    profile = [
        (-2.6, 0.28), (2.55, 0.28), (2.7, 0.55), (2.62, 0.95), (1.95, 1.2), (1.2, 2.2), (0.9, 2.3), (-2.55, 2.3),
        (-2.7, 1.9),
    ]  # fmt: skip
    screen = decal([(1.92, -0.85, 1.27), (1.92, 0.85, 1.27), (1.3, 0.8, 2.1), (1.3, -0.8, 2.1)])
    windows = [_pane(0.3, 1.5, 0.97, s, 1.2, 1.85) for s in (-1, 1)]
    back = [_plate(-2.71, 0.45 * s, 1.65, 0.33, 0.25, -1) for s in (-1, 1)]
    return [
        BodyPart(prism(profile, 1.0, 0.93), class_id, paint),
        *each([screen, *windows, *back], class_id, Paint.GLASS),
        *each([wheel(x, y, 0.34, 0.22, 7) for x in (-1.65, 1.75) for y in (-0.89, 0.89)], class_id, Paint.TYRE),
        *each([_plate(2.69, 0.75 * s, 0.7, 0.16, 0.09, 1) for s in (-1, 1)], class_id, Paint.HEADLIGHT),
        *each([_plate(-2.71, 0.9 * s, 1.0, 0.07, 0.2, -1) for s in (-1, 1)], class_id, Paint.TAILLIGHT),
        *_turn_lamps(class_id, (2.7, 0.92, 0.6), (-2.71, 0.9, 0.7)),
    ]


def taxi() -> list[BodyPart]:
    """A yellow car with a sign on its roof."""
    sign = box((-0.45, -0.3, 1.49), (-0.2, 0.3, 1.66))
    return [*car(Paint.TAXI), BodyPart(sign, ClassId.CAR, Paint.HEADLIGHT)]


def police() -> list[BodyPart]:
    """A white car with blue doors and a blue light."""
    doors = [_pane(-1.0, 0.9, 0.87, s, 0.38, 0.86) for s in (-1, 1)]
    light = box((-0.4, -0.5, 1.49), (-0.15, 0.5, 1.62))
    return [
        *car(Paint.WHITE),
        *each(doors, ClassId.CAR, Paint.BLUE),
        BodyPart(light, ClassId.CAR, Paint.BLUE_LIGHT),
    ]


def ambulance() -> list[BodyPart]:
    """A white van with a red band and blue lights, 6.5 x 2.16 x 2.86 m."""
    bands = [_pane(-2.6, 0.2, 1.0, s, 0.85, 1.12) for s in (-1, 1)]
    lights = [box((x - 0.12, -0.7, 2.3), (x + 0.12, 0.7, 2.47)) for x in (0.75, -2.3)]
    return [
        *van(ClassId.TRUCK, Paint.WHITE),
        *each([*bands, _plate(-2.71, 0.0, 1.0, 0.78, 0.13, -1)], ClassId.TRUCK, Paint.RED),
        *each(lights, ClassId.TRUCK, Paint.BLUE_LIGHT),
    ]


def coach() -> list[BodyPart]:
    """A coach of 14 x 2.6 x 4.0 m: high windows all round above a luggage deck, one door."""
    body = prism([(-7.0, 0.35), (6.85, 0.35), (7.0, 0.9), (6.75, 3.6), (6.4, 4.0), (-6.8, 4.0), (-7.0, 3.7)], 1.3, 0.97)
    windows = [_pane(-6.6, 5.6, 1.29, s, 2.0, 3.45) for s in (-1, 1)]
    screen = decal([(6.96, -1.15, 1.5), (6.96, 1.15, 1.5), (6.79, 1.15, 3.4), (6.79, -1.15, 3.4)])
    return [
        BodyPart(body, ClassId.BUS, Paint.BODY),
        *each([*windows, screen, _pane(5.75, 6.6, 1.3, -1, 0.55, 3.0)], ClassId.BUS, Paint.GLASS),
        BodyPart(_plate(-7.0, 0.0, 2.9, 1.0, 0.5, -1), ClassId.BUS, Paint.GLASS),
        *each([wheel(x, y, 0.52, 0.34, 8) for x in (-4.6, -3.3, 4.2) for y in (-1.12, 1.12)], ClassId.BUS, Paint.TYRE),
        *each([_plate(7.0, 0.95 * s, 0.8, 0.2, 0.1, 1) for s in (-1, 1)], ClassId.BUS, Paint.HEADLIGHT),
        *each([_plate(-7.0, 1.05 * s, 1.2, 0.12, 0.25, -1) for s in (-1, 1)], ClassId.BUS, Paint.TAILLIGHT),
        *_turn_lamps(ClassId.BUS, (7.0, 1.2, 0.8), (-7.0, 1.05, 0.85)),
    ]


def bus_front() -> list[BodyPart]:
    """The first half of an articulated bus, 9 x 2.5 x 3.3 m: its middle joint is behind it."""
    windows = [_pane(-3.6, 3.8, 1.25, 1, 1.35, 2.7), _pane(-1.9, 2.0, 1.25, -1, 1.35, 2.7)]
    doors = [_pane(2.4, 3.8, 1.25, -1, 0.45, 2.7), _pane(-3.6, -2.2, 1.25, -1, 0.45, 2.7)]
    return [
        BodyPart(box((-4.0, -1.25, 0.3), (4.5, 1.25, 3.3)), ClassId.BUS, Paint.BUS),
        BodyPart(box((-4.5, -1.1, 0.4), (-4.0, 1.1, 3.15)), ClassId.BUS, Paint.DARK),
        *each([*windows, *doors, _plate(4.5, 0.0, 2.0, 1.12, 0.8, 1)], ClassId.BUS, Paint.GLASS),
        BodyPart(_plate(4.5, 0.0, 3.05, 0.8, 0.15, 1), ClassId.BUS, Paint.HEADLIGHT),
        *each([wheel(x, y, 0.5, 0.3, 6) for x in (-2.6, 2.0) for y in (-1.09, 1.09)], ClassId.BUS, Paint.TYRE),
        *_turn_lamps(ClassId.BUS, (4.5, 1.1, 0.8), (-4.0, 1.1, 0.8)),
    ]


def bus_rear() -> list[BodyPart]:
    """The last piece of an articulated bus, 9 x 2.5 x 3.3 m: its middle joint is before it."""
    windows = [_pane(-4.1, 3.6, 1.25, 1, 1.35, 2.7), _pane(-4.1, 0.2, 1.25, -1, 1.35, 2.7)]
    return [
        BodyPart(box((-4.5, -1.25, 0.3), (4.0, 1.25, 3.3)), ClassId.BUS, Paint.BUS),
        BodyPart(box((4.0, -1.1, 0.4), (4.5, 1.1, 3.15)), ClassId.BUS, Paint.DARK),
        *each([*windows, _pane(0.6, 2.0, 1.25, -1, 0.45, 2.7)], ClassId.BUS, Paint.GLASS),
        BodyPart(_plate(-4.5, 0.0, 2.3, 0.95, 0.45, -1), ClassId.BUS, Paint.GLASS),
        *each([wheel(-1.4, y, 0.5, 0.3, 6) for y in (-1.09, 1.09)], ClassId.BUS, Paint.TYRE),
        *each([_plate(-4.5, 1.05 * s, 1.0, 0.12, 0.25, -1) for s in (-1, 1)], ClassId.BUS, Paint.TAILLIGHT),
        *_turn_lamps(ClassId.BUS, (4.0, 1.1, 0.8), (-4.5, 1.05, 0.6)),
    ]


def tractor() -> list[BodyPart]:
    """The tractor of an articulated lorry, 5.9 x 2.5 x 3.8 m: a high cab on a bare frame."""
    cab = prism([(0.55, 0.5), (2.85, 0.5), (2.95, 1.0), (2.85, 2.6), (2.3, 3.8), (0.55, 3.8)], 1.25, 0.95)
    screen = decal([(2.9, -1.05, 1.75), (2.9, 1.05, 1.75), (2.83, 1.0, 2.65), (2.83, -1.0, 2.65)])
    lights = [_plate(2.93, 0.9 * s, 0.75, 0.2, 0.1, 1) for s in (-1, 1)]
    wheels = [wheel(x, y, 0.5, 0.32, 8) for x in (-1.6, 1.9) for y in (-1.09, 1.09)]
    return [
        BodyPart(cab, ClassId.TRUCK, Paint.BODY),
        BodyPart(box((-2.95, -0.45, 0.5), (2.6, 0.45, 0.95)), ClassId.TRUCK, Paint.DARK),
        *each([screen, *(_pane(1.4, 2.6, 1.24, s, 1.7, 2.5) for s in (-1, 1))], ClassId.TRUCK, Paint.GLASS),
        *each(wheels, ClassId.TRUCK, Paint.TYRE),
        *each(lights, ClassId.TRUCK, Paint.HEADLIGHT),
        *_turn_lamps(ClassId.TRUCK, (2.93, 1.15, 0.6), (-2.95, 0.4, 0.7)),
    ]


def trailer() -> list[BodyPart]:
    """A box trailer with three axles at its rear, 10.6 x 2.55 x 4.0 m."""
    wheels = [wheel(x, y, 0.5, 0.34, 8) for x in (-4.0, -2.8, -1.6) for y in (-1.09, 1.09)]
    return [
        BodyPart(box((-5.3, -1.27, 1.1), (5.3, 1.27, 4.0)), ClassId.TRUCK, Paint.CARGO),
        BodyPart(box((-5.2, -0.6, 0.7), (3.4, 0.6, 1.12)), ClassId.TRUCK, Paint.DARK),
        *each([box((2.2, y - 0.08, 0.25), (2.4, y + 0.08, 0.8)) for y in (-0.5, 0.5)], ClassId.TRUCK, Paint.DARK),
        *each(wheels, ClassId.TRUCK, Paint.TYRE),
        *each([_plate(-5.2, 0.35 * s, 0.9, 0.2, 0.08, -1) for s in (-1, 1)], ClassId.TRUCK, Paint.TAILLIGHT),
    ]


def tram_front() -> list[BodyPart]:
    """The first piece of a tram or train, 9 x 2.4 x 3.4 m."""
    return _tram_end(1)


def tram_rear() -> list[BodyPart]:
    """The last piece of a tram or train: the same nose, looking back."""
    return _tram_end(-1)


def tram_middle() -> list[BodyPart]:
    """A piece between others, bellows at both ends."""
    return [
        BodyPart(box((-4.2, -1.2, 0.35), (4.2, 1.2, 3.4)), ClassId.TRAIN, Paint.TRAM),
        *each([_bellows(x) for x in (-4.35, 4.35)], ClassId.TRAIN, Paint.DARK),
        BodyPart(box((-1.2, -0.9, 0.0), (1.2, 0.9, 0.4)), ClassId.TRAIN, Paint.DARK),
        *each([_pane(-3.8, 3.8, 1.2, s, 1.3, 2.65) for s in (-1, 1)], ClassId.TRAIN, Paint.GLASS),
    ]


def _tram_end(nose: int) -> list[BodyPart]:
    profile = [(-4.2, 0.35), (4.4, 0.35), (4.5, 1.2), (3.7, 3.1), (3.4, 3.4), (-4.2, 3.4)]
    across = [(4.5, -1.0, 1.4), (4.5, 1.0, 1.4), (3.83, 1.0, 2.85), (3.83, -1.0, 2.85)]
    if nose < 0:  # turned by half a circle about the vertical: x and y change their signs
        across = [(-x, -y, z) for x, y, z in across]
    x0, x1 = sorted((nose * -3.8, nose * 3.3))
    lamps = [_plate(nose * 4.47, 0.8 * s, 0.85, 0.14, 0.1, nose) for s in (-1, 1)]
    return [
        BodyPart(prism([(nose * x, z) for x, z in profile], 1.2), ClassId.TRAIN, Paint.TRAM),
        *each([_bellows(nose * -4.35), box((-1.2, -0.9, 0.0), (1.2, 0.9, 0.4))], ClassId.TRAIN, Paint.DARK),
        *each([decal(across), *(_pane(x0, x1, 1.2, s, 1.3, 2.65) for s in (-1, 1))], ClassId.TRAIN, Paint.GLASS),
        *each(lamps, ClassId.TRAIN, Paint.HEADLIGHT if nose > 0 else Paint.TAILLIGHT),
    ]


def signal_lamps(lit: tuple[bool, ...], colours: tuple[Paint, ...]) -> list[BodyPart]:
    """Lamps one below another, each of its colour or dark; they shine along x."""
    pieces = []
    for k, (on, colour) in enumerate(zip(lit, colours, strict=True)):
        z = LAMP_RADIUS_M + (len(lit) - 1 - k) * LAMP_APART_M
        disc = limb((0.0, 0.0, z), (LAMP_DEPTH_M, 0.0, z), LAMP_RADIUS_M, LAMP_RADIUS_M, sides=8)
        pieces.append(BodyPart(disc, ClassId.TRAFFIC_LIGHT, colour if on else Paint.UNLIT))
    return pieces


def _bellows(x: float) -> Part:
    return box((x - 0.16, -1.05, 0.4), (x + 0.16, 1.05, 3.2))
