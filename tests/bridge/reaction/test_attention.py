"""Who looks for wheelchairs and how late they brake: by class, by street, and drawn for an episode of a chair."""

from dataclasses import replace

import numpy as np
import pytest

from tests.bridge.reaction.roads import StraightRoads, actor, chair, walker
from tests.support.samples import strip_street
from tests.support.worlds import hashes, open_world
from wcsim.bridge.ego.randomization import _draw
from wcsim.bridge.reaction.attention import Attention, AttentionModel
from wcsim.bridge.reaction.commands import LET_GO
from wcsim.bridge.reaction.drivers import StreetReaction
from wcsim.bridge.reaction.pedestrians import PedestrianAvoidance
from wcsim.config import STREETS, WorldConfig, resolve
from wcsim.config.world import VaryConfig
from wcsim.errors import ConfigError
from wcsim.types import ActorKind, Drawn

MANY = 1000
ROAD_W_M = np.array([0.0, 0.0])
DRIVERS = [kind for kind in ActorKind if kind is not ActorKind.WHEELCHAIR]


def share(habits: AttentionModel, kind: ActorKind) -> float:
    prefix = "p" if kind is ActorKind.PEDESTRIAN else "v"
    return float(np.mean([habits.looks(actor(kind, name=f"{prefix}:{kind.value}.{k}")) for k in range(MANY)]))


def config(*settings: str) -> WorldConfig:
    return resolve("quick", settings).world


@pytest.mark.parametrize("kind", DRIVERS)
def test_the_share_of_a_class_is_met_over_a_thousand_and_others_keep_theirs(kind):
    other = ActorKind.CAR if kind is not ActorKind.CAR else ActorKind.BUS
    habits = AttentionModel(config(f"world.attention={{{kind.value}=0.3}}"), seed=4)
    assert share(habits, kind) == pytest.approx(0.3, abs=0.05)
    assert share(habits, other) == pytest.approx(0.95, abs=0.03)
    careless = AttentionModel(config("world.street=careless"), seed=4)
    assert share(careless, kind) == pytest.approx(STREETS["careless"][0], abs=0.05)
    blind = AttentionModel(config("world.street=careless", "world.attention_share=0.0"), seed=4)
    assert share(blind, kind) == 0.0, "where nobody looks nobody looks more often for that"


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


VARY = VaryConfig(reaction={"all": (1.0, 2.0), "bus": (3.0, 4.0)}, attention={"bicycle": (0.0, 0.0)})


def test_ranges_are_drawn_for_each_episode_the_class_s_own_before_that_of_all():
    car, bus, tram = (actor(kind) for kind in (ActorKind.CAR, ActorKind.BUS, ActorKind.TRAM))
    street = AttentionModel(config("world.reaction={tram=0.5}"), 3)
    episodes = [street.towards(_draw(VARY, 1, 7, 0, k)) for k in range(40)]
    drawn = np.array([(one.reaction_s(car), one.reaction_s(bus), one.reaction_s(tram)) for one in episodes])
    assert 1.0 <= drawn[:, 0].min() < 1.2 and 1.8 < drawn[:, 0].max() <= 2.0
    assert drawn[:, 1].min() >= 3.0 and drawn[:, 1].max() <= 4.0
    assert (drawn[:, 2] == 0.5).all(), "a number by class goes before a range for all"
    assert share(episodes[0], ActorKind.BICYCLE) == 0.0 < share(street, ActorKind.BICYCLE)
    fewer = _draw(VaryConfig(reaction={"all": (1.0, 2.0)}), 1, 7, 0, 3)
    assert fewer.reaction_s == (_draw(VARY, 1, 7, 0, 3).reaction_s[0],), "one range less changes no other draw"
    assert street.towards(_draw(VaryConfig(light=(0.5, 1.0)), 1, 7, 0, 3)) is None


def test_who_looks_at_a_share_looks_at_every_larger_one():
    street = AttentionModel(config(), 3)
    cars = [actor(name=f"v:{k}") for k in range(200)]
    few, many = (street.towards(Drawn(attention=(("all", part),))) for part in (0.3, 0.6))
    looking = [{car.id for car in cars if habits.looks(car)} for habits in (few, many, street)]
    assert looking[0] < looking[1] < looking[2]


def towards(**drawn: float) -> AttentionModel:
    """Habits of a street in which everybody looks, towards a chair with these for everybody."""
    street = AttentionModel(config("world.attention_share=1.0"), 1)
    found = street.towards(Drawn(**{name: (("all", value),) for name, value in drawn.items()}))
    assert found is not None
    return found


def first_brake_s(chairs) -> dict[str, float]:
    """When each of two cars, one before each chair, is first told to go slower."""
    street, roads = StreetReaction(config(), towards(attention=1.0, reaction_s=0.3)), StraightRoads(lanes=3)
    cars = roads.put(actor(name="v:a"), actor(y=6.4, name="v:b"))
    found: dict[str, float] = {}
    for tick in range(60):
        for order in street.react(cars, chairs, roads):
            if order.speed_mps != LET_GO:
                found.setdefault(order.actor_id, round(0.1 * (tick + 1), 1))
    return found


def test_each_chair_of_a_street_is_treated_as_its_own_episode_says():
    late, nobody = towards(reaction_s=2.0), towards(attention=0.0)
    here, there = chair(15.0), chair(15.0, 6.4)
    assert first_brake_s((here, there)) == {"v:a": 0.3, "v:b": 0.3}
    assert first_brake_s((replace(here, habits=late), there)) == {"v:a": 2.0, "v:b": 0.3}
    assert first_brake_s((here, replace(there, habits=nobody))) == {"v:a": 0.3}
    both = replace(here, habits=late), replace(chair(16.0), habits=towards(reaction_s=0.95))
    assert first_brake_s(both) == {"v:a": 1.0}, "what one chair's episode says holds for no other chair"


def test_who_braked_for_one_chair_is_let_go_when_it_has_gone_and_the_other_is_not_yet_heeded():
    street, roads = StreetReaction(config(), towards(attention=1.0)), StraightRoads()
    car = roads.put(actor())
    soon, late = (replace(chair(15.0), habits=towards(reaction_s=time_s)) for time_s in (0.1, 5.0))
    assert street.react(car, (soon,), roads)[0].speed_mps != LET_GO
    assert [order.speed_mps for order in street.react(car, (late,), roads)] == [LET_GO]


def test_people_step_aside_for_the_chairs_that_their_episode_has_them_see():
    def furthest_m(habits: AttentionModel | None) -> float:
        moved, person, aside = PedestrianAvoidance(strip_street().grid, 0.1, Attention(1.0, 1)), walker(2.0, 5.6), 0.0
        seen = replace(chair(9.0, 5.5, on_road=False), habits=habits)
        for _ in range(80):
            moved.update((person,), (seen,))
            aside = max(aside, abs(moved.shifted((person,))[0].deflect_m))
            person = replace(person, p_W_m=person.p_W_m + 0.1 * person.v_W_mps)
        return aside

    assert furthest_m(None) > 0.4
    assert furthest_m(towards(attention=1.0)) == furthest_m(None)
    assert furthest_m(towards(attention=0.0)) == 0.0


@pytest.mark.parametrize(
    "setting, told",
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
        resolve("quick", (setting,))


def test_a_world_keeps_what_it_drew_and_draws_anew_for_each_episode_and_seat(corner):
    words = ("vary.reaction={all=[0.5,3.0]}", "vary.attention={car=[0.2,0.9]}", "vary.friction=[0.4,1.0]")
    with open_world(corner, *words, "vary.user_mass_kg=[40,130]", seats=2, seed=5) as world:
        first = [client.drawn for client in world.snapshot.clients]
        assert first == [_draw(world.config.vary, 1, 5, seat, 0) for seat in (0, 1)]
        assert len({drawn.reaction_s for drawn in first}) == len({drawn.attention for drawn in first}) == 2
        hashes(world, 2)
        assert [client.drawn for client in world.snapshot.clients] == first
        car = actor()
        assert [chair.habits.reaction_s(car) for chair in world._open.traffic.chairs] == [
            dict(d.reaction_s)["all"] for d in first
        ]
        second = world.respawn(0).drawn
        assert second == _draw(world.config.vary, 1, 5, 0, 1) != first[0]
        assert world.snapshot.clients[1].drawn == first[1]
        hashes(world, 1)
        assert world._open.traffic.chairs[0].habits.reaction_s(car) == dict(second.reaction_s)["all"]
        assert world._open.traffic.chairs[1].habits.reaction_s(car) == dict(first[1].reaction_s)["all"]
        world.rebuild(5)
        assert [client.drawn for client in world.snapshot.clients] == first


def drive_in_the_road(corner, *words: str) -> list[str]:
    with open_world(corner, *words, seed=2) as world:
        world.put_chair(0, ROAD_W_M, 0.0)
        return hashes(world, 120)


def test_what_is_drawn_as_it_is_set_changes_nothing_to_the_last_bit_and_what_is_not_does(corner):
    plain = drive_in_the_road(corner)
    assert drive_in_the_road(corner, "vary.attention={all=[0.95,0.95]}", "vary.reaction={all=[0.7,0.7]}") == plain
    nobody = drive_in_the_road(corner, "vary.attention={all=[0,0]}")
    assert nobody != plain
    assert nobody == drive_in_the_road(corner, "world.attention_share=0")
