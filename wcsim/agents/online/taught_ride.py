"""What was driven so far: rows for a data folder, and lessons as soon as their labels are known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.agents.collecting.data_folder import SEGMENTS, key_of, read_segment, segment_path, write_segment
from wcsim.agents.collecting.drive_segment import DrivenRow, segment_of
from wcsim.agents.collecting.labels import codes_of, unsafe_ahead
from wcsim.agents.collecting.segment import SegmentKey
from wcsim.agents.danger.lessons import KeptSight, Lectures, Lessons, kept, lessons_from, lessons_of
from wcsim.agents.danger.network import spec_of
from wcsim.agents.danger.sight import DangerSight
from wcsim.config import RunConfig
from wcsim.types import U8

_BLOCK: Final = 32  # steps that become lessons together
_LEAST_ROWS, _MOST_ROWS = 200, 1000  # of a segment: it ends with an episode, or when it is full


class TaughtRide:
    """One chair's driving, kept in a data folder and learned from.

    Args:
        config: Of the run.
        folder: Of the data.
        seed: Of the run.
    """

    def __init__(self, config: RunConfig, folder: Path, seed: int) -> None:
        self.lectures, self.segments = Lectures(config), dict[str, str]()  # SHA-256 by file name
        self._config, self._folder, self._seed = config, folder, seed
        self._window = spec_of(config).looks.window
        self._rows: list[DrivenRow] = []
        self._sights: list[KeptSight] = []  # of this episode, whose labels are not known yet
        self._codes: list[U8] = []
        self._before: list[KeptSight] = []  # of this episode, as far as windows reach back

    def add(self, sight: DangerSight, row: DrivenRow) -> None:
        """One step. Raises DiskFullError."""
        said = row.said if self._config.danger.teacher == "truth" else row.said.visible or row.said
        self._rows.append(row)
        self._sights.append(kept(sight))
        self._codes.append(codes_of(said.first_s))
        if row.step.done:
            self._teach(len(self._sights), ends=True)
            self._before.clear()
        elif len(self._sights) >= _BLOCK + self._config.danger.ahead:
            self._teach(_BLOCK, ends=False)
        if len(self._rows) >= (_LEAST_ROWS if row.step.done else _MOST_ROWS):
            self.write()

    def write(self) -> None:
        """Write what is not on disk yet. Raises DiskFullError."""
        if self._rows:
            path = segment_path(self._folder, SegmentKey(run=self._seed, round=0, index=len(self.segments)))
            self.segments[path.name] = write_segment(path, segment_of([self._rows]))
            self._rows = []

    def restore(self, segments: dict[str, str], alive: Callable[[], object] = lambda: None) -> None:
        """Learn again from the newest of what was written; see `write`.

        A long run has driven far more than it learns from, and reading all of it would take hours.

        Raises:
            PolicyError: A file is damaged or missing.
        """
        newest: list[Lessons] = []
        for name in sorted(segments, key=lambda name: key_of(name).index, reverse=True):
            if sum(map(len, newest)) >= self._config.learn.replay_frames:
                break
            newest.append(lessons_of(read_segment(self._folder / SEGMENTS / name, segments[name]), self._config))
            alive()
        for lessons in reversed(newest):
            self.lectures.add(lessons)
        self.segments = dict(segments)

    def _teach(self, count: int, ends: bool) -> None:
        """Make lessons of the oldest steps that wait."""
        last = np.zeros(len(self._codes), np.bool_)
        last[-1] = ends
        unsafe = unsafe_ahead(np.stack(self._codes), last, self._config.danger.ahead)[:count]
        at = len(self._before) + np.arange(count)[:, None] - np.arange(self._window - 1, -1, -1)
        taken = self._sights[:count]
        self.lectures.add(lessons_from(taken, np.maximum(at, 0).astype(np.int64), unsafe, self._before))
        self.lectures.keep_newest(self._config.learn.replay_frames)
        reach = max(self._window - 1, 0)
        self._before = [*self._before, *taken][-reach:] if reach else []
        del self._sights[:count], self._codes[:count]
