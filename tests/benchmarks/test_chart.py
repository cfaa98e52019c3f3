"""Line charts for people."""

import numpy as np
import pytest

from benchmarks.chart import Line, Panel, chart, steps
from wcsim.errors import ConfigError

T = np.linspace(0.0, 10.0, 200)


def test_a_rising_line_rises_and_a_falling_one_falls():
    lines = (Line(label="up", x=T, y=T), Line(label="down", x=T, y=10.0 - T))
    image = chart((Panel(title="two", lines=lines),), "s", width_px=400, panel_px=150)
    assert image.shape == (168, 400, 3)
    redder = image[22:130, 70:, 0].astype(int) - image[22:130, 70:, 2]
    for tinted, sign in ((redder < -40, -1.0), (redder > 40, 1.0)):  # the first is blue; rows count downwards
        pixels = np.argwhere(tinted)
        assert np.sign(np.corrcoef(pixels.T)[0, 1]) == sign and np.ptp(pixels[:, 1]) > 300


def test_panels_stand_under_each_other_and_flat_lines_are_drawn():
    one = Panel(title="flat", lines=(Line(label="a", x=T, y=np.zeros(200)),))
    assert chart((one, one, one), "s", panel_px=100).shape[0] == 318


@pytest.mark.parametrize("bounds", [(-0.2, 10.3), (0.0, 1e-3), (-5e4, 3e4), (9.79, 9.83)])
def test_the_grid_is_round_and_inside(bounds):
    got = steps(*bounds)
    assert 2 <= len(got) <= 9 and bounds[0] <= got[0] and got[-1] <= bounds[1] + 1e-9


@pytest.mark.parametrize("panels", [(), (Panel(title="x", lines=(Line(label="a", x=T, y=T * np.nan),)),)])
def test_nothing_to_draw_is_refused(panels):
    with pytest.raises(ConfigError, match="finite"):
        chart(panels, "s")
