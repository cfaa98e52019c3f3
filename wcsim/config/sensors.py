"""A chair's sensors with their errors, as frozen models: cameras, the IMU and others."""

from abc import abstractmethod
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, field_validator, model_validator

from wcsim.config.base import Model, Share, exclude_if, within
from wcsim.types import Measure

Along = Annotated[float, Field(ge=-2.0, le=2.0, allow_inf_nan=False)]
Height = Annotated[float, Field(ge=0.02, le=3.0, allow_inf_nan=False)]
Turn = Annotated[float, Field(ge=-180.0, le=180.0, allow_inf_nan=False)]
UNTURNED: Final = (0.0, 0.0, 0.0)
Pixels = Annotated[int, within(8, 2048)]
ErrorDeg = Annotated[float, within(0.0, 5.0)]


# What a rear camera that is made for `env.camera` has of its own. Else it is as the first.
REAR: Final[dict[str, Any]] = {
    "name": "rear",
    # On the back rest. It sees from the ground below it to above the horizon: a chair does not back
    # up over a strip that was never seen.
    "p_BC_m": [-0.3, 0.0, 1.0],
    "hfov_deg": 120.0,
    "yaw_deg": 180.0,
    "pitch_deg": -35.0,
}

# What the word "typical" stands for; a sensor that is not here has a table without keys.
_TYPICAL: Final[dict[str, dict[str, Any]]] = {"noise": {"depth": {}, "classes": {}, "rgb": {}}}


def sensor_table_from_word(key: str, given: Any) -> Any:
    """A sensor's table as given, or the table for the word "none" or "typical".

    >>> words = (("odometry", "typical"), ("noise", "none"), ("noise", {"rgb": {}}))
    >>> tuple(sensor_table_from_word(*pair) for pair in words)
    ({}, None, {'rgb': {}})

    Args:
        key: Of the table.
        given: A table, a word, or anything else, which stays as it is.
    """
    return (
        {"none": None, "typical": _TYPICAL.get(key, {})}.get(given, given)
        if isinstance(given, str)
        else given
    )


class DepthNoiseConfig(Model):
    """Errors of a stereo depth camera.

    The defaults fit a small active stereo camera indoors or in the shade.
    """

    stand_ins = ("none",)

    # The error of a depth z is z² sigma_px / (f baseline_m), with the focal length f in pixels at
    # matcher_width_px (docs/senses.md).
    baseline_m: Annotated[float, within(0.005, 1.0)] = 0.05  # Distance between the two imagers.
    sigma_px: Annotated[float, within(0.0, 2.0)] = 0.08  # Standard deviation of the disparity.
    # Step to which the disparity is rounded. 0: not rounded.
    step_px: Annotated[float, within(0.0, 1.0)] = 0.03125
    # Image width at which the two images are matched.
    matcher_width_px: Annotated[int, within(8, 8192)] = 848
    z_min_m: Annotated[float, within(0.0, 5.0)] = 0.28  # Nearer surfaces are not measured.
    shadow: bool = True  # Whether surfaces that only one imager sees are lost.
    dropout: Share = 0.01  # Share of the image lost in random patches.
    # Surfaces seen at a smaller angle lose more pixels.
    grazing_deg: Annotated[float, within(0.0, 45.0)] = 3.0
    grazing_dropout: Share = 0.3  # Share of pixels that such surfaces lose.
    patch_px: Annotated[int, within(1, 64)] = 3  # Size of a lost patch.


class ClassNoiseConfig(Model):
    """Errors of a segmentation network."""

    stand_ins = ("none",)

    # Distance over which a pixel may take a neighbour's class.
    border_px: Annotated[int, within(0, 8)] = 2
    border_share: Share = 0.5  # Share of border pixels that do.
    grain_px: Annotated[int, within(1, 16)] = 2  # Size of the squares that share an error.
    dropout: Share = 0.01  # Share of the image without a class, in random patches.
    patch_px: Annotated[int, within(1, 64)] = 6  # Size of such a patch.


class _ColourNoiseConfig(Model):
    """Errors of a colour image."""

    stand_ins = ("none",)

    # Signal-to-noise ratio, 20 log10(255 / sigma).
    snr_db: Annotated[float, within(6.0, 80.0)] = 40.0


class CameraNoiseConfig(Model):
    """Noise of a camera by kind of image. A part that is missing or "none" is exact."""

    stand_ins = ("typical", "none")

    depth: DepthNoiseConfig | None = None
    classes: ClassNoiseConfig | None = None
    rgb: _ColourNoiseConfig | None = None
    # Errors about whole things that last, as of a good, usual or poor network (docs/senses.md).
    objects: Annotated[Literal["good", "usual", "poor"] | None, exclude_if(None)] = None

    @field_validator("depth", "classes", "rgb", "objects", mode="before")
    @classmethod
    def _without(cls, part: Any) -> Any:
        return None if part == "none" else part


class CameraConfig(Model):
    """One camera on a chair."""

    # Name of the camera. `env.camera` says which one networks see.
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")] = "front"
    width_px: Pixels = 320  # Image width.
    height_px: Pixels = 240  # Image height.
    hfov_deg: Annotated[float, within(20.0, 140.0)] = 87.0  # Horizontal field of view.
    range_m: Annotated[float, within(1.0, 200.0)] = 40.0  # Largest depth that is measured.
    near_m: Annotated[float, within(0.01, 1.0)] = 0.1  # Smallest depth that is measured.
    # Position x, y, z in the chair's frame. The default is at the armrest.
    p_BC_m: tuple[Along, Along, Height] = (0.35, 0.0, 1.0)
    yaw_deg: Annotated[float, within(-180.0, 180.0)] = 0.0  # Direction, to the left.
    # Direction, upwards. Negative looks down.
    pitch_deg: Annotated[float, within(-80.0, 80.0)] = -15.0
    # Rotation about its direction, right side down.
    roll_deg: Annotated[float, within(-180.0, 180.0), exclude_if(0.0)] = 0.0
    every_ticks: Annotated[int, within(1, 100)] = 1  # Ticks between two images.
    lost_share: Annotated[float, within(0.0, 0.95)] = 0.0  # Share of images that never arrive.
    rgb: bool = False  # Whether to draw a colour image too, for people.
    # Renderer. numba is many times faster; pybullet is the reference.
    renderer: Literal["numba", "pybullet"] = "numba"
    # A table, none, or typical for all parts with their defaults.
    noise: CameraNoiseConfig | None = None

    @field_validator("noise", mode="before")
    @classmethod
    def _noise_by_name(cls, noise: Any) -> Any:
        return sensor_table_from_word("noise", noise)

    @model_validator(mode="after")
    def _sees_something(self) -> Self:
        depth = self.noise.depth if self.noise is not None else None
        nearest_m = self.near_m if depth is None else max(self.near_m, depth.z_min_m)
        if nearest_m >= self.range_m:
            raise ValueError(
                f"camera {self.name!r} measures from {nearest_m} m to range_m {self.range_m} m; "
                "expected near_m and noise.depth.z_min_m below range_m"
            )
        return self


class ImuConfig(Model):
    """IMU and tilt sensor (docs/senses.md)."""

    # Position x, y, z in the chair's frame, near its centre of mass.
    p_BI_m: tuple[Along, Along, Height] = (0.18, 0.0, 0.50)
    # Roll, pitch and yaw in the chair's frame. Rewards and crashes do not change with them.
    rpy_deg: Annotated[tuple[Turn, Turn, Turn], exclude_if(UNTURNED)] = UNTURNED
    # Corner frequency of the low-pass for the peak acceleration.
    lowpass_hz: Annotated[float, within(0.1, 100.0)] = 20.0
    # Largest acceleration that it measures. The default is 16 g.
    saturation_mps2: Annotated[float, within(1.0, 10_000.0)] = 156.9
    # Largest turn rate that it measures, in deg/s.
    gyro_range_deg: Annotated[float, within(250.0, 2000.0)] = 2000.0

    # What the supervisor judges. The paper defines neither filter nor gravity (docs/spec.md).

    # Acceleration for reward and crash: a tick's filtered peak, or its mean.
    accel_window: Literal["lp20_peak", "tick_mean"] = "lp20_peak"
    # Whether that acceleration contains gravity.
    gravity: Literal["included", "removed"] = "removed"

    # What the agent sees.

    # Whether the agent's acceleration contains gravity.
    mean_gravity: Literal["included", "removed"] = "included"
    # Source of the agent's roll and pitch.
    tilt: Literal["ideal", "accelerometer", "complementary"] = "ideal"
    # Largest roll and pitch that the tilt sensor measures.
    tilt_range_deg: Annotated[float, within(1.0, 180.0), exclude_if(180.0)] = 180.0
    # Time constant with which the accelerometer corrects the gyroscope.
    tilt_tau_s: Annotated[float, within(0.05, 10.0)] = 1.0
    # White noise of the tilt in each tick. The ideal sensor has none.
    tilt_noise_deg: ErrorDeg = 0.3
    tilt_bias_deg: ErrorDeg = 0.5  # Mounting error, standard deviation over episodes.

    # Errors of a small, calibrated part.
    noise: bool = True  # Whether the IMU has errors. False: exact.
    # White noise of the accelerometer, per root hertz.
    accel_density_ug: Annotated[float, within(0.0, 10_000.0)] = 300.0
    # White noise of the gyroscope, deg/s per root hertz.
    gyro_density_deg: Annotated[float, within(0.0, 1.0)] = 0.005
    # Bias at power-on, standard deviation over episodes.
    accel_bias_mg: Annotated[float, within(0.0, 200.0)] = 5.0
    gyro_bias_deg: Annotated[float, within(0.0, 10.0)] = 0.1  # The same of the gyroscope, in deg/s.
    # Standard deviation of the bias drift.
    accel_instability_mg: Annotated[float, within(0.0, 50.0)] = 0.1
    gyro_instability_deg: ErrorDeg = 0.0012  # The same of the gyroscope, in deg/s.
    bias_tau_s: Annotated[float, within(1.0, 100_000.0)] = 300.0  # Time constant of the drift.


class SensorConfig(Model):
    """Base of a sensor's section. Its reading is a row of numbers."""

    stand_ins = ("typical", "none")

    @property
    @abstractmethod
    def measure(self) -> Measure:
        """What the numbers are."""


class OdometryConfig(SensorConfig):
    """Encoders on the drive wheels (docs/senses.md)."""

    # Encoder marks in one turn of a wheel.
    ticks_per_turn: Annotated[int, within(1, 1_000_000)] = 2048
    # Relative error of each wheel's radius, standard deviation over episodes.
    radius_error: Annotated[float, within(0.0, 0.2)] = 0.01
    # White noise of the speed, per root hertz.
    speed_density_mps: Annotated[float, within(0.0, 1.0)] = 0.002
    # White noise of the turn rate, deg/s per root hertz.
    turn_density_deg: Annotated[float, within(0.0, 90.0)] = 0.2
    delay_ticks: Annotated[int, within(0, 100)] = 0  # Age of a reading when it arrives.

    @property
    def measure(self) -> Measure:
        """Speed ahead, and turn rate counter-clockwise."""
        return Measure(
            parts=("speed_mps", "turn_rate_radps"), full_scale=(4.0, 4.0), mirror=(1.0, -1.0)
        )


class SensorsConfig(Model):
    """Sensors beside cameras and IMU. A sensor exists if it has a table."""

    stand_ins = ("none",)

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return {} if data == "none" else data
        return {key: sensor_table_from_word(key, value) for key, value in data.items()}

    # A field is the name of a kind in `physics/sensors/registry.py`. A sensor that is not there is
    # not written either, so that old files and their hashes stay.
    odometry: Annotated[OdometryConfig | None, exclude_if(None)] = None

    def on(self) -> dict[str, SensorConfig]:
        """The sections of the sensors that are there, by name."""
        return {
            name: section
            for name in sorted(type(self).model_fields)
            if (section := getattr(self, name))
        }

    def measures(self) -> dict[str, Measure]:
        """What they say, by name."""
        return {name: section.measure for name, section in self.on().items()}
