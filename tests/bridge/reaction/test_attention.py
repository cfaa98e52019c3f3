"""Who looks for wheelchairs and how late they brake: by class, by street, and drawn for a world."""

from __future__ import annotations

import numpy as np
import pytest

from tests.bridge.reaction.roads import StraightRoads, actor, chair
from wcsim.bridge.reaction.attention import AttentionModel
from wcsim.bridge.reaction.commands import LET_GO, Attention
from wcsim.bridge.reaction.drivers import StreetReaction
from wcsim.config import STREETS, WorldConfig, load_run_config
from wcsim.config.randomization import VaryConfig
from wcsim.errors import ConfigError
from wcsim.types import ActorKind

MANY = 1000
DRIVERS = [kind for kind in ActorKind if kind is not ActorKind.WHEELCHAIR]


def share(habits: AttentionModel, kind: ActorKind) -> float:
    prefix = "p" if kind is ActorKind.PEDESTRIAN else "v"
    return float(np.mean([habits.looks(actor(kind, name=f"{prefix}:{kind.value}.{k}")) for k in range(MANY)]))


def config(*settings: str) -> WorldConfig:
    return load_run_config("quick", settings).world


@pytest.mark.parametrize("kind", DRIVERS)
def test_the_share_of_a_class_is_met_over_a_thousand_and_others_keep_theirs(kind):
    other = ActorKind.CAR if kind is not ActorKind.CAR else ActorKind.BUS
    habits = AttentionModel(config(f"world.attention={{{kind.value}=0.3}}"), seed=4)
    assert share(habits, kind) == pytest.approx(0.3, abs=0.05)
    assert share(habits, other) == pytest.approx(0.95, abs=0.03)
    careless = AttentionModel(config("world.street=careless"), seed=4)
    assert share(careless, kind) == pytest.approx(STREETS["careless"][0], abs=0.05)


def test_by_default_the_same_ones_look_as_ever():
    habits, plain = AttentionModel(WorldConfig(), seed=7), Attention(0.95, 7)
    cars = [actor(name=f"v:{k}") for k in range(MANY)]
    assert [habits.looks(car) for car in cars] == [plain.looks(car.id) for car in cars]
    assert {habits.reaction_s(car) for car in cars} == {0.7}
    assert habits.people.looks("p:1") == plain.looks("p:1")


def brakes_after_s(settings: WorldConfig, kind: ActorKind = ActorKind.CAR) -> float:
    """Seconds from when a chair stands in the way of one who looks to its first order to go slower."""
    everybody = settings.model_copy(update={"attention": {kind.value: 1.0}})
    street, roads = StreetReaction(everybody, AttentionModel(everybody, 1)), StraightRoads()
    driver = actor(kind, speed=10.0)
    for tick in range(100):
        orders = street.react(roads.put(driver), (chair(15.0),), roads)
        if orders and orders[0].speed_mps != LET_GO:
            return 0.1 * (tick + 1)
    return 100.0


def test_a_careless_street_brakes_later_and_a_class_as_late_as_it_is_told():
    usual, careless = brakes_after_s(config()), brakes_after_s(config("world.street=careless"))
    assert usual == pytest.approx(0.7, abs=0.11)
    assert careless == pytest.approx(1.5, abs=0.11)
    slow_bus = config("world.street=careless", "world.reaction={bus=2.4}")
    assert brakes_after_s(slow_bus, ActorKind.BUS) == pytest.approx(2.4, abs=0.11)
    assert brakes_after_s(slow_bus, ActorKind.CAR) == pytest.approx(1.5, abs=0.11)


def test_ranges_are_drawn_for_each_world_the_class_s_own_before_that_of_all():
    vary = VaryConfig(reaction={"all": (1.0, 2.0), "bus": (3.0, 4.0)}, attention={"bicycle": (0.0, 0.0)})
    car, bus, tram = (actor(kind) for kind in (ActorKind.CAR, ActorKind.BUS, ActorKind.TRAM))
    worlds = [AttentionModel(config("world.reaction={tram=0.5}"), seed, vary) for seed in range(40)]
    drawn = np.array([(one.reaction_s(car), one.reaction_s(bus), one.reaction_s(tram)) for one in worlds])
    assert 1.0 <= drawn[:, 0].min() < 1.2 and 1.8 < drawn[:, 0].max() <= 2.0
    assert drawn[:, 1].min() >= 3.0 and drawn[:, 1].max() <= 4.0
    assert (drawn[:, 2] == 0.5).all(), "a number by class goes before a range for all"
    assert share(worlds[0], ActorKind.BICYCLE) == 0.0
    again = AttentionModel(config(), 3, VaryConfig(reaction={"all": (1.0, 2.0)}))
    assert again.reaction_s(car) == worlds[3].reaction_s(car), "one range less changes no other draw"


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("world.street=reckless", "world.street"),
        ("world.attention={car=1.2}", "world.attention"),
        ("world.attention={lorry=0.5}", "world.attention"),
        ("world.reaction={pedestrian=1.0}", "world.reaction"),
        ("world.reaction={car=-1}", "world.reaction"),
        ("vary.attention={car=[0.9,0.5]}", "low <= high"),
        ("vary.reaction={all=[0.5,90]}", "vary.reaction"),
    ],
)
def test_what_is_out_of_bounds_is_refused_with_its_name(setting, told):
    with pytest.raises(ConfigError, match=told):
        load_run_config("quick", (setting,))


def test_ranges_of_the_street_alone_leave_the_chairs_alike():
    assert load_run_config("quick", ("vary.attention={all=[0.5,1.0]}",)).vary.nothing
