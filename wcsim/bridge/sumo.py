"""SUMO inside this process: the only file that speaks to libsumo.

libsumo holds one simulation a process; a second `start` silently resets the first one, so a session refuses to start
while another one is loaded. Whole-world reset is one drain step, then `libsumo.load` (bit-identical; `loadState` is
not). Nothing but `ActorState` and `SignalState` leaves this file.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import libsumo
import numpy as np

from wcsim import frames
from wcsim.errors import SumoError, WorldInUseError
from wcsim.types import F64, ActorKind, ActorState, SignalState

log = logging.getLogger("wcsim.bridge.sumo")

KIND_OF_CLASS = {
    "private": ActorKind.CAR,
    "passenger": ActorKind.CAR,
    "taxi": ActorKind.CAR,
    "evehicle": ActorKind.CAR,
    "hov": ActorKind.CAR,
    "vip": ActorKind.CAR,
    "authority": ActorKind.CAR,
    "army": ActorKind.TRUCK,
    "emergency": ActorKind.TRUCK,
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
}
"""SUMO's vClass to our kind; a class that is not listed becomes OTHER, a box of SUMO's own length, width and height."""


def world_in_this_process() -> bool:
    """Whether a SUMO simulation is loaded in this process."""
    return bool(libsumo.isLoaded())


def refuse_second_world() -> None:
    """Raise WorldInUseError while a simulation is loaded in this process."""
    if world_in_this_process():
        raise WorldInUseError(
            "this process holds a SUMO world already, and libsumo allows one a process; "
            "close it first, or put this world in a process of its own (wcsim.server.process_link)"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SumoOptions:
    """What a world overrides of a scenario's own options."""

    sumocfg: Path
    origin_m: tuple[float, float]
    step_s: float
    seed: int
    demand_scale: float
    jam_teleport_s: float

    def arguments(self) -> list[str]:
        """The command line for libsumo; the scenario's own configuration comes first and is overridden by the rest."""
        return [
            "sumo",
            *("--configuration-file", str(self.sumocfg)),
            *("--step-length", repr(self.step_s)),
            *("--seed", str(self.seed)),
            *("--scale", repr(self.demand_scale)),
            *("--time-to-teleport", repr(self.jam_teleport_s)),
            *("--no-step-log", "true"),
            *("--no-warnings", "true"),
            *("--duration-log.disable", "true"),
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Body:
    """What does not change during an actor's life."""

    kind: ActorKind
    size_lwh_m: tuple[float, float, float]


class SumoSession:
    """The one SUMO simulation of this process."""

    def __init__(self, options: SumoOptions) -> None:
        """Start SUMO. Raises WorldInUseError while another session lives in this process, SumoError when it fails."""
        refuse_second_world()
        self._options = options
        self._bodies: dict[str, _Body] = {}
        self._teleports = 0
        self._open = True
        self._guarded(lambda: libsumo.start(options.arguments()))

    @property
    def teleports(self) -> int:
        """Vehicles that SUMO took out of a jam during the last step."""
        return self._teleports

    def step(self) -> None:
        """Advance SUMO by one step and log jams that it dissolved."""
        self._guarded(libsumo.simulationStep)
        jammed = libsumo.simulation.getStartingTeleportIDList()
        self._teleports = len(jammed)
        for name in sorted(jammed):
            log.warning("jam: %s stood for %g s and was teleported", name, self._options.jam_teleport_s)

    def rebuild(self, seed: int) -> None:
        """Start the scenario again from its beginning with another seed."""
        self.step()  # a drain step: libsumo can crash when it is loaded over pending commands
        self._options = replace(self._options, seed=seed)
        self._bodies.clear()
        self._guarded(lambda: libsumo.load(self._options.arguments()[1:]))

    def time_s(self) -> float:
        """Simulated seconds since the scenario's beginning."""
        return float(libsumo.simulation.getTime())

    def actors(self, near_W_m: F64, radius_m: float) -> tuple[ActorState, ...]:
        """Every vehicle and person within `radius_m` of any of the points (n, 2), sorted by id."""
        found = [self._vehicle(name, p) for name, p in self._near(libsumo.vehicle, near_W_m, radius_m)]
        found += [self._person(name, p) for name, p in self._near(libsumo.person, near_W_m, radius_m)]
        return tuple(sorted(found, key=lambda actor: actor.id))

    def counts(self) -> tuple[int, int]:
        """Vehicles and persons that are in the street now."""
        return len(libsumo.vehicle.getIDList()), len(libsumo.person.getIDList())

    def signals(self) -> tuple[SignalState, ...]:
        """The colours of every traffic light, sorted by id."""
        names = sorted(libsumo.trafficlight.getIDList())
        return tuple(
            SignalState(tls_id=name, colours=libsumo.trafficlight.getRedYellowGreenState(name)) for name in names
        )

    def command_speed(self, actor: ActorState, speed_mps: float) -> None:
        """Hold an actor at a speed; -1 gives it back to SUMO. An actor that has left meanwhile is passed over."""
        domain = libsumo.person if actor.kind is ActorKind.PEDESTRIAN else libsumo.vehicle
        try:
            domain.setSpeed(actor.id.partition(":")[2], speed_mps)
        except libsumo.TraCIException:
            log.debug("%s has left before its speed could be set", actor.id)

    def close(self) -> None:
        """End SUMO; a second call does nothing."""
        if self._open:
            self._open = False
            libsumo.close()

    def __enter__(self) -> SumoSession:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _near(self, domain: Any, near_W_m: F64, radius_m: float) -> list[tuple[str, F64]]:
        """Names and positions in W (3,) of the domain's members near the points. Vectorised: most are far away."""
        names = domain.getIDList()
        if not names or not len(near_W_m):
            return []
        p_W_m = frames.world_from_net(np.array([domain.getPosition3D(name) for name in names]), self._options.origin_m)
        gap2 = ((p_W_m[:, None, :2] - near_W_m[None, :, :2]) ** 2).sum(-1).min(1)
        return [(names[i], p_W_m[i]) for i in np.flatnonzero(gap2 <= radius_m * radius_m)]

    def _vehicle(self, name: str, front_W_m: F64) -> ActorState:
        body = self._body("v:" + name, libsumo.vehicle, name)
        yaw, pitch = frames.yaw_from_sumo(libsumo.vehicle.getAngle(name)), frames.rad(libsumo.vehicle.getSlope(name))
        return ActorState(
            id="v:" + name,
            kind=body.kind,
            p_W_m=frames.centre_from_front(front_W_m, yaw, pitch, body.size_lwh_m[0]),
            yaw_rad=yaw,
            pitch_rad=pitch,
            v_W_mps=libsumo.vehicle.getSpeed(name) * frames.forward(yaw, pitch),
            size_lwh_m=body.size_lwh_m,
            signals=libsumo.vehicle.getSignals(name),
        )

    def _person(self, name: str, front_W_m: F64) -> ActorState:
        body = self._body("p:" + name, libsumo.person, name)
        yaw = frames.yaw_from_sumo(libsumo.person.getAngle(name))
        return ActorState(
            id="p:" + name,
            kind=body.kind,
            p_W_m=frames.centre_from_front(front_W_m, yaw, 0.0, body.size_lwh_m[0]),
            yaw_rad=yaw,
            pitch_rad=0.0,
            v_W_mps=libsumo.person.getSpeed(name) * frames.forward(yaw, 0.0),
            size_lwh_m=body.size_lwh_m,
        )

    def _body(self, key: str, domain: Any, name: str) -> _Body:
        body = self._bodies.get(key)
        if body is None:
            size = (float(domain.getLength(name)), float(domain.getWidth(name)), float(domain.getHeight(name)))
            kind = KIND_OF_CLASS.get(domain.getVehicleClass(name), ActorKind.OTHER)
            body = self._bodies[key] = _Body(kind=kind, size_lwh_m=size)
        return body

    def _guarded(self, call: Any) -> None:
        """Run a libsumo call and turn its exceptions into SumoError."""
        try:
            call()
        except (libsumo.TraCIException, libsumo.FatalTraCIError) as error:
            raise SumoError(
                f"SUMO stopped on {self._options.sumocfg}: {str(error).strip()[:300]}; "
                f"open it in sumo-gui, or run `wcsim town check {self._options.sumocfg.parent}`"
            ) from None
