"""Models of vehicles that differ from the usual one of their kind, and of the rigid pieces of those that bend."""

from __future__ import annotations

from wcsim.physics.renderer.models.paint import Paint
from wcsim.physics.renderer.models.people import BodyPart
from wcsim.physics.renderer.models.primitives import Part, box, decal, limb, prism, wheel
from wcsim.physics.renderer.models.vehicles import car, each, pane, plate, turn_lamps
from wcsim.types import ClassId

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
    windows = [pane(0.3, 1.5, 0.97, s, 1.2, 1.85) for s in (-1, 1)]
    back = [plate(-2.71, 0.45 * s, 1.65, 0.33, 0.25, -1) for s in (-1, 1)]
    return [
        BodyPart(prism(profile, 1.0, 0.93), class_id, paint),
        *each([screen, *windows, *back], class_id, Paint.GLASS),
        *each([wheel(x, y, 0.34, 0.22, 7) for x in (-1.65, 1.75) for y in (-0.89, 0.89)], class_id, Paint.TYRE),
        *each([plate(2.69, 0.75 * s, 0.7, 0.16, 0.09, 1) for s in (-1, 1)], class_id, Paint.HEADLIGHT),
        *each([plate(-2.71, 0.9 * s, 1.0, 0.07, 0.2, -1) for s in (-1, 1)], class_id, Paint.TAILLIGHT),
        *turn_lamps(class_id, (2.7, 0.92, 0.6), (-2.71, 0.9, 0.7)),
    ]


def taxi() -> list[BodyPart]:
    """A yellow car with a sign on its roof."""
    sign = box((-0.45, -0.3, 1.49), (-0.2, 0.3, 1.66))
    return [*car(Paint.TAXI), BodyPart(sign, ClassId.CAR, Paint.HEADLIGHT)]


def police() -> list[BodyPart]:
    """A white car with blue doors and a blue light."""
    doors = [pane(-1.0, 0.9, 0.87, s, 0.38, 0.86) for s in (-1, 1)]
    light = box((-0.4, -0.5, 1.49), (-0.15, 0.5, 1.62))
    return [
        *car(Paint.WHITE),
        *each(doors, ClassId.CAR, Paint.BLUE),
        BodyPart(light, ClassId.CAR, Paint.BLUE_LIGHT),
    ]


def ambulance() -> list[BodyPart]:
    """A white van with a red band and blue lights, 6.5 x 2.16 x 2.86 m."""
    bands = [pane(-2.6, 0.2, 1.0, s, 0.85, 1.12) for s in (-1, 1)]
    lights = [box((x - 0.12, -0.7, 2.3), (x + 0.12, 0.7, 2.47)) for x in (0.75, -2.3)]
    return [
        *van(ClassId.TRUCK, Paint.WHITE),
        *each([*bands, plate(-2.71, 0.0, 1.0, 0.78, 0.13, -1)], ClassId.TRUCK, Paint.RED),
        *each(lights, ClassId.TRUCK, Paint.BLUE_LIGHT),
    ]


def coach() -> list[BodyPart]:
    """A coach of 14 x 2.6 x 4.0 m: high windows all round above a luggage deck, one door."""
    body = prism([(-7.0, 0.35), (6.85, 0.35), (7.0, 0.9), (6.75, 3.6), (6.4, 4.0), (-6.8, 4.0), (-7.0, 3.7)], 1.3, 0.97)
    windows = [pane(-6.6, 5.6, 1.29, s, 2.0, 3.45) for s in (-1, 1)]
    screen = decal([(6.96, -1.15, 1.5), (6.96, 1.15, 1.5), (6.79, 1.15, 3.4), (6.79, -1.15, 3.4)])
    return [
        BodyPart(body, ClassId.BUS, Paint.BODY),
        *each([*windows, screen, pane(5.75, 6.6, 1.3, -1, 0.55, 3.0)], ClassId.BUS, Paint.GLASS),
        BodyPart(plate(-7.0, 0.0, 2.9, 1.0, 0.5, -1), ClassId.BUS, Paint.GLASS),
        *each([wheel(x, y, 0.52, 0.34, 8) for x in (-4.6, -3.3, 4.2) for y in (-1.12, 1.12)], ClassId.BUS, Paint.TYRE),
        *each([plate(7.0, 0.95 * s, 0.8, 0.2, 0.1, 1) for s in (-1, 1)], ClassId.BUS, Paint.HEADLIGHT),
        *each([plate(-7.0, 1.05 * s, 1.2, 0.12, 0.25, -1) for s in (-1, 1)], ClassId.BUS, Paint.TAILLIGHT),
        *turn_lamps(ClassId.BUS, (7.0, 1.2, 0.8), (-7.0, 1.05, 0.85)),
    ]


def bus_front() -> list[BodyPart]:
    """The first half of an articulated bus, 9 x 2.5 x 3.3 m: its middle joint is behind it."""
    windows = [pane(-3.6, 3.8, 1.25, 1, 1.35, 2.7), pane(-1.9, 2.0, 1.25, -1, 1.35, 2.7)]
    doors = [pane(2.4, 3.8, 1.25, -1, 0.45, 2.7), pane(-3.6, -2.2, 1.25, -1, 0.45, 2.7)]
    return [
        BodyPart(box((-4.0, -1.25, 0.3), (4.5, 1.25, 3.3)), ClassId.BUS, Paint.BUS),
        BodyPart(box((-4.5, -1.1, 0.4), (-4.0, 1.1, 3.15)), ClassId.BUS, Paint.DARK),
        *each([*windows, *doors, plate(4.5, 0.0, 2.0, 1.12, 0.8, 1)], ClassId.BUS, Paint.GLASS),
        BodyPart(plate(4.5, 0.0, 3.05, 0.8, 0.15, 1), ClassId.BUS, Paint.HEADLIGHT),
        *each([wheel(x, y, 0.5, 0.3, 6) for x in (-2.6, 2.0) for y in (-1.09, 1.09)], ClassId.BUS, Paint.TYRE),
        *turn_lamps(ClassId.BUS, (4.5, 1.1, 0.8), (-4.0, 1.1, 0.8)),
    ]


def bus_rear() -> list[BodyPart]:
    """The last piece of an articulated bus, 9 x 2.5 x 3.3 m: its middle joint is before it."""
    windows = [pane(-4.1, 3.6, 1.25, 1, 1.35, 2.7), pane(-4.1, 0.2, 1.25, -1, 1.35, 2.7)]
    return [
        BodyPart(box((-4.5, -1.25, 0.3), (4.0, 1.25, 3.3)), ClassId.BUS, Paint.BUS),
        BodyPart(box((4.0, -1.1, 0.4), (4.5, 1.1, 3.15)), ClassId.BUS, Paint.DARK),
        *each([*windows, pane(0.6, 2.0, 1.25, -1, 0.45, 2.7)], ClassId.BUS, Paint.GLASS),
        BodyPart(plate(-4.5, 0.0, 2.3, 0.95, 0.45, -1), ClassId.BUS, Paint.GLASS),
        *each([wheel(-1.4, y, 0.5, 0.3, 6) for y in (-1.09, 1.09)], ClassId.BUS, Paint.TYRE),
        *each([plate(-4.5, 1.05 * s, 1.0, 0.12, 0.25, -1) for s in (-1, 1)], ClassId.BUS, Paint.TAILLIGHT),
        *turn_lamps(ClassId.BUS, (4.0, 1.1, 0.8), (-4.5, 1.05, 0.6)),
    ]


def tractor() -> list[BodyPart]:
    """The tractor of an articulated lorry, 5.9 x 2.5 x 3.8 m: a high cab on a bare frame."""
    cab = prism([(0.55, 0.5), (2.85, 0.5), (2.95, 1.0), (2.85, 2.6), (2.3, 3.8), (0.55, 3.8)], 1.25, 0.95)
    screen = decal([(2.9, -1.05, 1.75), (2.9, 1.05, 1.75), (2.83, 1.0, 2.65), (2.83, -1.0, 2.65)])
    lights = [plate(2.93, 0.9 * s, 0.75, 0.2, 0.1, 1) for s in (-1, 1)]
    wheels = [wheel(x, y, 0.5, 0.32, 8) for x in (-1.6, 1.9) for y in (-1.09, 1.09)]
    return [
        BodyPart(cab, ClassId.TRUCK, Paint.BODY),
        BodyPart(box((-2.95, -0.45, 0.5), (2.6, 0.45, 0.95)), ClassId.TRUCK, Paint.DARK),
        *each([screen, *(pane(1.4, 2.6, 1.24, s, 1.7, 2.5) for s in (-1, 1))], ClassId.TRUCK, Paint.GLASS),
        *each(wheels, ClassId.TRUCK, Paint.TYRE),
        *each(lights, ClassId.TRUCK, Paint.HEADLIGHT),
        *turn_lamps(ClassId.TRUCK, (2.93, 1.15, 0.6), (-2.95, 0.4, 0.7)),
    ]


def trailer() -> list[BodyPart]:
    """A box trailer with three axles at its rear, 10.6 x 2.55 x 4.0 m."""
    wheels = [wheel(x, y, 0.5, 0.34, 8) for x in (-4.0, -2.8, -1.6) for y in (-1.09, 1.09)]
    return [
        BodyPart(box((-5.3, -1.27, 1.1), (5.3, 1.27, 4.0)), ClassId.TRUCK, Paint.CARGO),
        BodyPart(box((-5.2, -0.6, 0.7), (3.4, 0.6, 1.12)), ClassId.TRUCK, Paint.DARK),
        *each([box((2.2, y - 0.08, 0.25), (2.4, y + 0.08, 0.8)) for y in (-0.5, 0.5)], ClassId.TRUCK, Paint.DARK),
        *each(wheels, ClassId.TRUCK, Paint.TYRE),
        *each([plate(-5.2, 0.35 * s, 0.9, 0.2, 0.08, -1) for s in (-1, 1)], ClassId.TRUCK, Paint.TAILLIGHT),
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
        *each([pane(-3.8, 3.8, 1.2, s, 1.3, 2.65) for s in (-1, 1)], ClassId.TRAIN, Paint.GLASS),
    ]


def _tram_end(nose: int) -> list[BodyPart]:
    profile = [(-4.2, 0.35), (4.4, 0.35), (4.5, 1.2), (3.7, 3.1), (3.4, 3.4), (-4.2, 3.4)]
    across = [(4.5, -1.0, 1.4), (4.5, 1.0, 1.4), (3.83, 1.0, 2.85), (3.83, -1.0, 2.85)]
    if nose < 0:  # turned by half a circle about the vertical: x and y change their signs
        across = [(-x, -y, z) for x, y, z in across]
    x0, x1 = sorted((nose * -3.8, nose * 3.3))
    lamps = [plate(nose * 4.47, 0.8 * s, 0.85, 0.14, 0.1, nose) for s in (-1, 1)]
    return [
        BodyPart(prism([(nose * x, z) for x, z in profile], 1.2), ClassId.TRAIN, Paint.TRAM),
        *each([_bellows(nose * -4.35), box((-1.2, -0.9, 0.0), (1.2, 0.9, 0.4))], ClassId.TRAIN, Paint.DARK),
        *each([decal(across), *(pane(x0, x1, 1.2, s, 1.3, 2.65) for s in (-1, 1))], ClassId.TRAIN, Paint.GLASS),
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
