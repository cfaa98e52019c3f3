import math
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import pytest

from tests.support.framing import write_log
from tests.support.worlds import quick_config
from wcsim.bridge.recording.convert import convert_to_fcd
from wcsim.bridge.town_run import TRACE, RecordOrder, record_town
from wcsim.config import ChairConfig
from wcsim.errors import WcsimError
from wcsim.log.reader import read_trace_states
from wcsim.log.records import Header, WorldState, with_fields
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.towns.sumo.tools import sumo_home
from wcsim.towns.sumo.xml_io import read_root

XSD = "{http://www.w3.org/2001/XMLSchema}"


@pytest.fixture(scope="module")
def run(corner_town, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    order = RecordOrder(seconds=8.0, seed=3, chairs=1, folder=folder, outputs=("fcd",))
    record_town(corner_town, quick_config(), order, lambda scenario: None)
    convert_to_fcd(folder / TRACE, folder / "replay.xml")
    return folder


def steps(path: Path) -> dict[float, dict[str, Element]]:
    root = read_root(path)
    return {float(step.get("time", "nan")): {child.get("id", ""): child for child in step} for step in root}


def test_a_replay_has_the_times_and_places_of_sumos_own_data(run):
    theirs, ours = steps(run / "sumo" / "fcd.xml"), steps(run / "replay.xml")
    assert sorted(ours) == sorted(theirs)
    compared = 0
    for time_s, actors in ours.items():
        assert set(actors) - {"wheelchair.0"} == set(theirs[time_s])
        for name, element in theirs[time_s].items():
            mine = actors[name]
            assert mine.tag == element.tag
            stepped_aside_m = 0.8 if element.tag == "person" else 0.0
            gap = math.hypot(*(float(mine.get(key)) - float(element.get(key)) for key in "xy"))
            assert gap <= 0.015 + stepped_aside_m, (time_s, name)
            turned_deg = (float(mine.get("angle")) - float(element.get("angle")) + 180.0) % 360.0 - 180.0
            assert abs(turned_deg) < 0.02
            compared += 1
    assert compared > 100


def test_the_wheelchair_is_in_it_front_first(run):
    header, records = read_trace_states(run / TRACE)
    element = steps(run / "replay.xml")[0.0]["wheelchair.0"]
    assert (element.tag, element.get("type")) == ("vehicle", "wheelchair")
    axle_m = records[0].plants[0, :2] + header.origin_m
    ahead_m = np.array([float(element.get("x")), float(element.get("y"))]) - axle_m
    heading_rad = math.radians(float(element.get("angle")))
    assert np.allclose(ahead_m, 0.80 * np.array([math.sin(heading_rad), math.cos(heading_rad)]), atol=0.02)


def test_another_wheelchair_has_the_front_of_its_own_plant(corner_town, tmp_path):
    outline = plant_spec(ChairConfig(plant="mwd")).outline
    order = RecordOrder(seconds=0.2, seed=3, chairs=1, folder=tmp_path, outputs=())
    record_town(corner_town, quick_config("chair.plant='mwd'"), order, lambda scenario: None)
    convert_to_fcd(tmp_path / TRACE, tmp_path / "replay.xml")
    header, records = read_trace_states(tmp_path / TRACE)
    element = steps(tmp_path / "replay.xml")[0.0]["wheelchair.0"]
    front_m = np.array([float(element.get("x")), float(element.get("y"))])
    assert math.dist(front_m, records[0].plants[0, :2] + header.origin_m) == pytest.approx(outline.front_x_m, abs=0.02)
    assert outline.front_x_m < 0.7  # 0.8 m with plant rwd


def test_elements_and_attributes_are_those_of_sumos_schema(run):
    schema = read_root(sumo_home() / "data" / "xsd" / "fcd_file.xsd")
    known = {
        "vehicle": schema.find(f"{XSD}element[@name='vehicle']"),
        "person": schema.find(f"{XSD}complexType[@name='transportableType']"),
    }
    root = read_root(run / "replay.xml")
    assert root.tag == "fcd-export"
    for step in root:
        assert (step.tag, set(step.attrib)) == ("timestep", {"time"})
        tags = [child.tag for child in step]
        assert tags == sorted(tags, reverse=True)  # vehicles before persons
        for child in step:
            allowed = {item.get("name"): item.get("type") for item in known[child.tag].iter(f"{XSD}attribute")}
            assert set(child.attrib) <= set(allowed)
            for key, value in child.attrib.items():
                if allowed[key] != "xsd:string":
                    assert math.isfinite(float(value)) and ("nonNegative" not in allowed[key] or float(value) >= 0)


def test_what_cannot_be_replayed_is_refused(run, tmp_path):
    with pytest.raises(WcsimError, match=r"no tick of epoch 4; expected --epoch with one of: 0"):
        convert_to_fcd(run / TRACE, tmp_path / "x.xml", epoch=4)
    old = WorldState(
        epoch=0,
        tick=1,
        commands=np.zeros((0, 2)),
        plants=np.zeros((0, 15)),
        actor_ids=("v:a",),
        actors=np.zeros((1, 8)),
        state_hash="x",
    )
    header = Header(town="o", seed=1, tick_s=0.1, seats=0, fingerprint="f")
    assert read_trace_states(write_log(tmp_path / "old", header, [old]))[1][0].bodies == ()
    with pytest.raises(WcsimError, match="older version"):
        convert_to_fcd(tmp_path / "old", tmp_path / "x.xml")
    chair = with_fields(old, actor_ids=(), actors=np.zeros((0, 8)), plants=np.zeros((1, 15)), commands=np.zeros((1, 2)))
    bare = write_log(tmp_path / "c", with_fields(header, seats=1), [chair])
    with pytest.raises(WcsimError, match="without the sizes of actors and chairs"):
        convert_to_fcd(bare, tmp_path / "x.xml")
