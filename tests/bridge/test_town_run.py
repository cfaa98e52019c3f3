from dataclasses import replace

import numpy as np
import pytest

from tests.support.actors import actor
from tests.support.framing import write_log
from tests.support.worlds import quick_config
from tests.towns.made import hostile
from wcsim.bridge.reaction.articulated import Articulation
from wcsim.bridge.recording.convert import convert_to_fcd
from wcsim.bridge.town_run import TRACE, RecordOrder, _check_mirrored, as_recorded, record_town
from wcsim.bridge.world import World
from wcsim.errors import SumoError, TownError
from wcsim.log.reader import read_trace_states
from wcsim.log.records import Header, world_state_from_snapshot
from wcsim.towns.scenario.town import find_town
from wcsim.towns.sumo.xml_io import read_root
from wcsim.types import ActorKind, Snapshot


def test_ghosts_and_missing_actors_are_told_from_who_is_only_near_the_border():
    near, border, far = (actor(x=x, name=f"v:{name}") for name, x in (("near", 10.0), ("border", 49.0), ("far", 80.0)))
    chairs, everyone = np.zeros((1, 2)), (near, border, far)
    _check_mirrored((near,), everyone, chairs, 50.0)
    _check_mirrored((near, border, actor(x=6.0, name="v:near~1", piece=1)), everyone, chairs, 50.0)
    with pytest.raises(SumoError, match=r"not in SUMO: v:ghost; in SUMO but not mirrored: none"):
        _check_mirrored((near, actor(x=3.0, name="v:ghost")), everyone, chairs, 50.0)
    with pytest.raises(SumoError, match=r"not in SUMO: none; in SUMO but not mirrored: v:near"):
        _check_mirrored((), everyone, chairs, 50.0)
    _check_mirrored((), everyone, np.zeros((0, 2)), 50.0)  # no chair sees anybody


def test_a_tram_near_a_chair_is_recorded_in_all_its_pieces_and_is_one_vehicle_of_floating_car_data(tmp_path):
    tram = actor(ActorKind.TRAM, 20.0, name="v:tram", size=(26.0, 2.4, 3.4))
    far, near = replace(tram, id="v:far", p_W_m=np.array([300.0, 0.0, 0.0])), Articulation().bent((tram,))
    snapshot = Snapshot(epoch=0, tick=1, time_s=0.1, actors=near, signals=(), clients=())
    recorded = as_recorded(snapshot, (far, tram))
    assert [(a.id, a.piece) for a in recorded] == [("v:far", 0), ("v:tram", 0), ("v:tram~1", 1), ("v:tram~2", 2)]
    assert sum(a.size_lwh_m[0] for a in recorded[1:]) == pytest.approx(26.0)
    header = Header(town="t", seed=1, tick_s=0.1, seats=0, fingerprint="f")
    trace = write_log(tmp_path / TRACE, header, [world_state_from_snapshot(snapshot, (), recorded)])
    convert_to_fcd(trace, tmp_path / "fcd.xml")
    (step,) = read_root(tmp_path / "fcd.xml")
    assert [(v.get("id"), float(v.get("x", "nan"))) for v in step] == [("far", 313.0), ("tram", 33.0)]


def test_a_recorded_town_holds_everybody_and_the_chairs(corner_town, tmp_path):
    order = RecordOrder(seconds=6.0, seed=3, chairs=2, folder=tmp_path, outputs=("fcd",))
    opened = []
    facts = record_town(corner_town, quick_config(), order, opened.append)
    header, records = read_trace_states(tmp_path / TRACE)
    assert (header.seats, len(records), facts.ticks) == (2, 60, 60)
    assert records[-1].plants.shape == (2, 15)
    assert records[-1].time_s == pytest.approx(6.0) == facts.end_s
    assert {name for record in records for name in record.actor_ids} == {b.id for r in records for b in r.bodies}
    assert facts.vehicles + facts.persons == len({name for record in records for name in record.actor_ids})
    assert facts.mirrored >= 1 and facts.episodes >= 2
    assert opened[0].outputs[0] == tmp_path / "sumo" / "fcd.xml"
    again = record_town(corner_town, quick_config(), replace(order, folder=tmp_path / "b"), opened.append)
    assert again == facts
    assert (tmp_path / TRACE).read_bytes() == (tmp_path / "b" / TRACE).read_bytes()


def test_traffic_alone_is_that_of_a_world_without_chairs_and_builds_no_street(corner_town, tmp_path, monkeypatch):
    config = quick_config()
    with World(corner_town, config, (), 3) as world:
        plain = [(world.tick(()).state_hash, [a.id for a in world.sumo.everyone()]) for _ in range(40)]
        mishaps = world.sumo.mishaps
    for name in ("wcsim.bridge.town_run.load_street", "wcsim.bridge.world.load_street", "wcsim.bridge.town_run.World"):
        monkeypatch.setattr(name, lambda *words: pytest.fail("a street was built for nobody"))
    stages = []
    order = RecordOrder(seconds=4.0, seed=3, chairs=0, folder=tmp_path)
    facts = record_town(corner_town, config, order, lambda scenario: None, stage=stages.append)
    header, records = read_trace_states(tmp_path / TRACE)
    assert [(r.state_hash, list(r.actor_ids)) for r in records] == plain
    assert (header.seats, facts.episodes, facts.crashed) == (0, 0, ()) and facts.vehicles > 0
    assert (facts.teleports, facts.collisions) == mishaps
    assert len(stages) == 2 and "files" in stages[0]


def test_a_file_that_is_missing_is_said_before_the_net_is_opened(corner_town, tmp_path, monkeypatch):
    sumocfg = hostile.scenario(corner_town, tmp_path / "theirs", more='<include href="gone.add.xml"/>')
    for name in ("wcsim.bridge.town_run.validate_net", "wcsim.bridge.town_run.validate_net"):
        monkeypatch.setattr(name, lambda *words, **more: pytest.fail("the net was opened first"))
    monkeypatch.setattr("wcsim.bridge.world.validate_net", lambda *words, **more: pytest.fail("the net was opened"))
    for chairs in (0, 1):
        order = RecordOrder(seconds=1.0, seed=3, chairs=chairs, folder=tmp_path)
        with pytest.raises(TownError, match=r"does not exist.*gone\.add\.xml"):
            record_town(find_town(str(sumocfg)), quick_config(), order, lambda scenario: None)


def test_a_crash_is_kept_with_its_reason_second_and_place(corner_town, tmp_path, monkeypatch):
    config = quick_config("reward.accel_window_mps2=[0.001, 0.002]", "imu.saturation_mps2=10")
    order = RecordOrder(seconds=3.0, seed=3, chairs=1, folder=tmp_path)
    facts = record_town(corner_town, config, order, lambda scenario: None)
    assert facts.crashes == len(facts.crashed) >= 1
    first = facts.crashed[0]
    assert (first.seat, first.reason) == (0, "acceleration") and facts.begin_s < first.time_s <= facts.end_s
    _, records = read_trace_states(tmp_path / TRACE)
    record = next(record for record in records if record.time_s == first.time_s)
    assert np.hypot(*(record.plants[0, :2] + corner_town.file.origin_m - first.at_m)) < 0.01
