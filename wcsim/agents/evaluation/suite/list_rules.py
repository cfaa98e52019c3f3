"""The rules of a list: all policies in it drive the same chair in the same world, and the same things are a crash.

A run brings what its network senses and does (cameras, sensors, `[imu]`, `[env]`, how it learned). Its street, chair,
crashes and ranges stay behind: with them `saved`, `lost` and the score would compare drives that were not judged alike.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any, Final

from wcsim.agents.evaluation.suite.named_policy import settings_of
from wcsim.agents.runs.policy_name import policy_name
from wcsim.config import RunConfig, resolve

_RULES: Final = ("world", "chair", "reward", "vary")  # sections
_PACE: Final = ("draw_threads", "epoch_ticks", "epoch_growth_mb")  # of `world`: they change no result


def settings_in_list(policy: str, preset: str, settings: tuple[str, ...]) -> RunConfig:
    """A policy's own senses and actions under the preset's rules, with the list's settings laid over both.

    Raises:
        PolicyError: There is no such policy.
        ConfigError: The settings cannot be used.
    """
    own, rules = settings_of(policy, preset, ()), resolve(preset)
    return resolve(own.model_copy(update={name: getattr(rules, name) for name in _RULES}), settings)


def told_of_rules(policies: Iterable[str], preset: str, settings: tuple[str, ...]) -> Iterator[str]:
    """A line for each policy that was trained under other rules than the list's. Raises as `settings_in_list` does."""
    for policy in policies:
        if policy_name(policy).kind in ("baseline", "served", "class"):
            continue
        learned, tested = settings_of(policy, preset, settings), settings_in_list(policy, preset, settings)
        other = list(_others(learned, tested))
        if other:
            was = ", ".join(f"{name}={_text(value)}" for name, value, _ in other)
            now = ", ".join(f"{name}={_text(value)}" for name, _, value in other)
            yield f"{policy} was trained with {was}; all policies of a list are tested with {now}"


def _others(learned: RunConfig, tested: RunConfig) -> Iterator[tuple[str, Any, Any]]:
    for name in _RULES:
        one, two = getattr(learned, name), getattr(tested, name)
        for key in type(one).model_fields:
            was, now = getattr(one, key), getattr(two, key)
            if was != now and key not in _PACE:
                yield f"{name}.{key}", was, now


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
