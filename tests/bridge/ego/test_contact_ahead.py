"""Whether a wheel is about to meet an edge or somebody a chair, and that a kerb then feels as with fine steps."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.physics.rig import FORWARD, actor, rig, step_street
from tests.physics.wheelchair.test_kerb_drop import KERB_X_M, raster, step_grid
from tests.support.plants import plant_state
from wcsim.bridge.ego.contact_ahead import SLOWER_MPS, find_plane, meets_body, meets_edge
from wcsim.config import ChairConfig
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.types import ActorKind
from wcsim.types.street import Relief, StreetGrid

TICK_S = 0.1
WHEELS_M = plant_spec(ChairConfig()).wheels_m()
FOREMOST_M = max(x + radius for x, _, radius in WHEELS_M)
KERB = step_grid(0.02)


def chair(x_m, speed_mps, yaw_rad=0.0, turn_radps=0.0, y_m=0.0):
    return plant_state(x_m, y_m, yaw=yaw_rad, ahead_mps=speed_mps, turn_radps=turn_radps)


def meets(plant, ground=KERB) -> bool:
    return meets_edge(plant, WHEELS_M, ground, TICK_S)


@pytest.mark.parametrize("speed_mps", [0.6, 1.67, 2.78])
def test_a_kerb_that_a_wheel_reaches_within_the_tick_is_met_one_farther_off_is_not(speed_mps):
    touches_m = KERB_X_M - FOREMOST_M
    assert meets(chair(touches_m - speed_mps * TICK_S, speed_mps))
    assert not meets(chair(touches_m - 1.25 * speed_mps * TICK_S - 0.3, speed_mps))


def test_until_every_wheel_is_up():
    at_m = np.arange(KERB_X_M - FOREMOST_M, KERB_X_M, 0.1)
    assert [meets(chair(x_m, 1.0)) for x_m in at_m].count(True) >= len(at_m) - 3  # but for casters up, wheels yet down
    assert not meets(chair(KERB_X_M + 0.4, 1.0))


def test_who_drives_along_a_kerb_or_down_from_it_or_stands_meets_none():
    near_m = KERB_X_M - FOREMOST_M
    assert not meets(chair(near_m, 1.67, yaw_rad=0.5 * math.pi))
    assert not meets(chair(KERB_X_M + 0.3, 1.67, yaw_rad=math.pi))
    assert not meets(chair(near_m, 0.0)) and not meets(chair(near_m, SLOWER_MPS - 0.01))


def test_backwards_and_in_a_turn_too():
    assert meets(chair(KERB_X_M - 0.3, -1.0, yaw_rad=math.pi))
    assert meets(chair(KERB_X_M - 0.5, 0.0, yaw_rad=0.5 * math.pi, turn_radps=-2.5))


def test_a_ramp_is_no_edge():
    ramp = raster(lambda x: min(max(0.08 * (x - KERB_X_M), 0.0), 0.4))
    assert not any(meets(chair(x_m, 1.67), ramp) for x_m in np.arange(0.0, 8.0, 0.05))


def felt(hz: int, chooses: bool) -> float:
    """The largest acceleration of a drive over a kerb of 20 mm at full speed, low-passed, in m/s2."""
    with rig(step_street(0.02), hz=hz, v_max_mps=1.67) as yard:

        def choose(tick: int) -> None:
            fine = chooses and meets(yard.chair.state())
            yard.engine.set_step(1.0 / (2 * hz if fine else hz))
            yard.chair.follow_step()

        peaks = []
        for _ in range(40):
            choose(0)
            peaks.append(yard.drive(FORWARD, 1).peaks())
        return float(np.max(peaks))


def test_a_kerb_feels_as_with_fine_steps_throughout():
    fine, coarse = felt(240, chooses=False), felt(120, chooses=False)
    assert felt(120, chooses=True) == pytest.approx(fine, rel=0.12)
    assert coarse < 0.85 * fine  # or the fine steps would be for nothing


CHAIR = actor("w:0", 0.0, 0.0, size=(1.1, 0.65, 1.3))


def comes(x_m, y_m, speed_mps, yaw_rad=0.0, known=True) -> bool:
    """Whether a car that ends the tick there may touch the chair at the origin on its way."""
    ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad), 0.0])
    car = replace(actor("v:car", x_m, y_m, yaw_rad), v_W_mps=speed_mps * ahead)
    before = {car.id: replace(car, p_W_m=car.p_W_m - TICK_S * car.v_W_mps)} if known else {}
    return meets_body([actor("w:1", 90.0, 0.0), CHAIR], before, [actor("v:far", 50.0, 0.0), car], TICK_S)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("speed_mps", [0.0, 8.0, 14.0])
def test_a_car_that_gets_to_the_chair_in_the_tick_is_met_one_that_passes_is_not(speed_mps, known):
    touches_m = -0.5 * (4.5 + 1.1)
    assert comes(touches_m, 0.0, speed_mps, known=known)
    assert not comes(touches_m - 0.25, 0.0, speed_mps, known=known)
    assert not comes(0.0, 0.5 * (1.8 + 0.65) + 0.15, speed_mps, known=known)
    assert comes(0.0, 0.5 * (1.8 + 0.65) + 0.05, speed_mps, known=known)


def test_a_car_that_has_gone_through_the_chair_by_the_end_of_the_tick_was_met():
    assert comes(0.5 * (4.5 + 1.1) + 1.0, 0.0, 14.0)
    assert not comes(0.5 * (4.5 + 1.1) + 2.0, 0.0, 14.0)


def test_a_chair_that_drives_gets_farther():
    person = actor("p:one", 1.0, 0.0, kind=ActorKind.PEDESTRIAN, size=(0.4, 0.4, 1.7))
    assert not meets_body([CHAIR], {}, [person], TICK_S)
    assert meets_body([replace(CHAIR, v_W_mps=np.array([1.67, 0.0, 0.0]))], {}, [person], TICK_S)


WAY_M = 1.5


def plane_of(x_m: float, ground: StreetGrid, speed_mps: float = 1.0, y_m: float = 0.0):
    """Of a chair that may come as far as `WAY_M` ahead or back, and 0.3 m more all round."""
    middle_m = x_m + math.copysign(0.5 * WAY_M, speed_mps)
    reach = middle_m, y_m, 1.0, 0.0, 0.5 * (1.1 + WAY_M) + 0.3, 0.5 * 0.65 + 0.3
    return find_plane(chair(x_m, speed_mps, y_m=y_m), reach, ground)


def test_a_plane_ends_where_a_kerb_is_in_reach():
    low = KERB.height_here(0.0, 0.0)
    edge_m = KERB_X_M - (0.55 + WAY_M + 0.3)
    assert plane_of(edge_m - 0.15, KERB) == (pytest.approx(low), 0.0, 0.0)
    assert plane_of(edge_m + 0.15, KERB) is None
    assert plane_of(KERB_X_M + 3.0, KERB) == (pytest.approx(low + 0.02), 0.0, 0.0)
    # Backing off, the kerb behind is what counts.
    assert plane_of(edge_m + 0.15, KERB, speed_mps=-1.0) is not None
    assert plane_of(KERB_X_M + 2.0, KERB, speed_mps=-1.0) is None


@pytest.mark.parametrize(
    "at_m, is_free", [((1.9, 0.0), False), ((1.9, 0.5), False), ((2.7, 0.0), True), ((1.0, 0.8), True)]
)
def test_a_plane_has_nothing_solid_on_it(at_m, is_free):
    grid = raster(lambda x: 0.0)
    clearance_dm = grid.clearance_dm.copy()
    row, col = grid.cells(np.array(at_m))
    clearance_dm[row, col] = 0
    assert (plane_of(0.0, replace(grid, clearance_dm=clearance_dm)) is not None) == is_free


def test_a_hillside_is_a_plane_and_its_crest_is_none():
    level = raster(lambda x: 0.0)
    x_m, y_m = np.meshgrid(10.0 * np.arange(-3, 5), 10.0 * np.arange(-3, 5))
    hill = Relief(origin_W_m=(-30.0, -30.0), cell_m=10.0, z_m=(50.0 + 0.05 * x_m - 0.02 * y_m).astype(np.float32))
    side = plane_of(3.0, replace(level, relief=hill), y_m=1.0)
    assert side is not None
    assert side == pytest.approx((level.height_here(0.0, 0.0) + 50.0 + 0.15 - 0.02, 0.05, -0.02), abs=1e-4)
    crest = replace(hill, z_m=(50.0 - 0.05 * np.abs(x_m)).astype(np.float32))
    assert plane_of(-1.0, replace(level, relief=crest)) is None
    assert plane_of(4.0, replace(level, relief=crest)) is not None
