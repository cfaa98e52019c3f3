"""What the tests of the faces share: a small configuration, actions by the step alone, a reward term."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from gymnasium.utils.env_checker import data_equivalence

TINY = ("world.warmup_s=0", "cameras.0.width_px=32", "cameras.0.height_px=24")
LEARNABLE = ("world.warmup_s=0", "cameras.0.width_px=40", "cameras.0.height_px=36")  # what SB3's networks can take
ACTIONS = 81
BOTH = np.array([44, 44])  # an action for each of two chairs


def action_at(step: int, seat: int = 0) -> int:
    """An action of a chair."""
    return (7 * step + 11 * seat + 44) % ACTIONS


def equal(one: object, other: object) -> bool:
    """Whether two things made of dictionaries, lists, arrays and dataclasses are the same to the bit."""
    return bool(data_equivalence(one, other, exact=True))


@contextmanager
def closed_in_the_end(make: Callable[..., Any]) -> Iterator[Callable[..., Any]]:
    """Makes environments of `make`, whose first argument are its overrides, and closes them."""
    envs: list[Any] = []

    def made(*overrides: str, sized: tuple[str, ...] = TINY, **more: Any) -> Any:
        envs.append(make(overrides=(*sized, *overrides), **more))
        return envs[-1]

    yield made
    for env in envs:
        env.close()


class Counting:
    """A reward term that remembers."""

    def __init__(self) -> None:
        self.steps = 0

    def reset(self) -> None:
        self.steps = 0

    def reward(self, before: Any, after: Any) -> float:
        self.steps += 1
        return float(self.steps)
