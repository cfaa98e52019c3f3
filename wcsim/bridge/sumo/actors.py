"""Reads from SUMO who is near a wheelchair and how the traffic lights there stand.

The place of who is far away is read again only when it could be near by then, and that of those
who have departed at once. The session hands libsumo in: `bridge/sumo/session.py` stays the only
file that loads it.

SUMO's vehicle classes become our kinds and looks; an unknown class or an odd size is no error.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from wcsim.core import frames
from wcsim.types import F64, ActorKind, ActorLook, ActorState, SignalState

_CLASSES_OF_KIND = {
    ActorKind.CAR: "private passenger taxi evehicle hov vip authority army emergency custom1"
    " custom2 ignoring",
    ActorKind.TRUCK: "delivery truck trailer",
    ActorKind.BUS: "bus coach",
    ActorKind.TRAM: "tram rail_urban rail rail_electric rail_fast subway",
    ActorKind.MOTORCYCLE: "motorcycle moped",
    ActorKind.BICYCLE: "bicycle",
    ActorKind.SCOOTER: "scooter",
    ActorKind.PEDESTRIAN: "pedestrian",
    ActorKind.WHEELCHAIR: "wheelchair",
    ActorKind.OTHER: "container ship cable_car aircraft drone",
}
KIND_OF_CLASS = {name: kind for kind, names in _CLASSES_OF_KIND.items() for name in names.split()}
"""SUMO's vClass to our kind.

A class that is not listed becomes OTHER, a box of SUMO's own length, width and height. SUMO reads a
class name that it does not know as "ignoring", and draws and moves it like a car.
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

# Bounds of SUMO's numbers: PyBullet and the renderers need a box, and SUMO accepts any number.
_LEAST_M, _MOST_M, _UNKNOWN_M = 0.1, 400.0, 1.0

# No actor and no chair together approach faster, but for a jump; people ride.
_FASTEST_MPS = {"v:": 70.0, "p:": 35.0}
_MOVED_M = 1.5  # a chair that is so far from where it was at the last look has been put there
_LONGEST_WAIT = 100  # steps
Place = tuple[float, float, float]
# Of longer ones, from a van on, the rear may be near while the front, SUMO's place, is far.
LONG_M = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Body:
    """What does not change during an actor's life."""

    kind: ActorKind
    look: ActorLook
    size_lwh_m: tuple[float, float, float]


class ActorReader:
    """Finds the actors near the wheelchairs of one simulation."""

    def __init__(self, libsumo: Any, origin_m: tuple[float, float, float], step_s: float) -> None:
        self._api = libsumo
        self._origin = origin_m
        self._closing_m = {kind: mps * step_s for kind, mps in _FASTEST_MPS.items()}
        self.forget()

    def forget(self) -> None:
        """SUMO was loaded anew."""
        self._bodies: dict[str, _Body] = {}
        self._measured: set[str] = set()
        self._long_m: dict[str, float] = {}
        # By kind: whose place is read next at which step; none before a look.
        self._due: dict[str, dict[int, list[str]]] = {}
        # Everybody after this step, by kind, once there was a look at all.
        self._all: dict[str, tuple[list[str], F64]] = {}
        self._from_W_m, self._within_m = np.zeros((0, 2)), 0.0
        self._step, self._looked_at, self._unsure = 0, -1, False

    def forget_actor(self, actor_id: str) -> None:
        """Somebody was taken out of the street between two steps."""
        self._all.pop(actor_id[:2], None)

    def stepped(self, vehicles: Iterable[str], people: Iterable[str], unsure: bool) -> None:
        """SUMO has made a step in which these departed; if `unsure`, others may have jumped."""
        self._step += 1
        self._unsure |= unsure
        self._all.clear()
        self._measure(vehicles)
        for kind, names in (("v:", vehicles), ("p:", people)):
            if kind in self._due and names:
                self._due[kind].setdefault(self._step, []).extend(names)

    def near(self, near_W_m: F64, radius_m: float) -> tuple[ActorState, ...]:
        """Every vehicle and person within `radius_m` of any of the points (n, 2), sorted by id.

        By SUMO's place, the front; of who is longer than `LONG_M` any part may be so near. Who
        rides in a vehicle is not in the street: SUMO lists riders as persons at its front bumper.
        """
        if not len(near_W_m):
            return ()
        # Other places, a jump, or a second look in one step: the lists of who is due are used up or
        # wrong.
        elsewhere = moved(near_W_m, self._from_W_m, _MOVED_M) or radius_m != self._within_m
        if elsewhere or self._unsure or self._looked_at == self._step:
            self._due, self._unsure = {}, False
        self._from_W_m, self._within_m, self._looked_at = near_W_m.copy(), radius_m, self._step
        # People first: "p:" comes before "v:", so the two sorted parts are sorted as a whole.
        people = self._found("p:", self._api.person, near_W_m, radius_m)
        vehicles = self._found("v:", self._api.vehicle, near_W_m, radius_m)
        return self._states(people, vehicles)

    def at(self, near_W_m: F64, radius_m: float) -> tuple[ActorState, ...]:
        """The same for a single look at another place."""
        people = self._within("p:", self._api.person, near_W_m, radius_m)
        vehicles = self._within("v:", self._api.vehicle, near_W_m, radius_m)
        return self._states(people, vehicles)

    def _found(
        self, kind: str, domain: Any, near_W_m: F64, radius_m: float
    ) -> list[tuple[str, Place]]:
        """Names and front places in W of a domain's members near the points, sorted by name."""
        due = self._due.get(kind)
        if due is None:
            due = self._due[kind] = {self._step: list(domain.getIDList())}
            self._tidy(kind, due[self._step])
        ox, oy, oz = self._origin
        chairs = [(x + ox, y + oy) for x, y in near_W_m[:, :2].tolist()]
        steps = [step for step in due if step <= self._step]
        names = [name for step in steps for name in due.pop(step)]
        found, soon, closing_m, place_of = [], [], self._closing_m[kind], domain.getPosition3D
        # A name may stand in the lists of two steps: its place is read once, in their order.
        for name in dict.fromkeys(names):
            try:
                x, y, z = place_of(name)
            except self._api.TraCIException:
                self._bodies.pop(kind + name, None)
                continue
            # No place for now: people who jump from street to street are nowhere between them.
            except ValueError:
                soon.append(name)
                continue
            gap_m = min([math.hypot(x - cx, y - cy) for cx, cy in chairs]) - radius_m
            if self._long_m and kind == "v:":
                gap_m -= self._long_m.get(name, 0.0)
            if gap_m <= 0.0:
                found.append((name, (x - ox, y - oy, z - oz)))
            # It cannot be here sooner than at the fastest speed, so its place is not read before.
            if gap_m < 2.0 * closing_m:
                soon.append(name)
            else:
                wait = min(int(gap_m / closing_m), _LONGEST_WAIT)
                due.setdefault(self._step + wait, []).append(name)
        due.setdefault(self._step + 1, []).extend(soon)
        found.sort()
        return found

    def _within(
        self, kind: str, domain: Any, near_W_m: F64, radius_m: float
    ) -> list[tuple[str, Place]]:
        """The same, from a look at everybody that is made once a step."""
        if kind not in self._all:
            names = list(domain.getIDList())
            self._tidy(kind, names)
            there = {name: place for name in names if len(place := domain.getPosition3D(name)) == 3}
            places = np.array(list(there.values()), np.float64).reshape(-1, 3)
            self._all[kind] = list(there), np.asarray(places - self._origin, np.float64)
        names, p_W_m = self._all[kind]
        if not names:
            return []
        gap_m = np.sqrt(((p_W_m[:, None, :2] - near_W_m[None, :, :2]) ** 2).sum(-1).min(1))
        if self._long_m and kind == "v:":
            gap_m -= [self._long_m.get(name, 0.0) for name in names]
        close = np.flatnonzero(gap_m <= radius_m)
        return sorted((names[i], tuple(p_W_m[i].tolist())) for i in close)

    def _measure(self, vehicles: Iterable[str]) -> None:
        """Find the long ones among vehicles that are new here."""
        for name in vehicles:
            self._measured.add(name)
            try:
                length_m = self._api.vehicle.getLength(name)
            # It has left again in the step in which it departed.
            except self._api.TraCIException:
                continue
            if length_m > LONG_M:
                self._long_m[name] = length_m

    def _tidy(self, kind: str, names: list[str]) -> None:
        """Forget who has left, and measure who was there before the first step."""
        there = set(names)
        for key in [key for key in self._bodies if key[:2] == kind and key[2:] not in there]:
            del self._bodies[key]
        if kind == "v:":
            self._measure(there - self._measured)
            self._measured &= there
            for name in self._long_m.keys() - there:
                del self._long_m[name]

    def _states(
        self, people: list[tuple[str, Place]], vehicles: list[tuple[str, Place]]
    ) -> tuple[ActorState, ...]:
        found = []
        person, vehicle = self._api.person, self._api.vehicle
        for name, front_W_m in people:
            if person.getVehicle(name):
                continue
            body = self._body("p:" + name, person, name)
            yaw_rad = frames.yaw_from_sumo(person.getAngle(name))
            speed_mps = person.getSpeed(name)
            found.append(_state("p:" + name, body, front_W_m, yaw_rad, 0.0, speed_mps))
        for name, front_W_m in vehicles:
            body = self._body("v:" + name, vehicle, name)
            yaw_rad = frames.yaw_from_sumo(vehicle.getAngle(name))
            pose = front_W_m, yaw_rad, frames.deg2rad(vehicle.getSlope(name))
            speed_mps, signals = vehicle.getSpeed(name), vehicle.getSignals(name)
            found.append(_state("v:" + name, body, *pose, speed_mps, signals))
        return tuple(found)

    def _body(self, key: str, domain: Any, name: str) -> _Body:
        body = self._bodies.get(key)
        if body is None:
            size = _sane_size(domain.getLength(name), domain.getWidth(name), domain.getHeight(name))
            vehicle_class = domain.getVehicleClass(name)
            # Maps open no way for SUMO's class of e-scooters: they are bicycles of another shape.
            if vehicle_class == "bicycle" and domain.getShapeClass(name) == "scooter":
                vehicle_class = "scooter"
            kind, look = _kind_and_look(vehicle_class, size)
            body = self._bodies[key] = _Body(kind=kind, look=look, size_lwh_m=size)
        return body


class SignalReader:
    """The traffic lights near the wheelchairs of one simulation."""

    def __init__(self, libsumo: Any, origin_m: tuple[float, float]) -> None:
        self._api = libsumo
        # By id, as SUMO lists them in an order of its own.
        self._names: list[str] = sorted(libsumo.trafficlight.getIDList())
        # West, south, east, north of each one's stop lines, net coordinates.
        boxes = []
        for name in self._names:
            lanes = set(libsumo.trafficlight.getControlledLanes(name))
            ends = [libsumo.lane.getShape(lane)[-1] for lane in lanes if lane]
            xs, ys = [end[0] for end in ends], [end[1] for end in ends]
            # One that controls nothing with a place is near everybody.
            everywhere = -math.inf, -math.inf, math.inf, math.inf
            boxes.append((min(xs), min(ys), max(xs), max(ys)) if ends else everywhere)
        self._boxes_W_m = np.array(boxes).reshape(-1, 4) - np.array([*origin_m, *origin_m])
        self._last: dict[str, SignalState] = {}
        self._close: list[str] = []
        self._from_W_m, self._within_m = np.zeros((0, 2)), 0.0

    def near(self, near_W_m: F64, radius_m: float) -> tuple[SignalState, ...]:
        """Traffic lights with a stop line near any of the points (n, 2), sorted by id.

        Near is within `radius_m`, or a little more.
        """
        if moved(near_W_m, self._from_W_m, _MOVED_M) or radius_m != self._within_m:
            self._from_W_m, self._within_m = near_W_m.copy(), radius_m
            points = near_W_m[:, None, :2]
            low, high = self._boxes_W_m[:, :2], self._boxes_W_m[:, 2:]
            out_m = np.maximum(np.maximum(low - points, points - high), 0.0)
            # A little farther than needed: the list holds until a chair has moved by `_MOVED_M`.
            close = ((out_m**2).sum(-1) <= (radius_m + 2.0 * _MOVED_M) ** 2).any(axis=0)
            self._close = [self._names[i] for i in np.flatnonzero(close)]
        return tuple(self._state(name) for name in self._close)

    def _state(self, name: str) -> SignalState:
        colours, known = self._api.trafficlight.getRedYellowGreenState(name), self._last.get(name)
        if known is None or known.colours != colours:
            known = self._last[name] = SignalState(tls_id=name, colours=colours)
        return known


def moved(now_W_m: F64, before_W_m: F64, by_m: float) -> bool:
    """Whether the places (n, 2) are others, or one has moved by more than `by_m` along an axis."""
    return now_W_m.shape != before_W_m.shape or bool((np.abs(now_W_m - before_W_m) > by_m).any())


def _kind_and_look(
    vehicle_class: str, size_lwh_m: tuple[float, float, float]
) -> tuple[ActorKind, ActorLook]:
    """What something of SUMO's class and size is, and how it looks.

    >>> _kind_and_look("taxi", (4.5, 1.8, 1.5))
    (<ActorKind.CAR: 'car'>, <ActorLook.TAXI: 'taxi'>)
    >>> _kind_and_look("hovercraft", (4.5, 1.8, 1.5))[0]
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


def _sane_size(length_m: float, width_m: float, height_m: float) -> tuple[float, float, float]:
    """A size that a box can have: every side finite and between 0.1 and 400 m.

    >>> _sane_size(float("nan"), 0.0, 1.5)
    (1.0, 0.1, 1.5)
    """
    return _sane_side(length_m), _sane_side(width_m), _sane_side(height_m)


def _sane_side(side_m: float) -> float:
    return min(max(float(side_m), _LEAST_M), _MOST_M) if math.isfinite(side_m) else _UNKNOWN_M


def _state(
    actor_id: str,
    body: _Body,
    front_W_m: Place,
    yaw_rad: float,
    pitch_rad: float,
    speed_mps: float,
    signals: int = 0,
) -> ActorState:
    """The inverse of `frames.front_from_centre`, in plain numbers: it is fast."""
    flat = math.cos(pitch_rad)
    ahead_x, ahead_y = flat * math.cos(yaw_rad), flat * math.sin(yaw_rad)
    ahead_z = math.sin(pitch_rad)
    x, y, z = front_W_m
    half_m = 0.5 * body.size_lwh_m[0]
    return ActorState(
        id=actor_id,
        kind=body.kind,
        p_W_m=np.array((x - half_m * ahead_x, y - half_m * ahead_y, z - half_m * ahead_z)),
        yaw_rad=yaw_rad,
        pitch_rad=pitch_rad,
        v_W_mps=np.array((speed_mps * ahead_x, speed_mps * ahead_y, speed_mps * ahead_z)),
        size_lwh_m=body.size_lwh_m,
        signals=signals,
        look=body.look,
    )
