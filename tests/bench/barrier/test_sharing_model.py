"""What sharing a world would save elsewhere: the arithmetic of the model."""

from __future__ import annotations

from dataclasses import replace

import pytest

from wcsim.bench.barrier.sharing_model import (
    ClientCost,
    SharingParts,
    apart_s,
    saved,
    start_s,
    tick_s,
    together_s,
    world_tick_s,
)

QUICK = ClientCost(name="quick", act_s=1.0, learn_s=1.0)
SLOW = ClientCost(name="slow", act_s=1.0, learn_s=7.0)
PARTS = SharingParts(clients=(QUICK, SLOW), world_s={1: 3.0, 3: 5.0}, barrier_s=0.5, start_s=20.0, start_cores=2)


def test_a_world_with_more_chairs_lies_on_the_line_through_those_that_were_measured():
    assert [world_tick_s(PARTS, n) for n in (1, 2, 3, 6)] == pytest.approx([3.0, 4.0, 5.0, 8.0])
    assert world_tick_s(replace(PARTS, world_s={1: 3.0}), 6) == 3.0


def test_a_tick_waits_for_the_slowest_and_for_cores():
    pair, six = [QUICK, SLOW], [QUICK] * 6
    assert [tick_s(PARTS, pair, cores) for cores in (1, 2, 8)] == pytest.approx([4.5 + 10.0, 4.5 + 8.0, 4.5 + 8.0])
    assert [tick_s(PARTS, six, cores) for cores in (2, 8)] == pytest.approx([8.5 + 6.0, 8.5 + 2.0])


def test_who_learns_while_waiting_hides_the_world_behind_the_slowest():
    later = replace(PARTS, later=True)
    assert tick_s(later, [QUICK, SLOW], 8) == pytest.approx(8.0), "the slow one needs no more than its own time"
    assert tick_s(later, [QUICK, QUICK], 8) == pytest.approx(4.5 + 1.0), "the world, and acting"
    assert tick_s(later, [QUICK, SLOW], 1) == tick_s(PARTS, [QUICK, SLOW], 1), "one core hides nothing"


def test_starts_and_runs_add_up():
    assert [start_s(PARTS, n, cores) for n, cores in ((1, 2), (5, 2), (5, 8), (1, 1))] == [20.0, 60.0, 20.0, 40.0]
    assert together_s(PARTS, [QUICK], 10, 2) == pytest.approx(20.0 + 10 * (3.5 + 2.0))
    assert apart_s(PARTS, [QUICK, SLOW], 10, 2) == pytest.approx(40.0 + 10 * (2 * 3.5 + 10.0))


def test_what_was_saved_adds_up_to_the_difference():
    found = saved(replace(PARTS, world_s={1: 3.0, 2: 4.0}), 10, [(100.0, 20.0), (150.0, 20.0)], (180.0, 25.0))
    assert (found.world_s, found.start_s) == (20.0, 15.0)
    assert found.world_s + found.start_s + found.rest_s == 250.0 - 180.0
