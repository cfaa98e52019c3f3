"""What is kept for tests (`held_out.toml`), and its refusal where anything learns or is chosen."""

from collections.abc import Iterable
from types import MappingProxyType
from typing import Any, Final

from wcsim.core.reading import escape, read_module_toml
from wcsim.errors import ConfigError

HELD_OUT: Final = MappingProxyType[str, list[str]](read_module_toml(__file__))
"""Names by kind: family (of generated scenes), profile, town."""


def refuse_held_out(kind: str, names: Iterable[Any], where: str) -> None:
    """Refuse what is kept for tests.

    Args:
        kind: One of `HELD_OUT`.
        names: Of that kind.
        where: The option, setting or file that has them.

    Raises:
        ConfigError: One of them is kept for tests.
    """
    for name in names:
        if name in HELD_OUT[kind]:
            raise ConfigError(
                f"{escape(where)}: {kind} {name} is held out of training and of all choices: tests "
                f"use it as one that no network has met; expected another {kind}"
            )
