"""Every file that wcsim reads from disk, as frozen models: an unknown key or a number out of bounds is an error.

Angles are in degrees in keys that end in `_deg`, and nowhere else. Presets are TOML files in `wcsim/config/presets/`.
"""

from __future__ import annotations

from wcsim.config.base import Finite as Finite
from wcsim.config.base import Model as Model
from wcsim.config.base import NotNegative as NotNegative
from wcsim.config.base import Share as Share
from wcsim.config.base import Text as Text
from wcsim.config.chair import PROFILE_SPEED_MPS as PROFILE_SPEED_MPS
from wcsim.config.chair import ChairConfig as ChairConfig
from wcsim.config.env import LEAST_WINDOW as LEAST_WINDOW
from wcsim.config.env import EnvConfig as EnvConfig
from wcsim.config.env import JoystickDistance as JoystickDistance
from wcsim.config.env import RewardConfig as RewardConfig
from wcsim.config.env import Window as Window
from wcsim.config.learning.collect import CollectConfig as CollectConfig
from wcsim.config.learning.danger import DangerConfig as DangerConfig
from wcsim.config.learning.learn import LearnConfig as LearnConfig
from wcsim.config.load import CONFIG_FILE as CONFIG_FILE
from wcsim.config.load import parse as parse
from wcsim.config.load import parse_json as parse_json
from wcsim.config.load import read_toml as read_toml
from wcsim.config.load import resolve as resolve
from wcsim.config.randomization import VaryConfig as VaryConfig
from wcsim.config.run import MAX_SEEN_PX as MAX_SEEN_PX
from wcsim.config.run import RunConfig as RunConfig
from wcsim.config.scene import TownFile as TownFile
from wcsim.config.sensors import CameraConfig as CameraConfig
from wcsim.config.sensors import CameraNoiseConfig as CameraNoiseConfig
from wcsim.config.sensors import ClassNoiseConfig as ClassNoiseConfig
from wcsim.config.sensors import DepthNoiseConfig as DepthNoiseConfig
from wcsim.config.sensors import ImuConfig as ImuConfig
from wcsim.config.sensors import OdometryConfig as OdometryConfig
from wcsim.config.sensors import SensorConfig as SensorConfig
from wcsim.config.sensors import SensorsConfig as SensorsConfig
from wcsim.config.world import STREETS as STREETS
from wcsim.config.world import WorldConfig as WorldConfig
