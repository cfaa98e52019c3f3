"""What is refused with an error that says why."""

from collections.abc import Callable
from typing import Any

import pytest


def refusing(error: type[Exception], call: Callable[..., object]) -> Callable[..., None]:
    """A check that `call` refuses what it is given: (a pattern of what the error says, what `call` is given)."""

    def refused(said: str, *given: Any, **named: Any) -> None:
        with pytest.raises(error, match=said):
            call(*given, **named)

    return refused
