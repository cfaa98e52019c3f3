"""The statics that the tilt table is held against."""

import math
from dataclasses import replace

import pytest

from wcsim.chair_check.static_balance import (
    FORWARD_DOWN,
    LEFT_DOWN,
    REAR_DOWN,
    StaticChair,
    SupportFoot,
    _Beam,
    _com_m,
    _rigid_tip_angle_rad,
    compute_level_loads_N,
    compute_tip_angle_rad,
    find_uphill_feet,
    find_worst_swivel_rad,
    make_static_chair,
)
from wcsim.config import ChairConfig
from wcsim.config.plant import CasterArmPart
from wcsim.errors import PhysicsError
from wcsim.physics.wheelchair.plant import plant_spec

DIRECTIONS = (FORWARD_DOWN, REAR_DOWN, LEFT_DOWN)
ARM = CasterArmPart(mass_kg=0.5, stiffness_Npm=2e4, damping_Nspm=0.0, preload_N=0.0, down_m=0.05, up_m=0.05)


def cart(height_m=0.5, x_m=0.1, arm=None) -> StaticChair:
    """A box on four balls 1 m apart lengthwise and 0.6 m across."""
    feet = tuple(
        SupportFoot(name=f"{end}_{side}", centre_m=(x, y, 0.1), radius_m=0.1, arm=arm)
        for end, x in (("front", 0.5), ("rear", -0.5))
        for side, y in (("l", 0.3), ("r", -0.3))
    )
    return StaticChair(mass_kg=100.0, com_m=(x_m, 0.0, height_m), feet=feet)


def test_a_cart_tips_when_its_centre_of_mass_stands_above_its_feet():
    for downhill, reach_m in ((FORWARD_DOWN, 0.4), (REAR_DOWN, 0.6), (LEFT_DOWN, 0.3)):
        assert compute_tip_angle_rad(cart(), downhill) == pytest.approx(math.atan(reach_m / 0.5), abs=1e-3)
        assert _rigid_tip_angle_rad(cart(), downhill) == pytest.approx(math.atan(reach_m / 0.5))


def test_springs_bring_it_down_earlier_and_height_too():
    assert compute_tip_angle_rad(cart(arm=ARM), LEFT_DOWN) < compute_tip_angle_rad(cart(), LEFT_DOWN) - 0.005
    assert compute_tip_angle_rad(cart(height_m=0.6), LEFT_DOWN) < compute_tip_angle_rad(cart(), LEFT_DOWN)


@pytest.mark.parametrize("arm", [None, ARM])
def test_the_loads_carry_the_weight_and_balance(arm):
    loads = compute_level_loads_N(cart(arm=arm))
    assert sum(loads.values()) == pytest.approx(981.0, rel=1e-3)
    front = loads["front_l"] + loads["front_r"]
    assert front / 981.0 == pytest.approx(0.6, abs=0.01)
    assert loads["front_l"] == pytest.approx(loads["front_r"], rel=1e-3)


def test_what_cannot_stand_is_refused():
    with pytest.raises(PhysicsError, match="not above the feet"):
        _rigid_tip_angle_rad(cart(x_m=0.1).without("front").without("rear_l"), LEFT_DOWN)
    with pytest.raises(PhysicsError, match="tips at rest"):
        compute_tip_angle_rad(cart(x_m=0.7), FORWARD_DOWN)


def test_a_beam_leaves_a_triangle_to_stand_on():
    free = _Beam(pivot_z_m=0.0, stop_rad=math.radians(10.0), weight_N=0.0, com_z_m=0.0)
    feet = [replace(foot, beam=free) if foot.name.startswith("front") else foot for foot in cart().feet]
    chair = replace(cart(), feet=tuple(feet))
    triangle = math.atan(0.3 * 0.4 / 0.5)  # from a rear foot to the pivot, below the centre of mass 0.1 m ahead
    assert compute_tip_angle_rad(chair, LEFT_DOWN) == pytest.approx(triangle, abs=1e-3)
    loads = compute_level_loads_N(chair)
    assert loads["front_l"] == pytest.approx(loads["front_r"]) == pytest.approx(0.3 * 981.0, rel=1e-3)
    stuck = [replace(foot, beam=replace(free, stop_rad=1e-9)) if foot.beam else foot for foot in feet]
    assert compute_tip_angle_rad(replace(chair, feet=tuple(stuck)), LEFT_DOWN) == pytest.approx(
        math.atan(0.3 / 0.5), abs=1e-3
    )
    high = [replace(foot, beam=replace(free, pivot_z_m=0.2)) if foot.beam else foot for foot in feet]
    assert compute_tip_angle_rad(replace(chair, feet=tuple(high)), LEFT_DOWN) > triangle + 0.02


@pytest.mark.parametrize("gap_m", [0.02, 0.05, 0.1, 0.13])
def test_antitips_hold_a_chair_that_has_to_lean_far_to_reach_them(gap_m):
    raised = tuple(
        SupportFoot(name=f"antitip_0_{side}", centre_m=(0.8, y, 0.1 + gap_m), radius_m=0.1)
        for side, y in (("l", 0.3), ("r", -0.3))
    )
    chair = cart(height_m=0.6)
    lean = math.atan(gap_m / 0.3)  # about the front wheels, at 0.5 m and 0.1 m up
    ahead_m, up_m = -0.4 * math.cos(lean) + 0.5 * math.sin(lean), 0.5 * math.cos(lean) + 0.4 * math.sin(lean) + 0.1
    expected = math.atan2(math.hypot(0.3, gap_m) - ahead_m, up_m)
    found = compute_tip_angle_rad(replace(chair, feet=(*chair.feet, *raised)), FORWARD_DOWN)
    assert found == pytest.approx(expected, abs=2e-3)
    assert found > compute_tip_angle_rad(chair, FORWARD_DOWN) + 0.01


def test_the_rigid_plant_tips_on_its_tip_lines():
    spec = plant_spec(ChairConfig())
    spec = spec.model_copy(update={"casters": tuple(pair.model_copy(update={"beam": None}) for pair in spec.casters)})
    for downhill in DIRECTIONS:
        chair = make_static_chair(spec, find_worst_swivel_rad(spec, downhill)).without("antitip")
        assert compute_tip_angle_rad(chair, downhill) == pytest.approx(
            _rigid_tip_angle_rad(chair, downhill), abs=math.radians(0.05)
        )
    chair = make_static_chair(spec)
    assert compute_tip_angle_rad(chair, REAR_DOWN) > compute_tip_angle_rad(chair.without("antitip"), REAR_DOWN) + 0.2


def test_forward_the_tip_line_of_the_rear_wheel_drive_is_that_of_its_trailing_casters():
    spec = plant_spec(ChairConfig())
    (pair,) = spec.casters
    reach_m = pair.swivel_x_m - pair.trail_m - spec.mass.com_x_m
    expected = math.atan(reach_m / spec.mass.com_z_m)
    assert find_worst_swivel_rad(spec, FORWARD_DOWN) == 0.0
    assert compute_tip_angle_rad(make_static_chair(spec), FORWARD_DOWN) == pytest.approx(
        expected, abs=math.radians(0.05)
    )


def test_turned_casters_move_the_centre_of_mass_and_the_tip_line():
    spec = plant_spec(ChairConfig())
    assert _com_m(spec)[0] == spec.mass.com_x_m
    assert _com_m(spec, math.pi)[0] > spec.mass.com_x_m
    ahead = compute_tip_angle_rad(make_static_chair(spec, math.pi), FORWARD_DOWN)
    assert ahead > compute_tip_angle_rad(make_static_chair(spec), FORWARD_DOWN) + 0.1
    inwards = find_worst_swivel_rad(spec, LEFT_DOWN)
    assert 0.0 < inwards < math.pi, "the lower caster turned towards the middle"


def test_the_uphill_feet_are_all_but_the_last_ones_or_those_of_a_side():
    chair = make_static_chair(plant_spec(ChairConfig(plant="mwd")))
    assert find_uphill_feet(chair, FORWARD_DOWN) == {f.name for f in chair.feet if not f.name.startswith("caster_0")}
    assert find_uphill_feet(chair, LEFT_DOWN) == {f.name for f in chair.feet if f.name.endswith("_r")}
