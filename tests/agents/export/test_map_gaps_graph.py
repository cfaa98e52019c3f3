"""The numbers of each action as tensors, against those of the kernel, over 200 steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.agents.export.test_danger_graph import CONFIG, ride
from wcsim.agents.danger.roll_outs import HOLD_S, STEP_S, STEPS
from wcsim.agents.danger.sight import DangerSight, Eye
from wcsim.agents.danger.street_map import OWN_PLANES
from wcsim.agents.export.drive_law import Drive
from wcsim.agents.export.map_gaps_graph import MapGaps
from wcsim.config import with_overrides
from wcsim.core.joystick import limits_of

OWN = with_overrides(CONFIG, ("danger.gaps=map", "danger.rival=false"))


@pytest.fixture(scope="module")
def sights() -> list[DangerSight]:
    """A ride with persons beside the way and what noise makes of the ground."""
    eye, found = Eye(OWN), []
    for tick, seen in enumerate(ride(200)):
        sight = eye.look(seen)
        eye.command(tick % 81)
        picture = sight.picture.copy()
        picture[:, :, : 12 + tick % 30] = 0  # leave room, so that the numbers are not all of one kind
        found.append(replace(sight, picture=picture))
    return found


def numbers(sights: list[DangerSight], kind: torch.dtype) -> np.ndarray:
    eye, chair = Eye(OWN), OWN.chair
    gaps = MapGaps(eye.around.box_B_m).to(kind)
    drive = Drive(limits_of(chair), chair.deadband, chair.shape_exponent)
    commands = torch.as_tensor(eye.around.commands, dtype=kind)
    holds = [step * STEP_S < HOLD_S - 1e-9 for step in range(STEPS)]
    found = []
    for sight in sights:
        x, y, yaw, v, w, a = torch.as_tensor(sight.start, dtype=kind)[:, None]
        rolled = drive.roll((x, y, yaw), (v, w, a), commands, holds, STEP_S)
        codes = torch.as_tensor(sight.picture[:OWN_PLANES]).to(kind)
        found.append(gaps(codes, rolled, (x, y, yaw)).numpy())
    return np.stack(found)


def test_tensors_give_the_numbers_of_the_kernel(sights):
    from wcsim.agents.danger.map_gaps import discs_of, map_profile

    eye = Eye(OWN)
    around, wanted = eye.around, []
    for sight in sights:
        out = np.empty_like(sight.actions)
        start = sight.start.astype(np.float64)
        map_profile(start, around.commands, around.limits, discs_of(around.box_B_m), sight.picture, out)
        wanted.append(out / 255.0)
    kernel = np.stack(wanted)
    assert len(np.unique(kernel[..., 0])) > 50 and 0.05 < (kernel[..., 1] < 1.0).mean() < 0.95
    assert np.abs(numbers(sights, torch.float64) - kernel).max() < 1e-4
    single = np.abs(numbers(sights, torch.float32) - kernel)
    assert (single > 1e-4).mean() < 1e-3, "a number at the border of two codes may go either way"
    assert single[..., [0, 2, 4]].max() < 1.01 / 255.0
