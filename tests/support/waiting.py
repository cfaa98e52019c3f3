"""Waiting for what another process does."""

import time
from collections.abc import Callable
from typing import Any


def waited(what: Callable[[], Any], within_s: float = 120.0) -> Any:
    """What `what()` gives, once it gives something."""
    deadline_s = time.monotonic() + within_s
    while not (found := what()):
        assert time.monotonic() < deadline_s, what
        time.sleep(0.02)
    return found
