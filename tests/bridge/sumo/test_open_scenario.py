from contextlib import ExitStack

import numpy as np
import pytest

from tests.support.worlds import quick_config
from tests.towns.made import hostile
from wcsim.bridge.sumo.open_scenario import open_scenario
from wcsim.bridge.sumo.session import SumoOptions, SumoSession, world_in_this_process
from wcsim.bridge.world import World
from wcsim.errors import TownError
from wcsim.towns.scenario.overrides import Settings
from wcsim.towns.scenario.town import Town, open_town
from wcsim.types.episode import RunPlace

SETTINGS = Settings(world=quick_config().world, seed=1)


@pytest.fixture
def sound(corner_town) -> Town:
    return corner_town


@pytest.fixture
def open_theirs(sound, tmp_path):
    """Writes a stranger's scenario on the corner's streets into `theirs` and opens it; see `hostile.scenario`."""
    return lambda *written: open_town(hostile.scenario(sound, tmp_path / "theirs", *written))


def test_a_scenario_that_kills_sumo_is_refused_and_not_remembered(open_theirs, own_cache):
    broken = '<flow id="f" begin="0" period="1"><route edges="nowhere"/></flow>'
    town = open_theirs("", "", broken)
    said = r"a\.rou\.xml: SUMO cannot run this scenario.*nowhere"
    for _ in range(2):
        with ExitStack() as held, pytest.raises(TownError, match=said):
            open_scenario(town, SETTINGS, RunPlace(), held)
    assert not list(own_cache.rglob("scenario-*"))


def test_without_a_run_folder_nothing_is_left(open_theirs, tmp_path):
    town = open_theirs("<summary value='s.xml'/>")
    before = {path.name for path in (tmp_path / "theirs").iterdir()}
    with World(town, quick_config(), (), 1) as world:
        world.tick(())
        folder = world.scenario.sumocfg.parent
        assert (folder / "s.xml").is_file()
    assert not folder.exists()
    assert {path.name for path in (tmp_path / "theirs").iterdir()} == before


def test_a_second_sitting_of_a_run_keeps_the_first_ones_outputs(open_theirs, tmp_path):
    town = open_theirs("<summary value='s.xml'/>")
    for _ in range(2):
        with World(town, quick_config(), (), 1, RunPlace(folder=tmp_path / "run")) as world:
            world.tick(())
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["sumo", "sumo-2"]
    assert all((tmp_path / "run" / name / "s.xml").stat().st_size > 300 for name in ("sumo", "sumo-2"))


def test_the_authors_end_does_not_end_the_run_and_his_begin_begins_it(sound, open_theirs):
    edge = hostile.lane_of(sound).rpartition("_")[0]
    flow = f'<flow id="f" begin="100" number="4"><route edges="{edge}"/></flow>'
    town = open_theirs("<begin value='100'/><end value='0:01:48'/>", "", flow)
    with ExitStack() as held:
        scenario = open_scenario(town, SETTINGS, RunPlace(), held)
        options = SumoOptions(sumocfg=scenario.sumocfg, origin_m=(0, 0), settings=SETTINGS)
        session = held.enter_context(SumoSession(options))
        seen = set()
        for _ in range(150):
            session.step()
            seen |= {actor.id for actor in session.actors(np.zeros((1, 2)), 1e9)}
        assert session.time_s() == pytest.approx(115.0)
        assert seen == {f"v:f.{k}" for k in range(4)}  # spread over the 8 s up to the author's end
    assert scenario.begin_s == 100.0
    assert not world_in_this_process()


def test_the_authors_time_to_teleport_holds_unless_the_run_sets_it(open_theirs):
    import libsumo

    town = open_theirs("<time-to-teleport value='77'/><scale value='2'/>")
    for overrides, wanted in (((), "77"), (("world.jam_teleport_s=12", "world.demand_scale=1.5"), "12.0")):
        with World(town, quick_config(*overrides), (), 1):
            assert libsumo.simulation.getOption("time-to-teleport") == wanted
            assert float(libsumo.simulation.getOption("scale")) == (3.0 if overrides else 2.0)


@pytest.mark.parametrize(
    "written, said",
    [
        (("<default.carfollowmodel value='fly'/>",), r"a\.sumocfg: SUMO cannot run this scenario.*'fly'"),
        # SUMO 1.28 keeps devices that send from one simulation to the next, and dies of them.
        (("<device.btsender.probability value='1'/>",), r"a\.sumocfg: SUMO crashes when .* again .*btsender"),
        (("", '<busStop id="b" lane="nowhere_0"/>'), r"a\.add\.xml: SUMO cannot run .*nowhere.*sumo -c"),
        (
            ("", "", '<trip id="t" depart="0" from="nowhere" to="nowhere"/>'),
            r"a\.rou\.xml: SUMO cannot run .*nowhere.*sumo -c",
        ),
    ],
    ids=["no such model", "kills the next one", "additional", "routes"],
)
def test_the_file_that_is_wrong_is_named(open_theirs, written, said):
    town = open_theirs(*written)
    with ExitStack() as held, pytest.raises(TownError, match=said):
        open_scenario(town, SETTINGS, RunPlace(), held)
