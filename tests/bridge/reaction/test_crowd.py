import pytest

from tests.bridge.reaction.roads import actor, chair, walker
from wcsim.bridge.reaction.crowd import SWEEP_S, crowd_of, vehicles_near


def test_the_crowd_is_who_is_near_a_chair_or_aside_and_who_is_near_these():
    people = (
        walker(3.0, 0.0, name="p:a"),
        walker(40.0, 0.0, name="p:b"),
        walker(42.0, 1.0, name="p:c"),
        walker(60.0, 0.0, name="p:d"),
    )
    crowd = crowd_of((*people, actor(x=4.0)), (chair(0.0),), {"p:b": (0.0, 0.5)}, shifted=False)
    assert [w.id for w in crowd] == ["p:a", "p:b", "p:c"]
    assert [w.aside for w in crowd] == [False, True, False]
    assert crowd[1].at == (40.0, 0.5)
    assert crowd_of(people, (), {}, shifted=False) == []


def test_an_actor_that_is_shifted_already_gives_the_place_that_sumo_has():
    (found,) = crowd_of((walker(3.0, 0.5, name="p:a"),), (chair(0.0),), {"p:a": (0.0, 0.5)}, shifted=True)
    assert (found.x, found.y) == (3.0, 0.0)
    assert found.at == (3.0, 0.5)


def test_a_vehicle_is_minded_where_it_will_be_and_one_far_off_is_not():
    crowd = crowd_of((walker(3.0, 0.0),), (chair(0.0),), {}, shifted=False)
    there, far = actor(x=-12.0, speed=8.0, name="v:a"), actor(x=-80.0, name="v:b")
    (found,) = vehicles_near((there, far), crowd)
    assert found.moves
    assert found.box[0] == -12.0
    assert found.sweep[0] + found.sweep[4] == pytest.approx(-12.0 + 2.25 + SWEEP_S * 8.0)
    (still,) = vehicles_near((actor(x=1.0, speed=0.0),), crowd)
    assert not still.moves
    assert still.sweep == still.box
