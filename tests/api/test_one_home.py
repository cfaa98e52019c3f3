"""Numbers of the physical world, and the law of the joystick, have one home each: nobody else spells them out."""

import ast

import pytest

from tests.support.tracked import parsed
from wcsim.core import constants, joystick

HOMES = {
    "wcsim/core/constants.py": {"GRAVITY_MPS2", "KERB_STEP_CM", "KERB_STEP_M", "OTHER_LEVEL_M"},
    "wcsim/core/joystick.py": {"shape_joystick", "raw_radius_from_shaped", "advance_speed", "compute_yaw_rate_limit"},
}
GONE = {"LOW_KERB_M", "USUAL_OUTLINE", "CHAIR_HALF_M", "CHAIR_SIZE_LWH_M", "WHEELS_B_M", "DEADBAND"}
GRAVITY = 9.81


def spelt(tree):
    """Names that the top level of a module gives a value or a body."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            yield from (target.id for target in node.targets if isinstance(target, ast.Name))
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id
        elif isinstance(node, ast.FunctionDef):
            yield node.name


@pytest.mark.parametrize("home", sorted(HOMES))
def test_each_name_is_spelt_out_in_its_home_alone(home):
    found = [(name, file) for file, tree in parsed("wcsim").items() for name in spelt(tree) if name in HOMES[home]]
    assert sorted(found) == [(name, home) for name in sorted(HOMES[home])]


def test_second_homes_do_not_come_back():
    assert [(file, name) for file, tree in parsed("wcsim").items() for name in spelt(tree) if name in GONE] == []
    numbers = [
        file
        for file, tree in parsed("wcsim").items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value == GRAVITY
    ]
    assert numbers == ["wcsim/core/constants.py"]


def test_units_agree():
    assert pytest.approx(constants.KERB_STEP_M) == constants.KERB_STEP_CM / 100
    assert constants.GRAVITY_MPS2 == GRAVITY
    assert joystick.compute_yaw_rate_limit(0.0, 1.5, 0.6) == 1.5
