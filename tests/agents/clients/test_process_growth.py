"""A client whose process has grown is replaced where an epoch has just begun, and not before."""

from collections.abc import Iterable

import pytest

from wcsim.agents.clients.client import SETTLED_STEPS, _ProcessGrowth
from wcsim.config import LearnConfig

LEARN = LearnConfig(replay_frames=1000, process_growth_mb=50.0)


def asked_at(epochs: Iterable[tuple[int, int]], memory_mb: dict[int, float]) -> list[int]:
    """The steps at which an end was asked for, of (step, epoch); memory by step, as of the last one named."""
    now, asked = 0, []

    def mb_now() -> float:
        return next(mb for at, mb in sorted(memory_mb.items(), reverse=True) if at <= now)

    growth = _ProcessGrowth(LEARN, mb_now, lambda: asked.append(now))
    for now, epoch in epochs:
        growth.check(now, epoch)
    assert bool(growth.reason) == bool(asked)
    return asked


def steps(first: int, last: int, stride: int = 1) -> list[tuple[int, int]]:
    return [(step, step // 500) for step in range(first, last, stride)]


@pytest.mark.parametrize("grown_by", [1100, 1499, 1500])
def test_it_is_asked_once_at_the_first_step_of_an_epoch(grown_by):
    assert asked_at(steps(0, 4000), {0: 300.0, grown_by: 351.0}) == [1500]


def test_steps_count_and_not_how_often_it_looks():
    assert asked_at(steps(0, 4000, stride=4), {0: 300.0, 1100: 351.0}) == [1500]
    assert asked_at(steps(6000, 9000, stride=4), {0: 100.0, 6204: 151.0}) == []
    assert asked_at(steps(6000, 9000, stride=4), {0: 100.0, 6208: 151.0}) == [6500]


def test_what_grows_no_further_than_it_may_goes_on():
    assert asked_at(steps(0, 9000), {0: 300.0, 1200: 349.0}) == []


def test_a_replay_that_fills_up_is_no_growth():
    assert asked_at(steps(0, 9000), {0: 100.0, 900: 500.0}) == []


def test_a_life_that_begins_with_a_full_replay_settles_first():
    begun = 6000
    assert asked_at(steps(begun, 9000), {0: 100.0, begun + SETTLED_STEPS: 500.0}) == []
    assert asked_at(steps(begun, 9000), {0: 100.0, begun + SETTLED_STEPS: 500.0, 6600: 551.0}) == [7000]
