"""Everything that stands in a street beside its buildings, in the order in which it takes its place."""

from __future__ import annotations

from pathlib import Path

from wcsim.towns.furniture.bus_stops import stop_things
from wcsim.towns.furniture.mapped import things_of
from wcsim.towns.furniture.placement import FreeGround, StandingObject
from wcsim.towns.furniture.traffic_lights import sign_things, signal_things
from wcsim.towns.sumo.additional import Item
from wcsim.towns.sumo.net import Net


def fittings_of(
    items: list[Item], net: Net, additional: tuple[Path, ...], place: FreeGround, placed: list[StandingObject]
) -> list[StandingObject]:
    """What the author placed, then signals, stops, signs and mapped furniture where these leave room."""
    things = list(placed)
    things += signal_things(net, additional, place, things)
    things += stop_things(items, place, things, net.lefthand)
    things += sign_things(items, net, place, things)
    things += things_of(items, place, things)
    return things
