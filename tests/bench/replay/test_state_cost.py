"""The bench of the replay: it keeps what was driven, and noise costs more than none."""

import pytest

from tests.support.worlds import quick_config
from wcsim.bench.replay import state_cost as bench
from wcsim.bench.replay.state_cost import StateCost, measure_states
from wcsim.cli.main import main
from wcsim.config import with_overrides
from wcsim.towns.scenario.town import find_town


def test_states_are_kept_and_counted(corner, tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "MANY_STATES", 1000)
    town, costs, told = find_town(str(corner)), {}, []
    for noise in ("none", "typical"):
        config = with_overrides(quick_config(), (f"cameras.0.noise={noise}",))
        costs[noise] = measure_states(town, config, 12, 1, tmp_path / noise, told.append)
    assert told == 2 * list(range(1, 13))
    assert 0 < costs["none"].kb_per_state < costs["typical"].kb_per_state
    assert all(cost.write_ms > 0 and cost.read_ms > 0 and cost.states == 12 for cost in costs.values())
    least_mb = 1000 * (16 + 4 * 7 + 8) / 1e6
    assert least_mb < costs["none"].memory_mb < 10 * least_mb


@pytest.mark.parametrize(("size", "code"), [((), 1), (("--width", "640", "--height", "480"), 0)])
def test_bounds_are_for_pictures_of_the_usual_size(corner, monkeypatch, capsys, size, code):
    large = StateCost(kb_per_state=30.0, write_ms=0.1, read_ms=0.1, memory_mb=1.0, states=10)
    monkeypatch.setattr(bench, "measure_states", lambda *given: large)
    assert main(["bench", "replay", "--town", str(corner), *size]) == code
    told = capsys.readouterr()
    assert "30.00" in told.out
    assert ("kb_per_state_noisy is 30.00; expected at most 25.0" in told.err) == bool(code)
