"""Every class that SUMO knows, and some that nobody knows, as kinds, looks, bodies and pictures."""

import math

import libsumo
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sumolib.net.lane import SUMO_VEHICLE_CLASSES

from tests.support.menagerie import CLASSES, build_street, mirror_loop, one_of_each
from wcsim.bridge.sumo.actors import KIND_OF_CLASS, _kind_and_look, _sane_size
from wcsim.physics.renderer.instances import actor_instances
from wcsim.physics.renderer.models.catalog import template_of
from wcsim.types import ActorKind, ActorLook

DEPRECATED = {"public_emergency", "public_authority", "public_army", "public_transport", "transport", "lightrail",
              "cityrail", "rail_slow"}  # fmt: skip


def test_every_class_of_sumo_s_own_list_has_a_kind():
    assert set(SUMO_VEHICLE_CLASSES) - DEPRECATED <= set(KIND_OF_CLASS)
    assert set(CLASSES) == set(KIND_OF_CLASS)
    assert set(KIND_OF_CLASS.values()) == set(ActorKind)


@given(st.text(max_size=12), st.tuples(*[st.floats()] * 3))
def test_any_name_and_any_size_is_something_with_a_box(name, numbers):
    size = _sane_size(*numbers)
    kind, look = _kind_and_look(name, size)
    assert isinstance(kind, ActorKind) and isinstance(look, ActorLook)
    assert all(math.isfinite(side) and 0.1 <= side <= 400.0 for side in size)
    if name not in KIND_OF_CLASS:
        assert kind is ActorKind.OTHER


@pytest.mark.parametrize(
    "name, height_m, expected",
    [
        ("passenger", 1.5, (ActorKind.CAR, ActorLook.USUAL)),
        ("passenger", 2.3, (ActorKind.CAR, ActorLook.VAN)),
        ("army", 3.0, (ActorKind.TRUCK, ActorLook.USUAL)),
        ("emergency", 2.86, (ActorKind.TRUCK, ActorLook.AMBULANCE)),
        ("emergency", 1.5, (ActorKind.CAR, ActorLook.POLICE)),
        ("delivery", 2.86, (ActorKind.TRUCK, ActorLook.VAN)),
        ("coach", 4.0, (ActorKind.BUS, ActorLook.COACH)),
    ],
)
def test_height_tells_a_van_from_a_car(name, height_m, expected):
    assert _kind_and_look(name, (5.0, 2.0, height_m)) == expected


def test_one_of_each_drives_in_sumo_and_is_mirrored_and_drawn(tmp_path):
    routes = one_of_each() + (
        '<vType id="odd" vClass="hovercraft" length="0.12" width="0.1" height="0.15"/>'
        '<vehicle id="odd" type="odd" depart="0" departPos="5" departLane="4"><route edges="EC CW"/></vehicle>'
        '<vType id="board" vClass="bicycle" guiShape="scooter"/>'
        '<vehicle id="board" type="board" depart="0" departPos="60" departLane="best"><route edges="EC CW"/></vehicle>'
        '<person id="rolls" depart="0" departPos="200" type="t.wheelchair"><walk from="WC" to="CE"/></person>'
    )
    with mirror_loop(build_street(tmp_path, routes)) as loop:
        kinds = {}
        for _ in range(10):
            for actor in loop.tick():
                kinds[actor.id] = actor.kind
        libsumo.vehicletype.setLength("odd", 60.0)
        loop.tick()
        drawn = actor_instances(loop.actors)
    for name in CLASSES:
        assert kinds[f"v:{name}"] is KIND_OF_CLASS[name] or name == "emergency"
    assert kinds["v:odd"] is ActorKind.CAR, "SUMO reads an unknown class as ignoring"
    assert kinds["v:board"] is ActorKind.SCOOTER, "where maps let bicycles ride alone"
    assert kinds["p:rolls"] is ActorKind.WHEELCHAIR
    assert len(drawn) == len(loop.actors)


def test_every_look_that_is_given_has_a_model():
    given_looks = {
        _kind_and_look(name, (6.0, 2.0, height_m)) for name in CLASSES for height_m in (1.5, 3.0)
    }  # fmt: skip
    special = {(kind, look) for kind, look in given_looks if look is not ActorLook.USUAL}
    assert all(template_of(kind, look) is not template_of(kind, ActorLook.USUAL) for kind, look in special)
