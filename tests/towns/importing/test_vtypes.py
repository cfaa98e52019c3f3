"""The people and vehicles of our own demand have the sizes and speeds of real ones."""

import xml.etree.ElementTree as ET

import pytest

from wcsim.bridge.sumo.actors import _kind_and_look
from wcsim.towns.importing.demand import vtypes_text
from wcsim.types import ActorKind

GROUPS = {group.get("id"): list(group) for group in ET.fromstring(vtypes_text()).iter("vTypeDistribution")}  # noqa: S314
WALKERS = {item.get("id"): item for item in GROUPS["walkers"]}


@pytest.mark.parametrize("group", sorted(GROUPS))
def test_shares_add_up_and_colours_and_ids_differ(group):
    items = GROUPS[group]
    assert sum(float(item.get("probability")) for item in items) == pytest.approx(1.0)
    assert len({item.get("id") for item in items}) == len({item.get("color") for item in items}) == len(items)


def test_people_are_children_and_grown_ups_of_human_build():
    heights = {name: float(item.get("height")) for name, item in WALKERS.items()}
    assert min(heights.values()) < 1.15 and max(heights.values()) > 1.85 and len(set(heights.values())) >= 8
    for name, item in WALKERS.items():
        height, width, depth = heights[name], float(item.get("width")), float(item.get("length"))
        assert 0.25 < width / height < 0.31, f"{name}: shoulders are some 28 % of the height"
        assert 0.14 < depth / height < 0.19, name


def test_people_walk_as_fast_as_people_do():
    """Free walking speeds: women 1.2 to 1.4, men 1.3 to 1.5, old people 0.8 to 1.1, children 0.9 to 1.3 m/s."""
    speed = {name: float(item.get("maxSpeed")) for name, item in WALKERS.items()}
    assert 0.8 < speed["walker.old"] < 1.1 < speed["walker.woman"] < speed["walker.man"] < 1.6
    assert 0.9 < speed["walker.child.small"] < speed["walker.child"] < 1.3 and 2.2 < speed["walker.runner"] < 3.5
    share = {name: float(item.get("probability")) for name, item in WALKERS.items()}
    assert 1.2 < sum(share[name] * speed[name] for name in speed) < 1.45


def test_every_type_is_the_kind_that_its_group_says():
    kinds = {
        "cars": ActorKind.CAR, "trucks": ActorKind.TRUCK, "motorcycles": ActorKind.MOTORCYCLE,
        "bicycles": ActorKind.BICYCLE, "walkers": ActorKind.PEDESTRIAN,
    }  # fmt: skip
    for group, items in GROUPS.items():
        for item in items:
            size = tuple(float(item.get(side)) for side in ("length", "width", "height"))
            assert _kind_and_look(item.get("vClass"), size)[0] is kinds[group]
