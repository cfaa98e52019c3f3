"""A camera inside the chair or its user is refused."""

import pytest

from wcsim.config import CameraConfig, ChairConfig
from wcsim.errors import ConfigError
from wcsim.physics.wheelchair.plant import plant_spec, refuse_cameras_inside

SPEC = plant_spec(ChairConfig())
BOXES = SPEC.frame.boxes


def test_the_default_camera_is_outside():
    refuse_cameras_inside((CameraConfig(),), SPEC)


@pytest.mark.parametrize("number", range(len(BOXES)))
def test_the_middle_of_each_box_is_inside(number):
    inside = CameraConfig(name="hidden", p_BC_m=BOXES[number].centre_m)
    with pytest.raises(ConfigError, match=r"'hidden'.* m is inside the chair's body.* m; expected a place outside"):
        refuse_cameras_inside((CameraConfig(), inside), SPEC)


def test_a_place_just_outside_is_fine_and_one_just_inside_is_not():
    one = SPEC.model_copy(update={"frame": SPEC.frame.model_copy(update={"boxes": BOXES[:1]})})
    (x, y, z), (length, _, _) = BOXES[0].centre_m, BOXES[0].size_m
    with pytest.raises(ConfigError):
        refuse_cameras_inside((CameraConfig(p_BC_m=(x + 0.5 * length - 0.001, y, z)),), one)
    refuse_cameras_inside((CameraConfig(p_BC_m=(x + 0.5 * length + 0.001, y, z)),), one)
