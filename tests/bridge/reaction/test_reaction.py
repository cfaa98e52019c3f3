"""The reaction on a small street with SUMO in it; the whole battery is `python -m benchmarks reaction`."""

import math

import numpy as np
import pytest

from benchmarks.reaction.battery import run_battery, stand
from benchmarks.reaction.engineless_world import ReactionStage, queue_behind
from benchmarks.reaction.places import ChairPlace
from benchmarks.reaction.streets import SMALL_STREETS, build_small_street
from wcsim.bridge.reaction.commands import CHAIR, LET_GO, VEHICLE, ActorCommand
from wcsim.config import WorldConfig
from wcsim.towns.street import load_street

BEFORE_S = 60.0


@pytest.fixture(scope="module")
def streets(tmp_path_factory):
    """The small streets by name, as town and what was built of it."""
    found = {}
    for street in SMALL_STREETS:
        town = build_small_street(street, tmp_path_factory.mktemp(street.name), seed=1)
        found[street.name] = (town, load_street(town))
    return found


def stage_in(streets, name, attention=1.0, warmup_s=BEFORE_S):
    town, street = streets[name]
    return ReactionStage(town, street, WorldConfig(attention_share=attention), seed=5, warmup_s=warmup_s)


@pytest.mark.parametrize(
    "name, kind, x, y, yaw",
    [
        ("one-lane", "pavement", 87.9, 5.7, 1.0),
        ("one-lane", "bike_lane", 100.0, -4.05, 0.0),
        ("one-lane", "zebra", 70.0, -1.7, 0.5 * math.pi),
        ("one-lane", "carriageway", 100.0, -1.6, 0.3),
        ("mixed", "carriageway", 110.0, -2.9, 0.0),
    ],
)
def test_nobody_touches_a_chair_that_stands_and_without_attention_somebody_does(streets, name, kind, x, y, yaw):
    place = ChairPlace(kind=kind, p_W_m=(x, y), yaw_rad=yaw)
    with stage_in(streets, name, warmup_s=30.0) as stage:
        result = stand(stage, place, 60.0)
    assert result is not None and result.contacts == frozenset()
    with stage_in(streets, name, attention=0.0, warmup_s=30.0) as stage:
        assert any(stand(stage, place, 10.0).contacts for _ in range(6))  # till the first one


def test_cars_take_the_next_lane_and_people_walk_round(streets):
    with stage_in(streets, "two-lanes") as stage:
        result = stand(stage, ChairPlace(kind="carriageway", p_W_m=(130.0, -5.0), yaw_rad=0.0), 90.0)
    assert result is not None
    assert result.contacts == result.deflect_overlaps == frozenset()
    assert result.could_pass >= 3
    assert result.passed >= 0.7 * result.could_pass
    assert result.blocked_s_max < 60.0


def test_those_who_waited_go_on_within_five_seconds_of_the_chair_leaving(streets):
    with stage_in(streets, "one-lane") as stage:
        chair = stage.chair(np.array([100.0, -1.6]), 0.0)
        for _ in range(400):
            actors = stage.tick((chair,))
        waiting = {b.actor_id for b in stage.blocked()}
        assert waiting
        for _ in range(50):
            stage.tick(())
        moving = {a.id for a in stage.near(chair.p_W_m[None], 80.0) if float(np.hypot(*a.v_W_mps[:2])) > 0.5}
        assert waiting <= moving
        assert {a.id for a in actors} >= waiting


def test_without_a_chair_near_nothing_is_commanded_and_the_traffic_is_sumos_own(streets):
    everywhere = np.array([[0.0, 0.0]])
    tracks = []
    for chairs in (False, True):
        with stage_in(streets, "one-lane", warmup_s=5.0) as stage:
            far = stage.chair(np.array([0.0, 900.0]), 0.0)
            for _ in range(300):
                stage.tick((far,) if chairs else ())
            tracks.append([(a.id, *a.p_W_m.tolist(), a.yaw_rad) for a in stage.near(everywhere, 400.0)])
    assert tracks[0] == tracks[1]
    assert len(tracks[0]) > 10


def test_the_same_seed_gives_the_same_street(streets):
    runs = []
    for _ in range(2):
        with stage_in(streets, "mixed", warmup_s=20.0) as stage:
            chair = stage.chair(np.array([40.0, -2.6]), 0.0)
            for _ in range(250):
                actors = stage.tick((chair,))
            runs.append([(a.id, *a.p_W_m.tolist(), a.deflect_m) for a in actors])
    assert runs[0] == runs[1]


def test_every_mode_that_was_changed_is_put_back(streets):
    import libsumo

    with stage_in(streets, "two-lanes") as stage:
        chair = stage.chair(np.array([130.0, -5.0]), 0.0)
        changed = 0
        for _ in range(300):
            actors = stage.tick((chair,))
            lane_modes = [libsumo.vehicle.getLaneChangeMode(a.id[2:]) for a in actors if a.id.startswith("v:")]
            changed += any(mode != 1621 for mode in lane_modes)
        assert changed
        for _ in range(3):
            stage.tick(())
        for name in libsumo.vehicle.getIDList():
            assert libsumo.vehicle.getLaneChangeMode(name) == 1621
            assert libsumo.vehicle.getSpeedMode(name) == 31


def test_who_comes_into_being_on_a_chair_is_taken_out_and_orders_to_the_gone_are_passed_over(streets):
    import libsumo

    with stage_in(streets, "one-lane") as stage:
        chair = stage.chair(np.array([-150.0, -1.62]), 0.0)
        while any(math.dist(a.p_W_m[:2], chair.p_W_m) < 12.0 for a in stage.near(chair.p_W_m[None], 40.0)):
            stage.tick(())
        stage.tick((chair,))
        libsumo.vehicle.add("late", libsumo.route.getIDList()[0], typeID="car", departPos="51", departSpeed="0")
        libsumo.vehicle.setRoute("late", ["AC", "CZ", "ZB"])
        for _ in range(20):
            stage.tick((chair,))
        assert "v:late" not in stage.contacts
        stage.apply(ActorCommand(actor_id="v:nobody", speed_mps=LET_GO))
        stage.apply(ActorCommand(actor_id="p:nobody", speed_mps=0.0))


def test_a_sample_of_the_battery(tmp_path, streets):
    told = []
    battery = run_battery("", 2, 15.0, tmp_path, told.append, streets=1, warmup_s=30.0)
    assert set(battery.standing) == {"pavement", "bike_lane", "zebra", "carriageway"}
    assert sum(battery.standing.values()) == 0
    assert 0.0 <= battery.passed_share <= 1.0
    assert battery.deflect_overlaps == 0
    assert battery.blocked_s_max <= 60.0
    assert len(told) == 4


def test_who_stands_behind_somebody_who_cannot_go_on_only_queues():
    behind = {"p:a": CHAIR, "p:b": "p:a", "p:c": "p:b", "p:x": "p:y", "p:y": "p:x", "p:t": VEHICLE}
    assert queue_behind(behind, {"p:a"}) == {"p:b", "p:c"}
    assert queue_behind(behind, {VEHICLE}) == {"p:t"}
    assert queue_behind(behind, set()) == set()
