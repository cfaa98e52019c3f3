"""The rules of a list: all policies in it drive the same chair in the same world, and the same things are a crash.

A run brings what its network senses and does (cameras, sensors, `[imu]`, `[env]`, how it learned). Its street, chair,
crashes and ranges stay behind: with them `saved`, `lost` and the score would compare drives that were not judged alike.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any, Final

from wcsim.agents.evaluation.suite.named_policy import RULES, config_for
from wcsim.agents.runs.policy_name import policy_name
from wcsim.config import RunConfig

_PACE: Final = ("draw_threads", "epoch_ticks", "epoch_growth_mb")  # of `world`: they change no result


def told_of_rules(policies: Iterable[str], preset: str, settings: tuple[str, ...]) -> Iterator[str]:
    """A line for each policy that was trained under other rules than the list's. Raises as `config_for` does."""
    for policy in policies:
        if policy_name(policy).kind in ("baseline", "served", "class"):
            continue
        learned, tested = (config_for(policy, preset, settings, in_list=rules) for rules in (False, True))
        other = list(_others(learned, tested))
        if other:
            was = ", ".join(f"{name}={_text(value)}" for name, value, _ in other)
            now = ", ".join(f"{name}={_text(value)}" for name, _, value in other)
            yield f"{policy} was trained with {was}; all policies of a list are tested with {now}"


def _others(learned: RunConfig, tested: RunConfig) -> Iterator[tuple[str, Any, Any]]:
    for name in RULES:
        one, two = getattr(learned, name), getattr(tested, name)
        for key in type(one).model_fields:
            was, now = getattr(one, key), getattr(two, key)
            if was != now and key not in _PACE:
                yield f"{name}.{key}", was, now


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
