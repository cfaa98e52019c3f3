"""The senses that a policy asks for, turned on in its chair; the worlds of other chairs stay as they are."""

from __future__ import annotations

from collections.abc import Sequence

from wcsim.agents.policy_api import GYRO, NeedsSenses, Policy
from wcsim.config import RunConfig, resolve


def senses_of(policy: Policy) -> tuple[str, ...]:
    """What a policy wants to sense beside pictures, tilt and joystick."""
    return policy.senses if isinstance(policy, NeedsSenses) else ()


def with_senses(config: RunConfig, senses: Sequence[str]) -> RunConfig:
    """The configuration with these senses; a sensor that it has already stays as it is.

    Raises:
        ConfigError: There is no such sensor.
    """
    there = config.sensors.on()
    words = [f"sensors.{name}=typical" for name in senses if name != GYRO and name not in there]
    if GYRO in senses and not config.env.observe_gyro:
        words.append("env.observe_gyro=true")
    return resolve(config, tuple(words))
