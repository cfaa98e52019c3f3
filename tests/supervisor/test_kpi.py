"""Indicators against hand-made numbers; nothing is ever NaN."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.errors import ConfigError
from wcsim.supervisor.kpi import KpiMeter, StepLog, summarise


def test_a_small_test_by_hand():
    meter = KpiMeter()
    for distance, free in ((0.0, True), (0.1768, True), (1.0, False), (2.0, None)):
        meter.add(distance, free, 1.5, 0.1)
    meter.end_episode(3, True)
    meter.end_episode(1, False)
    row = meter.row()
    assert (row.steps, row.episodes, row.crashes) == (4, 2, 1)
    assert row.distance_mean == pytest.approx(3.1768 / 4)
    assert row.share_within == 0.5
    assert row.distance_free_mean == pytest.approx(0.0884)
    assert row.distance_danger_mean == 1.0
    assert row.free_share == pytest.approx(2 / 3)
    assert row.steps_alive_mean == 2.0
    assert row.steps_alive_median == 2.0
    assert row.km == pytest.approx(0.0006)
    assert row.speed_mean_mps == pytest.approx(1.5)
    assert row.crashes_per_km == pytest.approx(1 / 0.0006)
    assert row.crashes_per_1000_steps == 250.0
    assert row.hours == pytest.approx(0.4 / 3600)


def test_nothing_measured_is_none_and_json():
    row = KpiMeter().row()
    assert row.steps == row.episodes == 0
    assert row.distance_mean is None and row.steps_alive_mean is None and row.crashes_per_km is None
    json.dumps(dataclasses.asdict(row), allow_nan=False)


def test_a_standing_chair_has_no_crashes_per_km():
    meter = KpiMeter()
    meter.add(0.5, None, 0.0, 0.1)
    meter.end_episode(1, True)
    row = meter.row()
    assert row.crashes_per_km is None and row.free_share is None and row.distance_free_mean is None
    assert row.speed_mean_mps == 0.0


def test_reversing_is_a_way_driven_but_no_speed_gained():
    meter = KpiMeter()
    meter.add(0.0, None, 1.0, 1.0)
    meter.add(0.0, None, -1.0, 1.0)
    row = meter.row()
    assert row.km == pytest.approx(0.002) and row.speed_mean_mps == 0.0


steps = st.tuples(st.floats(0, 2), st.sampled_from([None, True, False]), st.floats(-1, 2), st.just(0.1))


@given(st.lists(steps, max_size=20), st.lists(st.tuples(st.integers(1, 10_000), st.booleans()), max_size=5))
def test_never_nan_and_within_bounds(taken, episodes):
    meter = KpiMeter()
    for step in taken:
        meter.add(*step)
    for end in episodes:
        meter.end_episode(*end)
    row = meter.row()
    for value in dataclasses.asdict(row).values():
        assert value is None or math.isfinite(value)
    if taken:
        assert 0.0 <= row.distance_mean <= 2.0 and 0.0 <= row.share_within <= 1.0


def test_lengths_must_agree():
    log = KpiMeter().log()
    with pytest.raises(ConfigError, match="lengths"):
        summarise(dataclasses.replace(log, distance=np.zeros(3)))
    assert isinstance(log, StepLog)
