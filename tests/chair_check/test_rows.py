"""The table of the plants: every row as expected, hardly moved by the step; a few rows of it in no time."""

import dataclasses
from pathlib import Path

import pytest

from wcsim.chair_check import kerbs, mass_rig
from wcsim.chair_check.kerbs import RUN_UP_M
from wcsim.chair_check.row import TrialResult, TrialSetup, TrialSpec, compare_rows, run_trial
from wcsim.chair_check.table import _trials, list_too_fast_trials, run_plant_trials
from wcsim.config import ChairConfig, ImuConfig
from wcsim.core.constants import KERB_STEP_M
from wcsim.errors import ConfigError, PhysicsError
from wcsim.physics.wheelchair.plant import plant_spec


def table_of(plant, hz, only=(), workers=1):
    return run_plant_trials(TrialSetup(chair=ChairConfig(plant=plant), hz=hz), only, workers)


EACH_PLANT = pytest.mark.parametrize("plant", ["rwd", "mwd"])


@pytest.fixture
def names_alone(monkeypatch):
    """The tip angles that are expected are not looked for: that takes seconds a plant."""
    monkeypatch.setattr(mass_rig, "_expected_tip_rad", lambda *way: 0.3)


QUICK = ("mass", "inertia", "turning", "stopping_6", "climb_10", "kerb_40mm_standstill", "kerb_120mm_run_up")


@EACH_PLANT
def test_some_rows_are_as_expected(plant):
    rows = table_of(plant, 240, QUICK)
    assert len(rows) == 9
    assert [row.name for row in rows if not row.ok] == []


@pytest.mark.usefixtures("names_alone")
@EACH_PLANT
def test_the_table_asks_what_it_must(plant):
    names = {trial.name for trial in _trials(TrialSetup(chair=ChairConfig(plant=plant), hz=240))}
    assert {"straight_drift_10m", "stopping_10kmh", "kerb_120mm_standstill", "event_wall_6kmh"} <= names
    assert {"tip_rear_com_50cm", "tip_lateral_com_60cm", "falls_off_30cm_at_25deg", "cross_slope_10deg"} <= names
    assert ("tip_rear_no_antitips_com_50cm" in names) == (plant == "rwd")
    assert ("kerb_50mm_standstill" in names) == (plant == "rwd")
    assert "kerb_50mm_run_up" in names


@EACH_PLANT
def test_a_plant_declares_what_it_does_at_the_highest_kerb_that_counts_as_lowered(plant):
    setup = TrialSetup(chair=ChairConfig(plant=plant), hz=240)
    declared = plant_spec(setup.chair).climbs
    for rises_m, run_up_m in ((declared.standstill_m, 0.0), (declared.run_up_m, RUN_UP_M)):
        assert kerbs._kerb_climbed(setup, KERB_STEP_M, run_up_m) == (KERB_STEP_M in rises_m)
    assert KERB_STEP_M in declared.run_up_m, "the street counts on it"


def test_a_tip_angle_is_found_where_geometry_says():
    (row,) = table_of("rwd", 120, ("tip_rear_no_antitips_com_60cm",))
    assert row.ok and row.value == pytest.approx(16.7, abs=0.2)


def test_the_same_trial_gives_the_same_value_in_a_pool():
    here, there = (table_of("rwd", 120, ("drive_wheel", "inertia_yaw"), workers) for workers in (1, 2))
    assert here == there


WORDS = {"name": "x", "unit": "", "bound": "trial", "low": 1.0, "method": "", "source": ""}


def test_a_row_is_red_outside_its_range_and_a_value_must_be_a_number():
    setup = TrialSetup(chair=ChairConfig(), hz=240)
    assert [
        run_trial(TrialSpec(**WORDS, high=2.0, measure=lambda _, v=v: v), setup).ok for v in (0.9, 1.0, 2.0, 2.1)
    ] == [
        *(False, True, True, False),
    ]
    with pytest.raises(PhysicsError, match="trial x"):
        run_trial(TrialSpec(**WORDS, high=2.0, measure=lambda _: float("nan")), setup)


FWD = str(Path(__file__).parents[2] / "examples" / "fwd.toml")
SLOW = TrialSetup(chair=ChairConfig(plant=FWD, v_max_mps=1.2), hz=120)


def test_rows_that_are_too_fast_for_a_plant_are_left_out():
    assert list_too_fast_trials(SLOW) == ("cruise_road", "stopping_10kmh")
    assert (
        list_too_fast_trials(SLOW, ("stopping_6",))
        == list_too_fast_trials(TrialSetup(chair=ChairConfig(), hz=120))
        == ()
    )
    names = {trial.name for trial in _trials(SLOW, ("cruise", "stopping", "pulling"))}
    assert names == {"cruise_indoor", "cruise_pavement", "stopping_6kmh", "pulling_400N"}
    with pytest.raises(ConfigError, match="stopping_10kmh: faster than the plant"):
        run_plant_trials(SLOW, ("stopping_10",))


def test_the_chairs_own_settings_are_driven():
    (row,) = run_plant_trials(SLOW, ("climb",))
    assert row.ok and row.value == pytest.approx(1.2, rel=0.03)
    here, there = (dataclasses.replace(SLOW, imu=ImuConfig(p_BI_m=(x_m, 0.0, 0.5))) for x_m in (0.0, 0.8))
    (near,), (far,) = (run_plant_trials(setup, ("event_driving",)) for setup in (here, there))
    assert far.value > near.value + 0.1, "far from the axle it feels turns"


@pytest.mark.parametrize("plant, judged", [("rwd", True), ("mwd", True), (FWD, False)])
def test_rows_of_another_kind_of_chair_judge_no_other(plant, judged):
    found = _trials(TrialSetup(chair=ChairConfig(plant=plant), hz=120), ("peak", "falls_off", "kerb", "event"))
    assert {trial.judged for trial in found if trial.bound in ("rwd, mwd", "trial")} == {judged}
    assert all(trial.judged for trial in found if trial.bound not in ("rwd, mwd", "trial"))
    row = run_trial(TrialSpec(**WORDS, high=1.0, measure=lambda _: 0.0, judged=judged), SLOW)
    assert not row.ok and row.red == judged


def test_a_chair_too_weak_to_hold_its_heading_is_told_so(tmp_path):
    weak = Path(FWD).read_text().replace("stall_torque_Nm = 90.0", "stall_torque_Nm = 25.0")
    (tmp_path / "weak.toml").write_text(weak)
    setup = TrialSetup(chair=ChairConfig(plant=str(tmp_path / "weak.toml")), hz=120)
    (row,) = run_plant_trials(setup, ("cross",))
    assert row.red and row.note.startswith(("lost its heading after", "stood still after")) and row.value < 8.0


@pytest.mark.usefixtures("names_alone")
def test_front_antitips_are_taken_off_to_the_front():
    names = {trial.name for trial in _trials(SLOW, ("tip",))}
    assert "tip_forward_no_antitips_com_50cm" in names and "tip_rear_no_antitips_com_50cm" not in names


def test_changes_compare_values_or_where_zero_is_expected_their_bound():
    row = TrialResult(name="a", value=10.0, unit="", bound="wcsim", low=5.0, high=20.0, method="", source="", ok=True)
    near = dataclasses.replace(row, name="b", value=0.001, low=0.0, high=0.05)
    peak = dataclasses.replace(row, name="c", impact=True)
    other = [dataclasses.replace(item, value=1.13 * item.value) for item in (row, near, peak)]
    a, b, c = compare_rows([[row, near, peak], other])
    assert (a.ok, b.ok, c.ok) == (False, True, True)
    assert a.change == c.change == pytest.approx(0.13 / 1.13)
    assert b.change == pytest.approx(0.00013 / 0.05)


@pytest.mark.parametrize("hz", [0, 95, 245, 2000])
def test_a_rate_that_does_not_divide_a_tick_is_refused(hz):
    with pytest.raises(PhysicsError, match=str(hz)):
        TrialSetup(chair=ChairConfig(), hz=hz)


def test_unknown_plants_and_rows_are_refused():
    with pytest.raises(ConfigError, match="hover"):
        table_of("hover", 240)
    with pytest.raises(ConfigError, match="flight"):
        table_of("rwd", 240, ("flight",))


@pytest.mark.proof
@pytest.mark.timeout(600)
@EACH_PLANT
def test_every_row_is_as_expected(plant):
    rows = table_of(plant, 240)
    assert {row.name: (row.value, row.low, row.high) for row in rows if not row.ok} == {}


@pytest.mark.proof
@pytest.mark.timeout(900)
@EACH_PLANT
def test_the_rows_hardly_change_with_the_step(plant):
    rows = compare_rows([table_of(plant, hz) for hz in (120, 240, 480)])
    assert {row.name: (row.values, row.change) for row in rows if not row.ok} == {}
