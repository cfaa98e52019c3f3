"""Simulated faults over the real cores: any failing run is told by its seed; see `tests.server.faults`."""

import pytest

from tests.server import faults
from tests.server.faults import Simulation
from tests.server.model import bugs

SEEDS = 1_000
MORE_SEEDS = 20_000


def run(seeds: range) -> int:
    """Ticks of all these runs."""
    ticks = 0
    for seed in seeds:
        try:
            ticks += len(Simulation(seed).run().journal)
        except Exception as error:
            raise AssertionError(f"see it with: python -m tests.server.faults {seed}") from error
    return ticks


@pytest.mark.parametrize("part", range(4))
def test_no_fault_costs_a_step_or_stops_anybody(part: int) -> None:
    each = SEEDS // 4
    assert run(range(part * each, (part + 1) * each)) > 5 * each


@pytest.mark.proof
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("part", range(10))
def test_many_more_seeds(part: int) -> None:
    each = (MORE_SEEDS - SEEDS) // 10
    assert run(range(SEEDS + part * each, SEEDS + (part + 1) * each)) > 5 * each


def test_one_seed_is_one_run() -> None:
    first, again, other = (Simulation(seed).run() for seed in (7, 7, 8))
    assert (first.journal, first.hash) == (again.journal, again.hash)
    assert first.hash != other.hash


@pytest.mark.parametrize(
    "name, core",
    [
        ("ServerCore", bugs.TooEarly),
        ("ServerCore", bugs.LosesAnAction),
        ("ServerCore", bugs.StepsTwice),
        ("ServerCore", bugs.AnyTick),
        ("ServerCore", bugs.NoLease),
        ("ServerCore", bugs.NotLookedAtAgain),
        ("ClientCore", bugs.ShowsAnyFrame),
        ("ClientCore", bugs.NeverAsksAgain),
    ],
)
def test_a_core_with_a_fault_is_found(monkeypatch: pytest.MonkeyPatch, name: str, core: type) -> None:
    monkeypatch.setattr(faults, name, core)
    with pytest.raises(AssertionError, match="see it with"):
        run(range(100))
