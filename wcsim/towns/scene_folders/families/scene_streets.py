"""The streets on which the families take place: a street with pavements between houses, and a shared path."""

from __future__ import annotations

from typing import NamedTuple

from wcsim.towns.scene_folders.families.draft import XY, Node, Place, Thing

END_M = 50.0
LANE_M = 3.25
KERB_Y_M = -LANE_M
_HOUSE_M = 8.0

_EDGES = '<edge id="WE" from="W" to="E" type="street"/>\n<edge id="EW" from="E" to="W" type="street"/>'
_CROSSING = '<crossing node="E" edges="WE EW" priority="true" width="3"/>'
WALKER = (
    '<vType id="walker" vClass="pedestrian" length="0.28" width="0.48" height="1.75" speedDev="0" maxSpeed="{:.2f}"/>'
)


class Pavement(NamedTuple):
    """The pavement south of a street that runs east, whose kerb is on the left of who drives east."""

    width_m: float

    @property
    def outer_y_m(self) -> float:
        """Its side away from the road."""
        return KERB_Y_M - self.width_m

    def at(self, from_kerb_m: float) -> float:
        """Net coordinate y so far from the kerb."""
        return KERB_Y_M - from_kerb_m

    def types(self) -> str:
        """The street's type."""
        return (
            f'<type id="street" priority="3" numLanes="1" speed="8.33" width="{LANE_M}" '
            f'sidewalkWidth="{self.width_m:.2f}" disallow="pedestrian wheelchair"/>'
        )


def street(pavement: Pavement, *things: Thing, kerb_height_m: float = 0.12) -> Place:
    """A street that runs east between pavements; `things` stand beside it."""
    return Place(
        nodes=(Node("W", -END_M, 0.0), Node("E", END_M, 0.0)),
        types=pavement.types(),
        edges=_EDGES,
        crossings=_CROSSING,
        things=things,
        kerb_height_m=kerb_height_m,
    )


def row(pavement: Pavement, away_m: float = 0.0) -> Thing:
    """A row of houses along a pavement, so far from it."""
    return house("row", (-45.0, 45.0), pavement.outer_y_m - away_m)


def house(name: str, x_m: XY, near_y_m: float, kind: str = "building") -> Thing:
    """A house, or the like, south of `near_y_m`."""
    far_y_m = near_y_m - _HOUSE_M
    west_m, east_m = x_m
    corners = ((west_m, far_y_m), (east_m, far_y_m), (east_m, near_y_m), (west_m, near_y_m), (west_m, far_y_m))
    return Thing(name, kind, corners)


def path_types(width_m: float, name: str = "shared", priority: int = 1) -> str:
    """A type of path for walkers and riders together."""
    return (
        f'<type id="{name}" priority="{priority}" numLanes="1" speed="8.33" width="{width_m:.2f}" '
        'allow="pedestrian bicycle scooter"/>'
    )
