"""Moments of a drive as pictures and as a film."""

import numpy as np
import pytest

from tests.support.samples import strip_street
from tests.support.worlds import quick_config
from tests.view.films import frames_of
from wcsim.agents.evaluation.suite.playback import PlayedStep
from wcsim.supervisor.observation import encode_depth
from wcsim.supervisor.palette import COLOURS
from wcsim.types import ClassId, Joystick
from wcsim.view.filming import around_picture, film_steps, seen_picture
from wcsim.view.map import MapView
from wcsim.view.pictures import depth_colours


def seen(config, window=1):
    classes = np.full((24, 32), ClassId.ROAD, np.uint8)
    depth = encode_depth(np.full((24, 32), 5.0, np.float32), config.cameras[0].range_m)
    older = np.zeros((window - 1, 24, 32), np.uint8)
    return {"seg": np.concatenate([older, classes[None]]), "depth": np.concatenate([older, depth[None]])}


def step(config, x_m=0.0):
    return PlayedStep(
        seat=0, step=1, seen=seen(config), requested=Joystick(0.0, 1.0), given=Joystick(0.5, 0.25), speed_mps=1.0,
        motion=(1.0, 0.0), p_W_m=np.array([x_m, 0.0, 0.0]), yaw_rad=0.0, actors=(), chairs=(), signals=(),
    )  # fmt: skip


@pytest.mark.parametrize("window", [1, 3])
def test_what_was_seen_is_the_newest_classes_above_their_depth(window):
    config = quick_config()
    picture = seen_picture(seen(config, window), config)
    assert picture.shape == (48, 32, 3)
    assert (picture[:24] == COLOURS[ClassId.ROAD]).all()
    range_m = config.cameras[0].range_m
    expected = depth_colours(np.full((1, 1), 5.0, np.float32), range_m)[0, 0].astype(int)
    assert np.abs(picture[24:].astype(int) - expected).max() <= 8


def test_the_papers_form_shows_the_same():
    config = quick_config("env.observation=table3")
    colour = np.array(COLOURS[ClassId.ROAD], np.float32) / 255.0
    table3 = {
        "segmentation": np.broadcast_to(colour[:, None, None], (3, 24, 32)),
        "depth": np.full((1, 24, 32), 5.0 / config.cameras[0].range_m, np.float32),
    }
    plain = seen_picture(seen(config), config).astype(int)
    window = {key: np.stack([np.zeros_like(value), value]) for key, value in table3.items()}
    for shown in (table3, window):
        assert np.abs(seen_picture(shown, config).astype(int) - plain).max() <= 8


def test_a_film_shows_each_step_beside_the_street(tmp_path):
    config, view = quick_config(), MapView(strip_street().mesh, 120, 20.0)
    steps = [step(config, 0.1 * number) for number in range(4)]
    assert around_picture(view, steps[-1], steps).shape == (120, 120, 3)
    film_steps(tmp_path / "a.webm", view, steps, config)
    assert len(frames_of(tmp_path / "a.webm")) == 4
