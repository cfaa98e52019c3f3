"""Every file that wcsim reads from disk, as frozen models: unknown keys and bad values are errors.

Angles are in degrees in keys that end in `_deg`, and nowhere else. Presets are TOML files in
`wcsim/config/presets/`.
"""

from wcsim.config.base import Model, Text
from wcsim.config.chair import PROFILE_SPEED_MPS, ChairConfig
from wcsim.config.env import LEAST_WINDOW, EnvConfig, RewardConfig
from wcsim.config.learn import CollectConfig, DangerConfig, LearnConfig
from wcsim.config.load import parse, parse_json, read_toml, resolve
from wcsim.config.run import MAX_SEEN_PX, RunConfig
from wcsim.config.scene import TownFile
from wcsim.config.sensors import (
    CameraConfig,
    CameraNoiseConfig,
    ClassNoiseConfig,
    DepthNoiseConfig,
    ImuConfig,
    OdometryConfig,
    SensorConfig,
    SensorsConfig,
)
from wcsim.config.world import STREETS, VaryConfig, WorldConfig

__all__ = (
    "LEAST_WINDOW",
    "MAX_SEEN_PX",
    "PROFILE_SPEED_MPS",
    "STREETS",
    "CameraConfig",
    "CameraNoiseConfig",
    "ChairConfig",
    "ClassNoiseConfig",
    "CollectConfig",
    "DangerConfig",
    "DepthNoiseConfig",
    "EnvConfig",
    "ImuConfig",
    "LearnConfig",
    "Model",
    "OdometryConfig",
    "RewardConfig",
    "RunConfig",
    "SensorConfig",
    "SensorsConfig",
    "Text",
    "TownFile",
    "VaryConfig",
    "WorldConfig",
    "parse",
    "parse_json",
    "read_toml",
    "resolve",
)
