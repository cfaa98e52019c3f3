"""What the commands that train one network show of it, and what they leave behind when it fails."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from wcsim.agents.collecting.data_folder import DATA, SEGMENTS
from wcsim.cli.shared.consoles import stderr_console
from wcsim.core.reading import counted
from wcsim.errors import DiskFullError, WorkersError

if TYPE_CHECKING:
    from wcsim.agents.learning.callbacks import TrainProgress  # loads torch


@contextmanager
def gone_if_nothing_came_of_it(run: Path) -> Iterator[None]:
    """Remove a run folder made in the block when it fails before an episode, a segment or a checkpoint was saved.

    It stays after a full disk, and when a cluster is lost: wcsim resume goes on.
    """
    fresh = not run.exists()
    made = [folder for folder in run.parents if not folder.exists()]
    try:
        yield
    except (DiskFullError, OSError, WorkersError):
        raise
    except BaseException:
        metrics = run / "metrics.csv"
        episodes = len(metrics.read_bytes().splitlines()) - 1 if metrics.is_file() else 0
        saved = any(any(run.glob(f"{kept}/*")) for kept in ("checkpoints", "policies", f"{DATA}/{SEGMENTS}"))
        if fresh and episodes < 1 and not saved:
            shutil.rmtree(run, ignore_errors=True)
            for folder in made:
                with suppress(OSError):  # somebody else has put something there
                    folder.rmdir()
        raise


class TrainBar:
    """A progress bar on a terminal; elsewhere, as in a log file, a line for each tenth of the way."""

    def __init__(self, total: int) -> None:
        self.console = stderr_console()
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[says]}"))
        silent = not self.console.is_terminal
        self._bar = Progress(*columns, TimeRemainingColumn(), console=self.console, disable=silent)
        self._task = self._bar.add_task("loading the town", total=total, says="")
        self._total, self._tenths = total, 0

    def show(self, now: TrainProgress) -> None:
        """Say how far it has come."""
        kpi1 = "" if now.kpi1 is None else f", KPI 1 {now.kpi1:.3f}"
        step = min(now.step, now.total_steps)  # the last steps are done together, and may be a few more
        known = f"{counted(now.episodes, 'episode')}, {counted(now.crashes, 'crash')}{kpi1}"
        says = f"{step}/{now.total_steps} steps, {known}"
        phase = f"phase {now.phase}"
        self._bar.update(self._task, completed=now.step, description=phase, says=says)
        tenths = 10 * now.step // self._total
        if not self.console.is_terminal and tenths > self._tenths:
            self._tenths = tenths
            self.console.print(f"{phase}: {says}", soft_wrap=True)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._bar.stop()
