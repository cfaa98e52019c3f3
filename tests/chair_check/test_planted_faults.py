"""The table is worth something only if it turns red: faults planted into the simulated chair."""

import pytest

from tests.physics.wheelchair.plant_faults import FAULTS
from wcsim.chair_check.row import TrialSetup
from wcsim.chair_check.table import run_plant_trials
from wcsim.config import ChairConfig

QUICK = ("wrong gravity", "damping left on")


def row(name: str):
    return next(row for row in run_plant_trials(TrialSetup(chair=ChairConfig(), hz=240), (name,)) if row.name == name)


@pytest.mark.parametrize("fault", [f if f in QUICK else pytest.param(f, marks=pytest.mark.proof) for f in FAULTS])
def test_a_fault_turns_its_row_red(fault, monkeypatch):
    plant, name = FAULTS[fault]
    if fault in QUICK:
        assert row(name).ok, "without the fault"
    plant(monkeypatch)
    assert not row(name).ok
