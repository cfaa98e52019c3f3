import pytest
import torch

from wcsim.agents.networks.costs import LIMIT_MS, RESERVE_MS, _NetworkCost, measure_network_cost


def test_what_a_network_costs_is_counted_and_timed():
    threads = torch.get_num_threads()
    small, deep = (measure_network_cost(name, 60, 80, runs=3) for name in ("patch", "fig6"))
    assert torch.get_num_threads() == threads
    assert (small.window, deep.window) == (1, 4)
    assert 50_000 < small.params < deep.params < 1_000_000
    assert 4 * small.macs < 1.1 * deep.macs, "it looks at four pictures"
    assert 0.0 < small.p50_ms <= small.p99_ms and small.mb > 4e-6 * small.params


def test_a_first_layer_is_counted_as_it_is_made():
    """Patches of 4x4 pixels of 11 planes to 24 channels: 15 x 20 places in a picture of 60x80."""
    assert measure_network_cost("patch", 60, 80, runs=1).macs > 15 * 20 * 24 * 11 * 16


@pytest.mark.parametrize("more_ms, fits", [(-1.0, True), (1.0, False)])
def test_a_tick_has_a_reserve_for_the_segmentation(more_ms, fits):
    p99_ms = LIMIT_MS - RESERVE_MS + more_ms
    cost = _NetworkCost(name="a", window=1, params=1, macs=1, mb=1.0, p50_ms=1.0, p99_ms=p99_ms, onnx_p50_ms=None)
    assert cost.within_100_ms is fits
