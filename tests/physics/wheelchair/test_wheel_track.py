"""The wheels' places of the last seconds: a sample every 0.05 s at every rate of the physics."""

import numpy as np
import pytest

from tests.physics.rig import FORWARD, rig
from wcsim.physics.wheelchair.plant import varied
from wcsim.physics.wheelchair.wheel_track import KEPT_S, SAMPLE_S


@pytest.mark.parametrize("hz", [120, 240, 480])
def test_a_sample_is_taken_every_0_05_s_and_the_last_seconds_are_kept(hz):
    with rig(hz=hz, v_max_mps=1.0) as yard:
        yard.drive(FORWARD, 40)
        p_W_m, speed_mps = yard.chair.wheel_track()
        assert p_W_m.shape == (round(KEPT_S / SAMPLE_S), 4, 3)
        steps_m = np.diff(p_W_m[:, :, 0], axis=0)
        assert steps_m == pytest.approx(SAMPLE_S * 1.0, abs=0.003)  # in order, oldest first
        assert speed_mps == pytest.approx(1.0, abs=0.03)
        state = yard.chair.state()
        wheel = yard.chair.spec.wheel
        assert p_W_m[-1, :2, 0] == pytest.approx(state.p_WB_m[0], abs=0.01)
        assert sorted(p_W_m[-1, :2, 1]) == pytest.approx([-0.5 * wheel.track_m, 0.5 * wheel.track_m], abs=0.1)
        assert p_W_m[-1, :2, 2] == pytest.approx(wheel.radius_m, abs=0.005)
        assert p_W_m[-1, 2:, 2] == pytest.approx(yard.chair.spec.casters[0].radius_m, abs=0.005)


def test_a_new_body_and_a_new_place_begin_a_new_track():
    with rig() as yard:
        yard.drive(FORWARD, 3)
        assert len(yard.chair.wheel_track()[1]) == 6
        yard.chair.become(varied(yard.chair.spec, {"mass.user_kg": 60.0}))
        yard.place(x=2.0)
        assert len(yard.chair.wheel_track()[1]) == 0
        yard.drive(FORWARD, 1)
        p_W_m, speed_mps = yard.chair.wheel_track()
        assert p_W_m.shape == (2, 4, 3) and speed_mps.shape == (2,)
