"""How a wheelchair stands and moves, for tests without an engine."""

import numpy as np

from wcsim.core.frames import quaternion_from_ypr
from wcsim.types import Events, PlantState


def plant_state(x=0.0, y=0.0, z=0.0, yaw=0.0, pitch=0.0, roll=0.0, *, ahead_mps=0.0, turn_radps=0.0) -> PlantState:
    """Metres and radians; whatever is not said is 0."""
    return PlantState(
        p_WB_m=np.array([x, y, z]),
        q_WB=np.array(quaternion_from_ypr(yaw, pitch, roll)),
        v_B_mps=np.array([ahead_mps, 0.0, 0.0]),
        w_B_radps=np.array([0.0, 0.0, turn_radps]),
        wheel_radps=np.zeros(2),
        roll_rad=roll,
        pitch_rad=pitch,
        yaw_rad=yaw,
    )


CALM = Events(episode=0, step=1, crashed=False, crash_reason="", truncated=False, arrived=False, gave_up=False)
"""Nothing happened."""
