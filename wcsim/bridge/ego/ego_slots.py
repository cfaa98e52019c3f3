"""The seats of a world: a fixed number of places for wheelchairs, each free or taken, from tick to tick.

A user's step hook sees the chair of each as `hook_chair` gives it.
"""

from __future__ import annotations

from wcsim.bridge.ego.ego import Ego
from wcsim.bridge.sumo.step_hook import HookChair
from wcsim.config import RunConfig
from wcsim.core.frames import sumo_from_yaw
from wcsim.errors import ProtocolError
from wcsim.physics.engine import Engine
from wcsim.physics.sensors.camera import CameraRig
from wcsim.physics.wheelchair.plant import plant_spec, refuse_cameras_inside
from wcsim.towns.checks.validate import require_pavement
from wcsim.towns.scenario.town import Town, content_hash
from wcsim.towns.walking.routes import Router, edges_ahead
from wcsim.types import SeatSpec, Street, chair_actor_id
from wcsim.users.recorded import require_driven_here


class EgoSlots:
    """Who sits where; `present` holds the taken seats in the order of their numbers."""

    def __init__(self, specs: tuple[SeatSpec | None, ...], config: RunConfig, street: Street, town: Town) -> None:
        """One place for each of `specs`, free where it is None.

        Raises:
            ConfigError: a camera is inside the chair's body, or a spec holds something that cannot be used.
            TownError: there are places, but the town has no pavement to drive on.
        """
        self.present: tuple[Ego, ...] = ()
        self._config, self._street, self._town = config, street, town
        self._begun = [0] * len(specs)  # episodes of the epoch, by place
        self._seed = 0
        if specs:
            refuse_cameras_inside(config.cameras, plant_spec(config.chair).frame.boxes)
            require_pavement(street, town)
            self._router = Router(street.walk)
            self.present = tuple(self._seat(number, spec) for number, spec in enumerate(specs) if spec is not None)

    def at(self, number: int) -> Ego:
        """The seat of this number. Raises ProtocolError when it is free or not there."""
        self._check(number)
        seat = self._find(number)
        if seat is None:
            raise ProtocolError(f"seat {number} is free; expected one of {[seat.index for seat in self.present]}")
        return seat

    def build(self, engine: Engine, rig: CameraRig, seed: int) -> None:
        """Begin an epoch: a new wheelchair in a new engine for each seat that is taken."""
        self._seed = seed
        self._begun = [0] * len(self._begun)
        for seat in self.present:
            seat.build(engine, rig, seed)

    def admit(self, engine: Engine, rig: CameraRig, number: int, spec: SeatSpec) -> Ego:
        """Take a free seat; its wheelchair is parked in the engine until its first episode is begun.

        Raises:
            ProtocolError: the seat is taken or not there.
            ConfigError: the spec holds something that cannot be used.
        """
        self._check(number)
        if self._find(number) is not None:
            raise ProtocolError(f"seat {number} is taken; expected one of the free ones {self._free() or '(none)'}")
        seat = self._seat(number, spec)
        seat.build(engine, rig, self._seed, self._begun[number])
        # Commands and snapshots are in the order of the seats, whoever came last.
        self.present = tuple(sorted((*self.present, seat), key=lambda item: item.index))
        return seat

    def dismiss(self, number: int) -> None:
        """Free a seat: its wheelchair leaves the engine. Raises ProtocolError when the seat is free or not there."""
        self._begun[number] = self.at(number).begun
        self.revoke(number)

    def revoke(self, number: int) -> None:
        """The same for a seat whose first episode could not begin, which then does not count."""
        gone = self.at(number)
        self.present = tuple(seat for seat in self.present if seat is not gone)
        gone.chair.remove()
        for seat in self.present:
            # The next chair in this seat has the same id, and no part in who touched whom before.
            seat.chair.forget(chair_actor_id(number))

    def _seat(self, number: int, spec: SeatSpec) -> Ego:
        ego = Ego(number, spec, self._config, self._street, self._router)
        if ego.recording is not None:
            require_driven_here(ego.recording, self._town.name, lambda: content_hash(self._town))
        return ego

    def _find(self, number: int) -> Ego | None:
        return next((seat for seat in self.present if seat.index == number), None)

    def _free(self) -> list[int]:
        return [number for number in range(len(self._begun)) if self._find(number) is None]

    def _check(self, number: int) -> None:
        if not 0 <= number < len(self._begun):
            raise ProtocolError(f"there is no seat {number}; expected 0 or more and less than {len(self._begun)}")


def hook_chair(seat: Ego, street: Street) -> HookChair:
    """The chair of a seat now."""
    plant, route, asks, (east_m, north_m, up_m) = seat.plant, seat.route, seat.asks, street.net_origin_m
    arc_m, (x, y, z) = seat.user.route_progress_m, plant.p_WB_m.tolist()
    ahead = [(x, y), *route.points_W_m[route.arc_m > arc_m].tolist()]
    return HookChair(
        seat=seat.index,
        p_net_m=(x + east_m, y + north_m, z + up_m),
        angle_deg=sumo_from_yaw(plant.yaw_rad),
        speed_mps=float(plant.v_B_mps[0]),
        way_net_m=tuple((px + east_m, py + north_m) for px, py in ahead),
        edges=edges_ahead(street.walk, route, arc_m),
        button_tls_id="" if asks is None else asks.tls_id,
    )
