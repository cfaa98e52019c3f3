"""What a call is measured by: the processor time it takes, and when it has an answer.

Processor time is a multiple of that of plain Python in the same run: no machine is too slow.
"""

import math
import time
from collections.abc import Callable
from typing import Any

SQUARES = 10_000  # about half a millisecond


def multiple(work: Callable[[], object], turns: int = 30) -> float:
    """Best time of `work` over the best of summing up `SQUARES` squares, in turn, so that both meet the same load."""
    best, yardstick = math.inf, math.inf
    for _ in range(turns):
        start = time.process_time()
        work()
        between = time.process_time()
        sum(i * i for i in range(SQUARES))
        best, yardstick = min(best, between - start), min(yardstick, time.process_time() - between)
    return best / yardstick


def waited(what: Callable[[], Any], within_s: float = 120.0) -> Any:
    """What `what()` gives, once it gives something."""
    deadline_s = time.monotonic() + within_s
    while not (found := what()):
        assert time.monotonic() < deadline_s, what
        time.sleep(0.02)
    return found
