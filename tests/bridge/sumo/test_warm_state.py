"""States of warmed traffic: the same world with and without one, nobody lost, and ticks where SUMO dies of it."""

import shutil
import sys
from collections import Counter
from contextlib import ExitStack

import libsumo
import pytest

from tests.support.worlds import quick_config
from tests.towns.made import hostile
from wcsim.bridge.sumo.session import SumoSession, open_session
from wcsim.bridge.sumo.warm_state import mend_state, read_state, save_state
from wcsim.towns.scenario.town import Town, find_town, open_town
from wcsim.types.episode import RunPlace


@pytest.fixture(autouse=True)
def cache(own_cache):
    return own_cache / "wcsim"


def session_of(town: Town, held: ExitStack, seed: int = 3, *overrides: str) -> SumoSession:
    return open_session(town, quick_config(*overrides), seed, RunPlace(), 0.0, held)[1]


def street(sumo: SumoSession, ticks: int = 40) -> list:
    """Who is where now, and after some ticks."""
    before = sumo.everyone()
    for _ in range(ticks):
        sumo.step()
    return [(a.id, a.p_W_m.tolist(), a.v_W_mps.tolist(), a.signals) for a in (*before, *sumo.everyone())]


@pytest.mark.parametrize("scale", ["1.0", "0.25", "1.5"])
def test_a_state_that_is_made_and_one_that_is_found_give_the_same_street(cache, scale):
    wanted, town = f"world.demand_scale={scale}", find_town("helsinki")
    with ExitStack() as held:
        sumo = session_of(town, held, 3, "world.warmup_s=120", wanted)
        seed = sumo._options.settings.seed
        assert (sumo.time_s(), sumo.counts()[0] > 20) == (120.0, True)
        made = street(sumo)
        sumo.rebuild(7)
        other = street(sumo)
        sumo.rebuild(seed)
        found = [street(sumo)]
        sumo.rebuild(seed)  # with other garbage in memory
        found.append(street(sumo))
    assert len(list(cache.glob("warm-*.xml.gz"))) == 4  # two of the trial, and two of these seeds
    with ExitStack() as held:
        found.append(street(session_of(town, held, 3, "world.warmup_s=120", wanted)))
    assert found == [made] * 3
    assert made != other


def test_a_state_that_is_made_again_in_a_process_with_a_history_is_the_same(cache):
    town, streets, states = find_town("helsinki"), [], []
    for _ in range(2):
        with ExitStack() as held:
            streets.append(street(session_of(town, held, 3, "world.warmup_s=60"), 5))
        files = {path: read_state(path) for path in cache.glob("warm-*.xml.gz")}
        states.append({path: state.partition(b"<snapshot")[2] for path, state in files.items() if state})
        for path in files:
            path.write_bytes(path.read_bytes()[:-100])  # damaged: the world makes its own again
    assert streets[0] == streets[1]
    assert len(states[1]) == 1
    assert states[1].items() <= states[0].items()


def test_nobody_who_departs_later_is_lost(corner_town, tmp_path):
    """SUMO's own state would lose all whose flow begins when its reader of routes has stopped."""
    edge = hostile.lane_of(corner_town).rpartition("_")[0]
    flows = "".join(
        f'<flow id="f{batch}.{number}" begin="{batch * 200}" end="{batch * 200 + 200}" period="exp(0.01)">'
        f'<route edges="{edge}"/></flow>'
        for batch in range(6)
        for number in range(10)
    )
    town = open_town(hostile.scenario(corner_town, tmp_path / "theirs", "", "", flows))
    with ExitStack() as held:
        sumo, departed = session_of(town, held, 3, "world.warmup_s=60"), Counter()
        while sumo.time_s() < 1000.0:
            sumo.step()
            departed.update(int(sumo.time_s() // 200) for name in sumo.spawned)
    assert [departed[batch] > 8 for batch in range(1, 5)] == [True] * 4, departed


def test_a_scenario_whose_state_kills_sumo_is_warmed_up_by_ticks(corner_town, monkeypatch, cache):
    with ExitStack() as held:
        session_of(corner_town, held, 3, "world.warmup_s=0")
    monkeypatch.setattr(sys, "executable", shutil.which("false"))  # the child that tries a state
    for _ in range(2):
        with ExitStack() as held:
            sumo = session_of(corner_town, held, 3, "world.warmup_s=60")
            assert sumo.time_s() == pytest.approx(60.0)
            assert libsumo.simulation.getOption("load-state") == ""
        assert [path.read_bytes() for path in cache.glob("state-*.ok")] == [b"fails\n"]
    assert not list(cache.glob("warm-*"))


def test_a_mended_state_reads_a_millisecond_earlier_and_has_no_advice():
    state = b'<delay number="1" loaderTime="600000"/><vehicle pos="1 2" lcStateBase="5.0 0.2 7.0"/>'
    assert mend_state(state) == b'<delay number="1" loaderTime="599999"/><vehicle pos="1 2" lcStateBase="5.0"/>'
    assert mend_state(b'<delay loaderTime="0"/>') == b'<delay loaderTime="0"/>'


def test_whatever_damages_a_state_makes_it_none(tmp_path):
    path = tmp_path / "warm.xml.gz"
    save_state(path, bytes(range(256)) * 40)
    whole = path.read_bytes()
    assert read_state(path) == bytes(range(256)) * 40
    for place in range(len(whole)):
        path.write_bytes(whole[:place])
        assert read_state(path) is None
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 255]) + whole[place + 1 :])
        assert read_state(path) in (None, bytes(range(256)) * 40)
    assert read_state(tmp_path / "none") is None
