"""Section `[chair]`: the wheelchair as it is driven."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from wcsim.config.base import Model, NotNegative, Positive, Share, Text

PROFILE_SPEED_MPS: dict[str, float] = {"indoor": 0.6, "pavement": 1.67, "road": 2.78}


class ChairConfig(Model):
    """The wheelchair as it is driven: its plant, and what its controller is programmed to."""

    plant: Text = "rwd"  # or "mwd", or the path of a .toml file
    profile: Literal["custom", "indoor", "pavement", "road"] = "custom"  # a named v_max_mps
    v_max_mps: Annotated[float, Field(gt=0.1, le=5.0)] = 1.67  # speed at full stick, profile custom
    reverse_share: Share = 0.4  # of it, backwards
    accel_mps2: Positive = 1.0  # that the controller asks for
    decel_mps2: Positive = 1.5  # when the stick is let go
    yaw_accel_radps2: Positive = 2.5  # of the turn rate
    jerk_mps3: Positive = 4.0  # at which the acceleration changes
    yaw_rate_max_radps: Positive = 1.5  # turn rate at full stick
    deadband: Annotated[float, Field(ge=0.0, le=0.5)] = 0.08  # of the stick, share of its way
    shape_exponent: Annotated[float, Field(ge=1.0, le=3.0)] = 1.0  # of the stick; more is finer in the middle
    tremor_damping_s: Annotated[float, Field(ge=0.0, le=0.4)] = 0.0  # time constant of a low-pass on the joystick
    brake_after_s: NotNegative = 0.5  # standing still, until the parking brake falls in
    user_mass_kg: Annotated[float, Field(ge=25.0, le=150.0)] | None = None  # None keeps the plant's own
    com_height_m: Annotated[float, Field(ge=0.3, le=0.9)] | None = None  # centre of mass; None keeps the plant's own

    @model_validator(mode="before")
    @classmethod
    def _profile_names_the_speed(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        speed_mps = PROFILE_SPEED_MPS.get(str(data.get("profile")))
        if speed_mps is None:
            return data
        got = data.get("v_max_mps", speed_mps)
        if got != speed_mps:
            raise ValueError(
                f"profile {data['profile']!r} drives at {speed_mps} m/s, v_max_mps is {got}; expected the same speed: "
                f"set v_max_mps to {speed_mps}, or profile to custom"
            )
        return {**data, "v_max_mps": speed_mps}
