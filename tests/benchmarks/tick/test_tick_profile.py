"""Own times of Bullet's zones, and a profile of a world that names native functions."""

from benchmarks.tick.tick_profile import DEAREST, own_times, profiled
from wcsim.config import resolve
from wcsim.towns.scenario.town import find_town


def event(ph, name, us):
    return {"ph": ph, "name": name, "ts": us}


def test_a_zone_s_own_time_is_without_the_zones_inside_and_outside_of_a_step_nothing_counts():
    events = [
        event("B", "CMD_STEP0", 0.0),
        event("B", "solve2", 20.0),  # written out of order, as PyBullet does
        event("E", "solve2", 50.0),
        event("B", "solve3", 60.0),
        event("E", "solve3", 70.0),
        event("B", "internalSingleStepSimulation1", 10.0),
        event("E", "internalSingleStepSimulation1", 110.0),
        event("E", "CMD_STEP0", 200.0),
        event("E", "never begun", 300.0),
    ]
    found = {row.name: (row.calls, round(row.own_ms, 6)) for row in own_times(events, 2)}
    assert found == {"internalSingleStepSimulation": (0.5, 0.03), "solve": (1.0, 0.02)}


def test_the_dearest_functions_of_a_world_are_named_by_part_native_ones_too():
    # Pictures so large that to draw them is dear on any machine.
    config = resolve("quick", "world.warmup_s=5", "cameras.0.width_px=320", "cameras.0.height_px=240")
    rows = profiled(find_town("helsinki"), config, chairs=1, ticks=30, seed=1)
    assert len(rows) == DEAREST
    assert [row.own_ms for row in rows] == sorted((row.own_ms for row in rows), reverse=True)
    assert {"SUMO", "Bullet", "physics/renderer"} <= {row.part for row in rows}
    assert any(row.part == "Bullet" and not row.name.startswith("pybullet.") for row in rows)  # a zone
    assert not any(row.name == "pybullet.stepSimulation" for row in rows)
    assert 0.3 < sum(row.share for row in rows) <= 1.0
