"""A single picture of a chair in its street, from behind, as the page of a drive shows it."""

from __future__ import annotations

import math
from typing import Final

from wcsim.bridge.ego.start_place import bearing_rad
from wcsim.bridge.world import World
from wcsim.drive.drawing.moment import Moment
from wcsim.drive.drawing.pictures import PageLooks, StreetPictures
from wcsim.physics.renderer.instances import chair_pose
from wcsim.types import U8

_LOOKS = PageLooks(width_px=960, height_px=540)
_ON_WAY_RAD: Final = math.radians(30.0)  # a way that goes on within this to either side lies ahead


class StillPictures:
    """Draws the first seat's chair in a world, with its way; another world needs another object."""

    def __init__(self, world: World) -> None:
        self._world, self._pictures = world, StreetPictures(world.street, None)

    @property
    def on_way(self) -> bool:
        """Whether the chair faces its way now: while it turns first, its picture shows a way that leads elsewhere."""
        user, plant = self._world.seats[0], self._world.snapshot.clients[0].plant
        return abs(bearing_rad(user.route, user.user.route_progress_m, plant)) < _ON_WAY_RAD

    def draw(self) -> U8:
        """The picture of now, (540, 960, 3) RGB."""
        snapshot, seat = self._world.snapshot, self._world.seats[0]
        moment = Moment(
            actors=snapshot.actors,
            signals=snapshot.signals,
            chairs=(chair_pose(0, snapshot.clients[0].plant, seat.chair.outline),),
            seat=0,
            route=seat.route,
            done_m=seat.user.route_progress_m,
        )
        return self._pictures.behind(moment, _LOOKS)
