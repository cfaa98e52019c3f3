"""Reads from SUMO who is near a wheelchair and how the traffic lights there stand.

Every vehicle and person of the town is asked for its place only every few steps; in between, only those that could have
come near since then, and those who have departed. The session hands libsumo in: `bridge/sumo.py` stays the only file
that loads it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from wcsim import frames
from wcsim.bridge.classes import kind_and_look, sane_size
from wcsim.types import F64, ActorKind, ActorLook, ActorState, SignalState

SCAN_EVERY = 5  # steps from one look at the whole town to the next
FASTEST_MPS = {"v:": 60.0, "p:": 25.0}  # nobody comes nearer faster, but for a teleport; people may sit in a bus
MOVED_M = 5.0  # who asks from somewhere else than last time gets a new look at the whole town
Place = tuple[float, float, float]
LONG_M = 20.0  # longer vehicles' rears may be near while their fronts are far


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
        self._margin_m = {kind: (SCAN_EVERY + 1) * step_s * mps + MOVED_M for kind, mps in FASTEST_MPS.items()}
        self.forget()

    def forget(self) -> None:
        """SUMO was loaded anew."""
        self._bodies: dict[str, _Body] = {}
        self._long_m: dict[str, float] = {}
        self._asked: dict[str, dict[str, None]] = {}  # who may be near by now, by kind; empty before a look at all
        self._all: dict[str, tuple[list[str], F64]] = {}  # everybody after this step, by kind, once somebody has asked
        self._from_W_m, self._within_m = np.zeros((0, 2)), 0.0
        self._steps_left = 0

    def stepped(self, vehicles: Iterable[str], people: Iterable[str], unsure: bool) -> None:
        """SUMO has made a step in which these departed; `unsure`: others may have jumped, so all are looked at."""
        self._steps_left = 0 if unsure else self._steps_left - 1
        self._all.clear()
        for name in vehicles:
            length_m = self._api.vehicle.getLength(name)
            if length_m > LONG_M:
                self._long_m[name] = length_m
        for kind, names in (("v:", vehicles), ("p:", people)):
            if kind in self._asked:
                self._asked[kind].update(dict.fromkeys(names))

    def near(self, near_W_m: F64, radius_m: float) -> tuple[ActorState, ...]:
        """Every vehicle and person within `radius_m` of any of the points (n, 2), sorted by id.

        Who rides in a vehicle is not in the street: SUMO lists riders as persons at the vehicle's front bumper.
        """
        if not len(near_W_m):
            return ()
        moved = near_W_m.shape != self._from_W_m.shape or bool((np.abs(near_W_m - self._from_W_m) > MOVED_M).any())
        if moved or self._steps_left <= 0 or radius_m > self._within_m:
            self._from_W_m, self._within_m, self._steps_left = near_W_m.copy(), radius_m, SCAN_EVERY
            self._asked = {}
        people = self._found("p:", self._api.person, near_W_m, radius_m)
        return self._states(people, "p:") + self._states(self._found("v:", self._api.vehicle, near_W_m, radius_m), "v:")

    def at(self, near_W_m: F64, radius_m: float) -> tuple[ActorState, ...]:
        """The same for a question asked once, about another place."""
        kept = self._asked, self._from_W_m, self._within_m, self._steps_left
        self._steps_left = 0
        found = self.near(near_W_m, radius_m)
        self._asked, self._from_W_m, self._within_m, self._steps_left = kept
        return found

    def _found(self, kind: str, domain: Any, near_W_m: F64, radius_m: float) -> list[tuple[str, Place]]:
        """Names and front places in W of a domain's members near the points, sorted by name."""
        asked = self._asked.get(kind)
        if asked is not None:
            return self._among(asked, domain, near_W_m, radius_m)
        names, p_W_m = self._everyone(kind, domain)
        if not names:
            self._asked[kind] = {}
            return []
        gap2 = ((p_W_m[:, None, :2] - near_W_m[None, :, :2]) ** 2).sum(-1).min(1)
        reach_m = np.full(len(names), radius_m)
        if self._long_m and kind == "v:":
            reach_m += [self._long_m.get(name, 0.0) for name in names]
        within = np.flatnonzero(gap2 <= (reach_m + self._margin_m[kind]) ** 2)
        self._asked[kind] = {names[i]: None for i in within}
        return sorted((names[i], tuple(p_W_m[i].tolist())) for i in np.flatnonzero(gap2 <= reach_m * reach_m))

    def _among(
        self, asked: dict[str, None], domain: Any, near_W_m: F64, radius_m: float
    ) -> list[tuple[str, Place]]:
        """The same among a few names, without arrays; who has left is struck from them."""
        ox, oy, oz = self._origin
        chairs = [(x + ox, y + oy) for x, y in near_W_m[:, :2].tolist()]
        found, gone = [], []
        for name in asked:
            try:
                x, y, z = domain.getPosition3D(name)
            except self._api.TraCIException:
                gone.append(name)
                continue
            reach_m = radius_m + self._long_m.get(name, 0.0)
            reach2 = reach_m * reach_m
            if any((x - cx) * (x - cx) + (y - cy) * (y - cy) <= reach2 for cx, cy in chairs):
                found.append((name, (x - ox, y - oy, z - oz)))
        for name in gone:
            del asked[name]
        found.sort()
        return found

    def _everyone(self, kind: str, domain: Any) -> tuple[list[str], F64]:
        if kind not in self._all:
            names = list(domain.getIDList())
            places = np.array([domain.getPosition3D(name) for name in names], np.float64).reshape(-1, 3)
            self._all[kind] = names, np.asarray(places - self._origin, np.float64)
        return self._all[kind]

    def _states(self, found: list[tuple[str, Place]], prefix: str) -> tuple[ActorState, ...]:
        if prefix == "p:":
            person = self._api.person
            return tuple(self._person(name, p) for name, p in found if not person.getVehicle(name))
        return tuple(self._vehicle(name, p) for name, p in found)

    def _vehicle(self, name: str, front_W_m: Place) -> ActorState:
        vehicle = self._api.vehicle
        body = self._body("v:" + name, vehicle, name)
        yaw_rad, pitch_rad = frames.yaw_from_sumo(vehicle.getAngle(name)), frames.rad(vehicle.getSlope(name))
        speed_mps, signals = vehicle.getSpeed(name), vehicle.getSignals(name)
        return _state("v:" + name, body, front_W_m, yaw_rad, pitch_rad, speed_mps, signals)

    def _person(self, name: str, front_W_m: Place) -> ActorState:
        person = self._api.person
        body = self._body("p:" + name, person, name)
        yaw_rad = frames.yaw_from_sumo(person.getAngle(name))
        return _state("p:" + name, body, front_W_m, yaw_rad, 0.0, person.getSpeed(name))

    def _body(self, key: str, domain: Any, name: str) -> _Body:
        body = self._bodies.get(key)
        if body is None:
            size = sane_size(domain.getLength(name), domain.getWidth(name), domain.getHeight(name))
            kind, look = kind_and_look(domain.getVehicleClass(name), size)
            body = self._bodies[key] = _Body(kind=kind, look=look, size_lwh_m=size)
        return body


class SignalReader:
    """The traffic lights near the wheelchairs of one simulation."""

    def __init__(self, libsumo: Any, origin_m: tuple[float, float]) -> None:
        self._api = libsumo
        self._names: list[str] = sorted(libsumo.trafficlight.getIDList())
        boxes = [_box(libsumo, name) for name in self._names]
        self._boxes_W_m = np.array(boxes).reshape(-1, 4) - np.array([*origin_m, *origin_m])
        self._last: dict[str, SignalState] = {}
        self._close: list[str] = []
        self._from_W_m = np.zeros((0, 2))

    def near(self, near_W_m: F64, radius_m: float) -> tuple[SignalState, ...]:
        """Traffic lights with a stop line within `radius_m`, or a little more, of any of the points (n, 2), by id."""
        if near_W_m.shape != self._from_W_m.shape or (np.abs(near_W_m - self._from_W_m) > MOVED_M).any():
            self._from_W_m = near_W_m.copy()
            points = near_W_m[:, None, :2]
            out_m = np.maximum(np.maximum(self._boxes_W_m[:, :2] - points, points - self._boxes_W_m[:, 2:]), 0.0)
            close = ((out_m**2).sum(-1) <= (radius_m + 2.0 * MOVED_M) ** 2).any(axis=0)
            self._close = [self._names[i] for i in np.flatnonzero(close)]
        return tuple(self._state(name) for name in self._close)

    def _state(self, name: str) -> SignalState:
        colours, known = self._api.trafficlight.getRedYellowGreenState(name), self._last.get(name)
        if known is None or known.colours != colours:
            known = self._last[name] = SignalState(tls_id=name, colours=colours)
        return known


def _box(libsumo: Any, tls_id: str) -> tuple[float, float, float, float]:
    """West, south, east, north of a traffic light's stop lines, net coordinates."""
    ends = [libsumo.lane.getShape(lane)[-1] for lane in set(libsumo.trafficlight.getControlledLanes(tls_id)) if lane]
    if not ends:
        return (-math.inf, -math.inf, math.inf, math.inf)  # it controls nothing that has a place: near everybody
    xs, ys = [end[0] for end in ends], [end[1] for end in ends]
    return min(xs), min(ys), max(xs), max(ys)


def _state(
    actor_id: str, body: _Body, front_W_m: Place, yaw_rad: float, pitch_rad: float, speed_mps: float, signals: int = 0
) -> ActorState:
    """As `frames.centre_from_front` and `frames.forward`, in plain numbers: runs for everybody near in every tick."""
    flat = math.cos(pitch_rad)
    ahead_x, ahead_y, ahead_z = flat * math.cos(yaw_rad), flat * math.sin(yaw_rad), math.sin(pitch_rad)
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
