import pytest

from benchmarks.barrier.barrier_cost import measure_barrier
from tests.support.worlds import quick_config


@pytest.mark.parametrize("remote", [False, True], ids=["ipc", "tcp"])
def test_the_barrier_costs_a_few_bare_messages(remote):
    for _ in range(3):  # what else runs on the cores can hold a bench up for as long as it lasts, but not each of three
        cost = measure_barrier(quick_config(), clients=2, ticks=150, remote=remote)
        assert 0.0 < cost.echo_median_ms <= cost.echo_p99_ms
        assert 0.0 < cost.median_ms <= cost.p99_ms
        if cost.median_ms < 8.0 * cost.echo_median_ms:  # about 2.5; a message that waits for a timer makes it 100
            return
    pytest.fail(f"barrier {cost.median_ms:.3f} ms, bare echo {cost.echo_median_ms:.3f} ms, and so three times")


@pytest.mark.proof
def test_six_clients_with_pictures_stay_near_the_bare_echo():
    config = quick_config("cameras.0.width_px=320", "cameras.0.height_px=240")
    costs = [measure_barrier(config, 6, 1000, remote=False) for _ in range(3)]  # as above
    assert min(cost.median_ms / cost.echo_median_ms for cost in costs) < 4.0, costs
