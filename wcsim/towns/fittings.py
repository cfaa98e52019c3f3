"""Everything that stands in a street beside its buildings, in the order in which it takes its place."""

from __future__ import annotations

from pathlib import Path

from wcsim.towns.busstops import stop_things
from wcsim.towns.furniture import things_of
from wcsim.towns.items import Item
from wcsim.towns.netread import Net
from wcsim.towns.signals import sign_things, signal_things
from wcsim.towns.standing import Place, Thing


def fittings_of(
    items: list[Item], net: Net, additional: tuple[Path, ...], place: Place, placed: list[Thing]
) -> list[Thing]:
    """What the author placed, then signals, stops, signs and mapped furniture where these leave room."""
    things = list(placed)
    things += signal_things(net, additional, place, things)
    things += stop_things(items, place, things, net.lefthand)
    things += sign_things(items, net, place, things)
    things += things_of(items, place, things)
    return things
