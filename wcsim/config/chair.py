"""Section `[chair]`: the wheelchair and its controller; `core/joystick.py` applies the limits."""

from typing import Annotated, Any, Final, Literal

from pydantic import model_validator

from wcsim.config.base import Model, Share, Text, TopSpeed, UserMass, exclude_if, within

# The measured chair slows its turns down far less, by 0.06 to 0.10 (docs/chair.md).
YAW_SLOWDOWN_S_PER_M: Final = 0.6

# 6 and 10 km/h are the speeds of pavement and road.
PROFILE_SPEED_MPS: Final[dict[str, float]] = {"indoor": 0.6, "pavement": 1.67, "road": 2.78}


class ChairConfig(Model):
    """The wheelchair: its plant, and the settings of its controller."""

    plant: Text = "rwd"  # Physical model: rwd, mwd, whill, or the path of a .toml file.
    # Sets v_max_mps: indoor 0.6, pavement 1.67, road 2.78 m/s.
    profile: Literal["custom", "indoor", "pavement", "road"] = "custom"
    # Neither ISO 7176 nor EN 12184 prescribes the numbers of a controller (docs/chair.md).
    v_max_mps: TopSpeed = 1.67  # Speed at full stick. Set it with profile custom.
    reverse_share: Share = 0.4  # Top speed backwards, as a share of v_max_mps.
    # Acceleration that the controller requests.
    accel_mps2: Annotated[float, within(0.05, 20.0)] = 1.0
    # Deceleration when the stick is released.
    decel_mps2: Annotated[float, within(0.05, 20.0)] = 1.5
    yaw_accel_radps2: Annotated[float, within(0.05, 100.0)] = 2.5  # Angular acceleration of turns.
    jerk_mps3: Annotated[float, within(0.1, 1000.0)] = 4.0  # Rate of change of the acceleration.
    yaw_rate_max_radps: Annotated[float, within(0.05, 20.0)] = 1.5  # Turn rate at full stick.
    # How the turn rate falls with the speed v: as 1 / (1 + this v). 0: it does not.
    yaw_slowdown_s_per_m: Annotated[float, within(0.0, 5.0), exclude_if(YAW_SLOWDOWN_S_PER_M)] = (
        YAW_SLOWDOWN_S_PER_M
    )
    deadband: Annotated[float, within(0.0, 0.5)] = 0.08  # Stick travel without effect, as a share.
    # Exponent of the stick's curve. Above 1 the stick is finer near its centre.
    shape_exponent: Annotated[float, within(1.0, 3.0)] = 1.0
    # Time constant of a low-pass on the joystick. 0: no filter.
    tremor_damping_s: Annotated[float, within(0.0, 0.4)] = 0.0
    # Time at rest before the parking brake locks.
    brake_after_s: Annotated[float, within(0.0, 600.0)] = 0.5
    user_mass_kg: UserMass | None = None  # Mass of the user. Without a value: that of the plant.
    # Height of the centre of mass. Without a value: that of the plant.
    com_height_m: Annotated[float, within(0.3, 0.9)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _profile_names_the_speed(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        # The model is frozen: the speed has to be there before it is made.
        speed_mps = PROFILE_SPEED_MPS.get(str(data.get("profile")))
        if speed_mps is None:
            return data
        given_mps = data.get("v_max_mps", speed_mps)
        if given_mps != speed_mps:
            raise ValueError(
                f"profile {data['profile']!r} drives at {speed_mps} m/s, v_max_mps is {given_mps}; "
                f"expected the same speed: set v_max_mps to {speed_mps}, or profile to custom"
            )
        return {**data, "v_max_mps": speed_mps}
