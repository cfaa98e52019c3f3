"""People who walk by SUMO's JuPedSim: what holds of them, what does not, and that a scenario it dies of is refused."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from benchmarks.reaction.engineless_world import ReactionStage
from wcsim.bridge.reaction.commands import ActorCommand
from wcsim.bridge.sumo.open_scenario import open_scenario
from wcsim.config import WorldConfig
from wcsim.errors import TownError
from wcsim.towns.scenario.overrides import Settings
from wcsim.towns.scenario.stage import scenario_overrides
from wcsim.towns.scenario.town import Town
from wcsim.towns.scene_folders.build import build_scene, find_scene
from wcsim.towns.street import load_street
from wcsim.towns.sumo.xml_io import read_root, xml_bytes
from wcsim.types import Street
from wcsim.types.episode import RunPlace

ISLAND = {
    "street.nod.xml": '<node id="I" x="0" y="90"/><node id="J" x="30" y="90"/>',
    "street.edg.xml": '<edge id="island" from="I" to="J" numLanes="1" width="2" allow="pedestrian"/>',
    "street.rou.xml": '<person id="far" depart="15"><walk edges="island" arrivalPos="20"/></person>',
}
CONFIG = WorldConfig(street="jupedsim", attention_share=1.0)


@pytest.fixture(scope="module")
def gate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Town, Street]:
    town, _ = build_scene(find_scene("narrow-gate"), tmp_path_factory.mktemp("gate"))
    return town, load_street(town)


def test_ids_and_sidesteps_are_kept_and_equal_seeds_give_equal_people(gate: tuple[Town, Street]) -> None:
    runs, aside = [], set()
    for seed in (3, 3):
        with ReactionStage(*gate, CONFIG, seed, 2.0) as stage:
            chair = stage.chair(np.array([-4.0, 0.0]), 0.0)
            for _ in range(60):
                actors = stage.tick((chair,))
                aside |= {actor.id for actor in actors if abs(actor.deflect_m) > 0.2}
            runs.append([(actor.id, *actor.p_W_m.tolist(), actor.deflect_m) for actor in actors])
    assert runs[0] == runs[1]
    assert {row[0] for row in runs[0]} == {f"p:walker.{i:02d}" for i in range(26)}
    assert len(aside) > 3


def test_an_order_to_stand_has_no_effect_and_nobody_is_removed(gate: tuple[Town, Street]) -> None:
    """SUMO 1.28: docs/validation.md says so; whoever finds this red may take the hint away."""
    with ReactionStage(*gate, CONFIG, 3, 2.0) as stage:
        here = np.array([[-10.0, 0.0]])
        before = {actor.id: float(actor.p_W_m[0]) for actor in stage.near(here, 90.0)}
        assert not stage._sumo.turn_away("p:walker.20")
        for _ in range(20):
            for name in before:
                stage.apply(ActorCommand(actor_id=name, speed_mps=0.0))
            stage.tick(())
        after = {actor.id: float(actor.p_W_m[0]) for actor in stage.near(here, 90.0)}
    assert set(after) == set(before)
    assert sum(after[name] > x_m + 1.0 for name, x_m in before.items()) > 13


@pytest.mark.usefixtures("own_cache")
def test_a_walk_off_the_connected_area_kills_sumo_and_is_refused_first(tmp_path: Path) -> None:
    island = tmp_path / "island"
    island.mkdir()
    for file in find_scene("narrow-gate").glob("s*.*ml"):
        text, more = file.read_text(), ISLAND.get(file.name, "")
        head, end, tail = text.rpartition("</")
        (island / file.name).write_text(f"{head}{more}{end}{tail}")
    broken, _ = build_scene(island, tmp_path / "broken")
    with ExitStack() as held, pytest.raises(TownError, match=r"people walk by JuPedSim .*expected pedestrian\.model"):
        open_scenario(broken, Settings(world=CONFIG, seed=1), RunPlace(), held)


@pytest.mark.parametrize("ground", ["edge[@function='walkingarea']/lane", "junction"])
@pytest.mark.usefixtures("own_cache")
def test_ground_without_width_is_widened_before_sumo_dies_of_it(tmp_path: Path, ground: str) -> None:
    thin, _ = build_scene(find_scene("pedestrian-crossing"), tmp_path / "thin")
    root = read_root(thin.net)
    areas = root.findall(ground)
    first, last, *_ = areas[0].attrib["shape"].split()
    areas[0].set("shape", f"{first} {last} {first}")  # as netconvert writes it where streets are cut
    thin.net.write_bytes(xml_bytes(root))
    with ExitStack() as held:
        open_scenario(thin, Settings(world=CONFIG, seed=1), RunPlace(), held)
    for world, is_widened in ((CONFIG, True), (WorldConfig(), False)):
        rows = {row.option: row for row in scenario_overrides(thin, Settings(world=world, seed=1))}
        assert ("net-file" in rows) == is_widened
