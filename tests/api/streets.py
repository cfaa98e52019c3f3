"""What the tests of the faces share: a small configuration, actions that depend on nothing but the step."""

from __future__ import annotations

from gymnasium.utils.env_checker import data_equivalence

TINY = ("world.warmup_s=0", "cameras.0.width_px=32", "cameras.0.height_px=24")
LEARNABLE = ("world.warmup_s=0", "cameras.0.width_px=40", "cameras.0.height_px=36")  # what SB3's networks can take
ACTIONS = 81


def action_at(step: int, seat: int = 0) -> int:
    """An action of a chair."""
    return (7 * step + 11 * seat + 44) % ACTIONS


def equal(one: object, other: object) -> bool:
    """Whether two things made of dictionaries, lists, arrays and dataclasses are the same to the bit."""
    return bool(data_equivalence(one, other))
