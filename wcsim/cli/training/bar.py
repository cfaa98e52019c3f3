"""What the commands that train one network show of it, and what they leave behind when it fails."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from wcsim.agents.collecting.data_folder import DATA, SEGMENTS
from wcsim.cli.shared.common import fresh_folders
from wcsim.cli.shared.stage_bar import StageBar
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
    with fresh_folders(run.parent):
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
            raise


def steps_shown(bar: StageBar) -> Callable[[TrainProgress], None]:
    """Shows on a bar how far a training has come; where that is no terminal, in a line for each tenth of the way."""
    tenths = 0

    def show(now: TrainProgress) -> None:
        nonlocal tenths
        kpi1 = "" if now.kpi1 is None else f", KPI 1 {now.kpi1:.3f}"
        step = min(now.step, now.total_steps)  # the last steps are done together, and may be a few more
        known = f"{counted(now.episodes, 'episode')}, {counted(now.crashes, 'crash')}{kpi1}"
        says, phase = f"{step}/{now.total_steps} steps, {known}", f"phase {now.phase}"
        bar.show(step / now.total_steps, says, phase)
        if not bar.console.is_terminal and 10 * step // now.total_steps > tenths:
            tenths = 10 * step // now.total_steps
            bar.say(f"{phase}: {says}", left=False)

    return show
