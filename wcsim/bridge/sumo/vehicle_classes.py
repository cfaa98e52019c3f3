"""SUMO's vehicle classes as our kinds and looks; a class or a size that nobody thought of is no error."""

from __future__ import annotations

import math

from wcsim.types import ActorKind, ActorLook

KIND_OF_CLASS = {
    "private": ActorKind.CAR,
    "passenger": ActorKind.CAR,
    "taxi": ActorKind.CAR,
    "evehicle": ActorKind.CAR,
    "hov": ActorKind.CAR,
    "vip": ActorKind.CAR,
    "authority": ActorKind.CAR,
    "army": ActorKind.CAR,
    "emergency": ActorKind.CAR,
    "custom1": ActorKind.CAR,
    "custom2": ActorKind.CAR,
    "ignoring": ActorKind.CAR,
    "delivery": ActorKind.TRUCK,
    "truck": ActorKind.TRUCK,
    "trailer": ActorKind.TRUCK,
    "bus": ActorKind.BUS,
    "coach": ActorKind.BUS,
    "tram": ActorKind.TRAM,
    "rail_urban": ActorKind.TRAM,
    "rail": ActorKind.TRAM,
    "rail_electric": ActorKind.TRAM,
    "rail_fast": ActorKind.TRAM,
    "subway": ActorKind.TRAM,
    "motorcycle": ActorKind.MOTORCYCLE,
    "moped": ActorKind.MOTORCYCLE,
    "bicycle": ActorKind.BICYCLE,
    "scooter": ActorKind.SCOOTER,
    "pedestrian": ActorKind.PEDESTRIAN,
    "wheelchair": ActorKind.WHEELCHAIR,
    "container": ActorKind.OTHER,
    "ship": ActorKind.OTHER,
    "cable_car": ActorKind.OTHER,
    "aircraft": ActorKind.OTHER,
    "drone": ActorKind.OTHER,
}
"""SUMO's vClass to our kind; a class that is not listed becomes OTHER, a box of SUMO's own length, width and height.

SUMO reads a class name that it does not know as "ignoring", and draws and moves it like a car.
"""

_LOOK_OF_CLASS = {
    "taxi": ActorLook.TAXI,
    "authority": ActorLook.POLICE,
    "emergency": ActorLook.AMBULANCE,
    "delivery": ActorLook.VAN,
    "coach": ActorLook.COACH,
    "moped": ActorLook.MOPED,
}
_VAN_FROM_M = 2.0  # height from which on what drives like a car is a van

# What SUMO's numbers are held to: PyBullet and the renderers need a box, and SUMO lets anybody write anything.
LEAST_M, MOST_M, _UNKNOWN_M = 0.1, 400.0, 1.0


def kind_and_look(vehicle_class: str, size_lwh_m: tuple[float, float, float]) -> tuple[ActorKind, ActorLook]:
    """What something of SUMO's class and size is, and how it looks.

    >>> kind_and_look("taxi", (4.5, 1.8, 1.5))
    (<ActorKind.CAR: 'car'>, <ActorLook.TAXI: 'taxi'>)
    >>> kind_and_look("hovercraft", (4.5, 1.8, 1.5))[0]
    <ActorKind.OTHER: 'other'>
    """
    kind = KIND_OF_CLASS.get(vehicle_class, ActorKind.OTHER)
    look = _LOOK_OF_CLASS.get(vehicle_class, ActorLook.USUAL)
    low = size_lwh_m[2] < _VAN_FROM_M
    if look is ActorLook.AMBULANCE:
        return (ActorKind.CAR, ActorLook.POLICE) if low else (ActorKind.TRUCK, look)
    if kind is ActorKind.CAR and look is ActorLook.USUAL and not low:
        return (ActorKind.TRUCK, look) if vehicle_class == "army" else (kind, ActorLook.VAN)
    return kind, look


def sane_size(length_m: float, width_m: float, height_m: float) -> tuple[float, float, float]:
    """A size that a box can have: every side finite and between 0.1 and 400 m.

    >>> sane_size(float("nan"), 0.0, 1.5)
    (1.0, 0.1, 1.5)
    """
    return (_side(length_m), _side(width_m), _side(height_m))


def _side(side_m: float) -> float:
    return min(max(float(side_m), LEAST_M), MOST_M) if math.isfinite(side_m) else _UNKNOWN_M
