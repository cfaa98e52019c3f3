"""When a client's process has grown so far that a fresh one should go on with its work.

What allocates for weeks grows a little, whatever is done about it. A world is replaced between epochs for that; a
client is, too, where an epoch has just begun: its episode was cut there anyway.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from typing import Final

from wcsim.config import LearnConfig
from wcsim.errors import InterruptedRunError
from wcsim.server.specs import rss_mb

SETTLED_STEPS: Final = 200  # of a life, after which its memory is what it begins with


class ProcessGrownError(InterruptedRunError):
    """The work is saved, and another process is to go on with it."""


class ProcessGrowth:
    """Watches the memory of this process, and asks it to end as a launcher would, once, when it has grown too far.

    It has begun when the replay is full, which has a bound of its own (`learn.replay_frames`).

    Args:
        learn: Of the client.
        memory_mb: Of this process.
        end: Asks it to save its work and end.
    """

    def __init__(
        self,
        learn: LearnConfig,
        memory_mb: Callable[[], float] = rss_mb,
        end: Callable[[], object] = lambda: os.kill(os.getpid(), signal.SIGTERM),
    ) -> None:
        self._limit_mb, self._full_step = learn.process_growth_mb, learn.replay_frames
        self._memory_mb, self._end = memory_mb, end
        self._first_step: int | None = None  # of this life
        self._epoch = -1
        self._begun_mb: float | None = None
        self.told = ""  # why it was asked to end

    def look(self, step: int, epoch: int) -> None:
        """To be called every few steps.

        Args:
            step: Of the run.
            epoch: Of the world; -1 where it is not known.
        """
        self._first_step = step if self._first_step is None else self._first_step
        if self._begun_mb is None:
            if step > max(self._first_step + SETTLED_STEPS, self._full_step):
                self._begun_mb, self._epoch = self._memory_mb(), epoch
            return
        if epoch == self._epoch or self.told:
            return
        self._epoch, now_mb = epoch, self._memory_mb()
        if now_mb - self._begun_mb > self._limit_mb:
            self.told = f"its process has grown from {self._begun_mb:.0f} to {now_mb:.0f} MB"
            self._end()
