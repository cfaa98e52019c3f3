"""Where a learner's time goes: choosing actions, learning, and the rest, which its environment takes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ParamSpec, TypeVar

from wcsim.agents.learning.callbacks import SeqCallback

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(slots=True)
class Stopped:
    """A stopwatch around calls."""

    seconds: float = 0.0
    calls: int = 0
    _open: bool = field(default=False, repr=False)

    def around(self, call: Callable[P, R]) -> Callable[P, R]:
        """The same call, measured; one within another counts once."""

        def measured(*args: P.args, **kwargs: P.kwargs) -> R:
            if self._open:
                return call(*args, **kwargs)
            self._open, begun_s = True, time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self._open = False
                self.seconds += time.perf_counter() - begun_s
                self.calls += 1

        return measured


class TimeShares(SeqCallback):
    """Measures how long a learner takes for its decisions (`inference`) and for its updates (`learning`)."""

    def __init__(self) -> None:
        super().__init__()
        self.inference, self.learning = Stopped(), Stopped()

    def _on_training_start(self) -> None:
        learner = self.learner
        setattr(learner, "predict", self.inference.around(learner.predict))  # noqa: B010 - mypy knows methods as fixed
        setattr(learner.policy, "predict", self.inference.around(learner.policy.predict))  # noqa: B010
        setattr(learner, "do_updates", self.learning.around(learner.do_updates))  # noqa: B010
