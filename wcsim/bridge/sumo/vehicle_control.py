"""Reads a vehicle's lanes from SUMO, and sends it the commands of the reaction.

A command may give everything back to SUMO. The session hands libsumo in: `bridge/sumo/session.py`
stays the only file that loads it.
"""

import logging
from typing import Any

import numpy as np

from wcsim.bridge.reaction.commands import LET_GO, ActorCommand
from wcsim.bridge.reaction.swept_path import Brakes, LaneShape, OnLane
from wcsim.core import frames

log = logging.getLogger("wcsim.bridge.sumo.vehicle_control")

# Speed mode: everything but SUMO's bound on deceleration, which is the service brake.
_NO_DECEL_BOUND = ~4
_ONLY_ORDERED = 512  # lane-change mode: none of SUMO's own, ordered ones only into gaps
_ONLY_ORDERED_PUSHY = 256  # the same, but into any gap that is not a collision
_LANE_HOLD_S = 1.0
_FURTHEST_LINKS = 12


class VehicleControl:
    """What the reaction reads and commands; implements `swept_path.Roads`.

    Actors are named as in `ActorState.id`.
    """

    def __init__(self, libsumo: Any, origin_m: tuple[float, float]) -> None:
        self._api = libsumo
        self._origin_m = origin_m
        self._lanes: dict[str, LaneShape] = {}
        # Speed and lane-change mode before the first command.
        self._modes: dict[str, tuple[int, int]] = {}
        self._sublanes: bool | None = None

    def forget(self) -> None:
        """SUMO was loaded anew: no actor is under a command."""
        self._modes.clear()

    @property
    def sublanes(self) -> bool:
        """Whether vehicles can move sideways within their lanes."""
        if self._sublanes is None:
            self._sublanes = float(self._api.simulation.getOption("lateral-resolution")) > 0.0
        return self._sublanes

    def on_lane(self, actor_id: str) -> OnLane | None:
        """Where a vehicle is; None on no lane (teleported, left), or stopped by its own plan."""
        name, vehicle = actor_id.partition(":")[2], self._api.vehicle
        try:
            lane_id = vehicle.getLaneID(name)
            if not lane_id or vehicle.isStopped(name):
                return None
            along_m, left_m = vehicle.getLanePosition(name), vehicle.getLateralLanePosition(name)
        except self._api.TraCIException:
            return None
        return OnLane(lane_id=lane_id, along_m=along_m, left_m=left_m)

    def lanes_ahead(self, actor_id: str, ahead_m: float) -> tuple[str, ...]:
        """The lane of a vehicle and those on its route, also inside junctions."""
        name, vehicle = actor_id.partition(":")[2], self._api.vehicle
        lanes = self._through_junction(vehicle.getLaneID(name), "")
        along_m = float(vehicle.getLanePosition(name))
        known_m = -along_m + sum(self.lane(lane).length_m for lane in lanes)
        links = vehicle.getNextLinks(name)[:_FURTHEST_LINKS]
        for target, *_, via, _state, _way, _length in links:
            if known_m > ahead_m:
                break
            # The way through a junction has brought it along already.
            if target in lanes:
                continue
            reached = self._through_junction(via, target) if via else [target]
            more = [lane for lane in reached if lane not in lanes]
            lanes += more
            known_m += sum(self.lane(lane).length_m for lane in more)
        return tuple(lanes)

    def lane(self, lane_id: str) -> LaneShape:
        """A lane's shape."""
        known = self._lanes.get(lane_id)
        if known is None:
            api = self._api.lane
            edge_id, _, index = lane_id.rpartition("_")
            points = np.array([point[:2] for point in api.getShape(lane_id)], np.float64)
            known = self._lanes[lane_id] = LaneShape(
                id=lane_id,
                edge_id=edge_id,
                index=int(index),
                points_W_m=frames.world_from_net(points, self._origin_m),
                length_m=api.getLength(lane_id),
                width_m=api.getWidth(lane_id),
                internal=lane_id.startswith(":"),
                shared="pedestrian" in api.getAllowed(lane_id),
            )
        return known

    def lanes_beside(self, actor_id: str, ahead_m: float) -> tuple[int, ...]:
        """Indices of the lanes directly left and right of a vehicle's, the left one first.

        Only those that its class may use, and on which its route leads on so far.
        """
        name, vehicle = actor_id.partition(":")[2], self._api.vehicle
        here = self.lane(vehicle.getLaneID(name))
        kind, need_m = vehicle.getVehicleClass(name), float(vehicle.getLanePosition(name)) + ahead_m
        # From each lane's start, without a change.
        reach_m = {best[0]: best[1] for best in vehicle.getBestLanes(name)}
        found = []
        for index in (here.index + 1, here.index - 1):
            lane = f"{here.edge_id}_{index}"
            if reach_m.get(lane, 0.0) < need_m:
                continue
            allowed = self._api.lane.getAllowed(lane)
            # SUMO lists no class as allowed where all of them are.
            if kind in allowed if allowed else kind not in self._api.lane.getDisallowed(lane):
                found.append(index)
        return tuple(found)

    def brakes(self, actor_id: str) -> Brakes:
        """A vehicle's brakes."""
        name, vehicle = actor_id.partition(":")[2], self._api.vehicle
        service = float(vehicle.getDecel(name))
        # A vehicle type may name an emergency brake that is weaker than its service brake.
        emergency = max(service, float(vehicle.getEmergencyDecel(name)))
        return Brakes(service_mps2=service, emergency_mps2=emergency)

    def allowed_mps(self, actor_id: str) -> float:
        """The speed that a vehicle would drive on a free road."""
        return float(self._api.vehicle.getAllowedSpeed(actor_id.partition(":")[2]))

    def apply(self, command: ActorCommand) -> None:
        """Send a command to SUMO; one for an actor that has left meanwhile has no effect."""
        domain, _, name = command.actor_id.partition(":")
        try:
            if domain == "p":
                self._api.person.setSpeed(name, command.speed_mps)
            else:
                self._steer(name, command)
        except self._api.TraCIException:
            self._drop_modes(command.actor_id)
            log.debug("%s left before it could be commanded", command.actor_id)

    def turn_away(self, actor_id: str) -> None:
        """Take an actor out of the simulation that SUMO put where a chair stands."""
        domain, _, name = actor_id.partition(":")
        try:
            (self._api.person if domain == "p" else self._api.vehicle).remove(name)
        except self._api.TraCIException:
            log.debug("%s has left already", actor_id)
        self._drop_modes(actor_id)
        log.info("%s departed on top of a wheelchair and was removed", actor_id)

    def _drop_modes(self, actor_id: str) -> None:
        """Forget the modes of a vehicle that has left; a person may have the same name."""
        domain, _, name = actor_id.partition(":")
        if domain == "v":
            self._modes.pop(name, None)

    def _steer(self, name: str, command: ActorCommand) -> None:
        vehicle = self._api.vehicle
        modes = self._modes.get(name)
        if modes is None:
            # As they were before the first command, since a scenario may have set its own.
            modes = vehicle.getSpeedMode(name), vehicle.getLaneChangeMode(name)
            self._modes[name] = modes
        speed_mode, lane_mode = modes
        if command.hard:
            speed_mode &= _NO_DECEL_BOUND
        if command.stay_in_lane:
            lane_mode = _ONLY_ORDERED_PUSHY if command.pushy else _ONLY_ORDERED
        vehicle.setSpeed(name, command.speed_mps)
        if vehicle.getSpeedMode(name) != speed_mode:
            vehicle.setSpeedMode(name, speed_mode)
        if vehicle.getLaneChangeMode(name) != lane_mode:
            vehicle.setLaneChangeMode(name, lane_mode)
        if command.lane_index is not None:
            vehicle.changeLane(name, command.lane_index, _LANE_HOLD_S)
        if command.aside_m is not None:
            vehicle.changeSublane(name, command.aside_m)
        if command.speed_mps == LET_GO and not command.stay_in_lane:
            del self._modes[name]

    def _through_junction(self, lane_id: str, target: str) -> list[str]:
        """A lane and, when it lies inside a junction, those that follow it there and out of it."""
        lanes = [lane_id]
        while lanes[-1].startswith(":") and len(lanes) < _FURTHEST_LINKS:
            links = self._api.lane.getLinks(lanes[-1])
            if not links:
                break
            # The lane inside the junction (`via`) where there is one, else the lane behind it.
            lanes.append(links[0][4] or links[0][0])
        return lanes if not target or lanes[-1] == target else [*lanes, target]
