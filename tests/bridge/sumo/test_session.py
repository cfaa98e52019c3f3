from types import SimpleNamespace

import numpy as np
import pytest

from wcsim.bridge.reaction.commands import LET_GO, ActorCommand
from wcsim.bridge.sumo.session import SumoOptions, SumoSession, world_in_this_process
from wcsim.config import WorldConfig
from wcsim.errors import SumoError, WorldInUseError
from wcsim.towns.scenario.overrides import Settings
from wcsim.towns.scenario.town import find_town
from wcsim.types import ActorKind

NEAR = np.zeros((1, 2))


def options(corner, **changes) -> SumoOptions:
    town = find_town(str(corner))
    plain = {
        "sumocfg": town.sumocfg,
        "origin_m": town.file.origin_m,
        "settings": Settings(world=WorldConfig(jam_teleport_s=300.0), seed=1),
    }
    return SumoOptions(**{**plain, **changes})


@pytest.fixture
def sumo(corner):
    with SumoSession(options(corner)) as session:
        yield session


def test_actors_come_with_their_own_size_and_kind(corner):
    with SumoSession(options(corner)) as sumo:
        for _ in range(40):
            sumo.step()
        actors = sumo.actors(NEAR, 500.0)
    kinds = {actor.kind for actor in actors}
    assert kinds == {ActorKind.CAR, ActorKind.PEDESTRIAN}
    assert [actor.id for actor in actors] == sorted(actor.id for actor in actors)
    walker = next(actor for actor in actors if actor.kind is ActorKind.PEDESTRIAN)
    assert walker.size_lwh_m == pytest.approx((0.28, 0.48, 1.75))


def test_speed_and_position_agree(sumo):
    for _ in range(30):
        sumo.step()
    before = {actor.id: actor for actor in sumo.actors(NEAR, 500.0)}
    sumo.step()
    both = [actor for actor in sumo.actors(NEAR, 500.0) if actor.id in before]
    assert len(both) >= 2
    for actor in both:
        moved = (actor.p_W_m - before[actor.id].p_W_m)[:2]
        assert np.linalg.norm(moved - 0.1 * actor.v_W_mps[:2]) < 0.06


def test_only_actors_near_a_point_are_read(sumo):
    for _ in range(40):
        sumo.step()
    everyone = sumo.actors(NEAR, 500.0)
    near = sumo.actors(everyone[0].p_W_m[None, :2], 3.0)
    assert everyone[0].id in {actor.id for actor in near}
    assert len(near) < len(everyone)
    assert sumo.actors(np.zeros((0, 2)), 500.0) == ()


def test_a_held_car_stops_and_goes_on_when_let_go(sumo):
    for _ in range(20):
        sumo.step()
    car = next(a for a in sumo.actors(NEAR, 500.0) if a.kind is ActorKind.CAR)
    sumo.pilot.apply(ActorCommand(actor_id=car.id, speed_mps=0.0))
    for _ in range(60):
        sumo.step()
    held = next(a for a in sumo.actors(NEAR, 500.0) if a.id == car.id)
    assert np.linalg.norm(held.v_W_mps) < 0.01
    sumo.pilot.apply(ActorCommand(actor_id=car.id, speed_mps=LET_GO))
    for _ in range(20):
        sumo.step()
    freed = next(a for a in sumo.actors(NEAR, 500.0) if a.id == car.id)
    assert np.linalg.norm(freed.v_W_mps) > 0.5


def test_a_second_session_is_refused_and_the_first_goes_on(corner):
    with SumoSession(options(corner)) as sumo:
        sumo.step()
        with pytest.raises(WorldInUseError):
            SumoSession(options(corner))
        before = sumo.time_s()
        sumo.step()
        assert sumo.time_s() > before
    assert not world_in_this_process()


def test_a_missing_scenario_is_an_error_with_a_cure(tmp_path, corner):
    with pytest.raises(SumoError, match="sumo-gui"):
        SumoSession(options(corner, sumocfg=tmp_path / "none.sumocfg"))
    assert not world_in_this_process()


def test_a_collision_is_counted_once_however_long_it_lasts(corner, monkeypatch):
    told = [[("a", "b")], [("b", "a"), ("c", "d")], [("a", "b"), ("c", "d")], [], [("a", "b")]]
    hits = iter([[SimpleNamespace(collider=a, victim=b) for a, b in pairs] for pairs in told])
    with SumoSession(options(corner)) as sumo:
        monkeypatch.setattr("libsumo.simulation.getCollisions", lambda: next(hits))
        counted = []
        for _ in told:
            sumo.step()
            counted.append(sumo.mishaps[1])
        assert counted == [1, 2, 2, 2, 3]
        monkeypatch.undo()


def test_people_who_jump_from_street_to_street_are_seen_where_they_land(corner, corner_town, tmp_path):
    walks = (f'<person id="w{k}" depart="{k}"><walk edges="WC C{"NES"[k % 3]}"/></person>' for k in range(40))
    (tmp_path / "a.rou.xml").write_text(f"<routes>{''.join(walks)}</routes>")
    inputs = f"<n value='{corner_town.net}'/><r value='a.rou.xml'/>"
    (tmp_path / "a.sumocfg").write_text(f"<c>{inputs}<pedestrian.model value='nonInteracting'/></c>")
    landing_m = np.array([[8.0, -5.0]])
    with SumoSession(options(corner, sumocfg=tmp_path / "a.sumocfg")) as sumo:
        seen = set()
        for _ in range(500):
            sumo.step()
            near = [actor.id for actor in sumo.actors(landing_m, 5.0)]
            assert near == [actor.id for actor in sumo.actors_at(landing_m, 5.0)]
            seen |= set(near)
    assert len(seen) > 2
