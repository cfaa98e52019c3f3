"""A kind of file that a person may get from another, and how a sound one is spoilt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.attack.scenarios.twists import Rng, twisted


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """A kind of file: a sound one, how it is spoilt, and what says that it was taken rightly."""

    name: str
    file: str
    sound: bytes
    twist: Callable[[Rng], tuple[bytes, str]]
    take: Callable[[Path], bool]  # whether what was made of the file makes the same again
    share: int  # of all cases
    beside: tuple[tuple[str, bytes], ...] = ()  # files that a sound one needs


def model_twist(data: dict[str, Any], write: Callable[[dict[str, Any]], str]) -> Callable[[Rng], tuple[bytes, str]]:
    """Fields of a sound one are others, none or more than there were."""

    def twist(rng: Rng) -> tuple[bytes, str]:
        changed, told = twisted(data, rng)
        return write(changed).encode(), told

    return twist
