"""A camera inside the chair or its user is refused."""

import pytest

from wcsim.config import CameraConfig, ChairConfig
from wcsim.errors import ConfigError
from wcsim.physics.wheelchair.plant import plant_spec, refuse_cameras_inside

BOXES = plant_spec(ChairConfig()).frame.boxes


def test_the_default_camera_is_outside():
    refuse_cameras_inside((CameraConfig(),), BOXES)


@pytest.mark.parametrize("number", range(len(BOXES)))
def test_the_middle_of_each_box_is_inside(number):
    inside = CameraConfig(name="hidden", p_BC_m=BOXES[number].centre_m)
    with pytest.raises(ConfigError, match=r"'hidden'.* m is inside the chair's body.* m; expected a place outside"):
        refuse_cameras_inside((CameraConfig(), inside), BOXES)


def test_a_place_just_outside_is_fine_and_one_just_inside_is_not():
    (x, y, z), (length, _, _) = BOXES[0].centre_m, BOXES[0].size_m
    with pytest.raises(ConfigError):
        refuse_cameras_inside((CameraConfig(p_BC_m=(x + 0.5 * length - 0.001, y, z)),), BOXES[:1])
    refuse_cameras_inside((CameraConfig(p_BC_m=(x + 0.5 * length + 0.001, y, z)),), BOXES[:1])
