"""wcsim: trains networks that assist the driver of a power wheelchair, in real cities.

Read `types.py`, then `bridge/world.py`. Importing this package names its environment for Gymnasium, which is
Gymnasium's own convention and the only thing that an import does; nothing heavy is loaded before the environment is
made.
"""

from gymnasium.envs.registration import register, registry

ENV_ID = "wcsim/Street-v1"
__version__ = "0.1.0"

__all__ = ["ENV_ID", "__version__"]

if ENV_ID not in registry:
    register(id=ENV_ID, entry_point="wcsim.agents.env:WheelchairEnv")
