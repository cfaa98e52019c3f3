"""The senses that a policy asks for, turned on in its chair; the worlds of other chairs stay as they are."""

from __future__ import annotations

from collections.abc import Sequence

from wcsim.agents.policy_api import GYRO, NeedsSenses, Policy
from wcsim.config import RunConfig


def senses_of(policy: Policy) -> tuple[str, ...]:
    """What a policy wants to sense beside pictures, tilt and joystick."""
    return policy.senses if isinstance(policy, NeedsSenses) else ()


def sense_settings(config: RunConfig, senses: Sequence[str]) -> tuple[str, ...]:
    """What turns these senses on in a configuration; a sensor that it has already stays as it is."""
    there = config.sensors.on()
    words = [f"sensors.{name}=typical" for name in senses if name != GYRO and name not in there]
    return (*words, *(["env.observe_gyro=true"] if GYRO in senses else []))
