"""The logs of trainings: metrics.csv with episodes or rounds, steps.csv with rows of 100 steps.

Episodes go to TensorBoard too, where it is installed and requested (`learn.tensorboard`).
"""

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from wcsim.config import parse
from wcsim.config.run_file import RoundMetricsRow
from wcsim.core import files, reading
from wcsim.core.closing import ClosingContextBase
from wcsim.core.reading import escape, read_lines, read_text
from wcsim.errors import ConfigError, DiskFullError, PolicyError

COLUMNS: Final = (
    *("step", "episode", "phase", "return", "length", "kpi1", "kpi1_greedy", "crashed"),
    *("crash_reason", "speed_mps", "progress_m", "arrivals", "epsilon", "margin_weight", "loss"),
    *("max_abs_q", "updates", "elapsed_s_wall", "value_start", "return_start", "overestimate"),
    "cut",
)
STEP_COLUMNS: Final = ("step", "phase", "kpi1_greedy", "elapsed_s_wall")
_ROUND_COLUMNS: Final = (
    *("round", "steps", "new_steps", "tight_share", "crashes", "network_steps"),
    *("network_crashes", "user_steps", "user_crashes", "updates", "loss"),
    *("wait_s_wall", "learn_s_wall"),
)

# Steps in a row of steps.csv.
ROW_STEPS: Final = 100

# Steps that a mean of KPI 1 goes over.
KPI1_STEPS: Final = 20 * ROW_STEPS

# In a run folder.
TENSORBOARD: Final = "tensorboard"

_STEP: Final = re.compile(r"[0-9]{1,15}", re.ASCII)
_TRAINS: Final = frozenset({"epsilon", "margin_weight", "loss", "max_abs_q", "updates"})
_LEFT_OUT: Final = frozenset({"step", "episode", "round"})
Value = float | int | str | None


class MetricsFile:
    """Appends rows; every row is complete on disk before the next step."""

    def __init__(
        self, path: Path, last_step: int | None = None, columns: tuple[str, ...] = COLUMNS
    ) -> None:
        """Start a new file, or continue one: rows after `last_step` belong to lost work."""
        self.path = path
        self.columns = columns
        last = last_step if last_step is not None and path.is_file() else -1
        rows: Iterator[list[str]] = iter(())
        if last >= 0:
            rows = _checked(path, columns, read_lines(path, reading.METRIC_LINES))
        with (
            files.write_file_atomically(path) as part,
            part.open("w", encoding="utf-8", newline="") as file,
        ):
            file.write(_line(columns))
            file.writelines(_line(row) for row in rows if int(row[0]) <= last)

    def add(self, row: Mapping[str, Value]) -> None:
        """Append a row; numbers that are not finite are left empty.

        Raises:
            KeyError: A column has no value.
            DiskFullError: There is no room.
        """
        line = _line([_text(row[name]) for name in self.columns])
        try:
            with self.path.open("a", encoding="utf-8", newline="") as file:
                file.write(line)
        except OSError as error:
            raise DiskFullError(
                f"{self.path}: a row could not be written ({error.strerror}); make room"
            ) from None


def read_metrics(path: Path, columns: tuple[str, ...] = COLUMNS) -> list[dict[str, str]]:
    """All complete rows of a log.

    Raises:
        PolicyError: It has other columns, or a row is damaged.
    """
    lines = io.StringIO(read_text(path, reading.METRICS), newline="")
    return [dict(zip(columns, row, strict=True)) for row in _checked(path, columns, lines)]


def _checked(path: Path, columns: tuple[str, ...], lines: Iterable[str]) -> Iterator[list[str]]:
    """The rows below the head; a process that was killed can leave a truncated last line."""
    rows = csv.reader(line for line in lines if line.endswith(("\n", "\r")))
    try:
        head = next(rows, [])
        if tuple(head) != columns:
            names = escape(", ".join(head)) or "none"
            raise PolicyError(
                f"{path} has columns {names}; expected those of this version: {', '.join(columns)}"
            )
        last = 0
        for row in rows:
            step = int(row[0]) if len(row) == len(columns) and _STEP.fullmatch(row[0]) else -1
            if step < last:
                raise PolicyError(
                    f"{path}:{rows.line_num}: is damaged; expected {len(columns)} values, the "
                    f"first a growing {columns[0]}"
                )
            last = step
            yield row
    except csv.Error as error:
        raise PolicyError(
            f"{escape(path)}: is damaged ({error}); expected the log of a run"
        ) from None


def _text(value: Value) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _line(values: Iterable[object]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerow(values)
    return out.getvalue()


def append_round_metrics(path: Path, row: Sequence[float], tensorboard: bool = False) -> None:
    """Add a row to metrics.csv, and to TensorBoard; rows from its round on are of lost work.

    Raises:
        DiskFullError: There is no room.
        PolicyError: The file is damaged, or of another version.
    """
    named = dict(zip(_ROUND_COLUMNS, row, strict=True))
    MetricsFile(path, int(row[0]) - 1, _ROUND_COLUMNS).add(named)
    if tensorboard:
        with TensorBoardLog(path.parent, int(row[0]) - 1) as board:
            board.add(named)


def has_metrics_per_round(path: Path) -> bool:
    """Whether a metrics.csv is one of rounds."""
    return next(read_lines(path, reading.METRIC_LINES), "").startswith(
        ",".join(_ROUND_COLUMNS[:2]) + ","
    )


def read_round_metrics(path: Path) -> tuple[RoundMetricsRow, ...]:
    """All rows of it. Raises PolicyError when it is damaged, or of another version."""
    rows = [
        dict(zip(RoundMetricsRow.model_fields, row.values(), strict=True))
        for row in read_metrics(path, _ROUND_COLUMNS)
    ]
    try:
        found = tuple(parse(RoundMetricsRow, row, path.name) for row in rows)
    except ConfigError as error:
        raise PolicyError(
            f"{escape(path)}: is damaged ({error}); expected the numbers of a round in each row"
        ) from None
    if [row.round for row in found] != list(range(len(found))):
        raise PolicyError(f"{escape(path)}: is damaged; expected a row for each round, from 0 on")
    return found


class TensorBoardLog(ClosingContextBase):
    """Writes the numbers of a row as scalars, `train/NAME`, `episode/NAME` or `round/NAME`.

    They stand at the row's step or round.
    """

    def __init__(self, run: Path, last_step: int | None = None) -> None:
        """Start in a run folder, or continue: what is after `last_step` belongs to lost work.

        Raises:
            ConfigError: TensorBoard is not installed.
        """
        purge_step = None if last_step is None else last_step + 1
        self._writer = _writer_class()(str(run / TENSORBOARD), purge_step=purge_step)

    def add(self, row: Mapping[str, Value]) -> None:
        """Write a row of metrics.csv; what is no number is left out."""
        first = next(iter(row))
        kind, step = first.replace("step", "episode"), int(row[first] or 0)
        for name, value in row.items():
            if isinstance(value, int | float) and name not in _LEFT_OUT:
                self._writer.add_scalar(
                    f"{'train' if name in _TRAINS else kind}/{name}", value, step
                )
        self._writer.flush()

    def close(self) -> None:
        """End the files."""
        self._writer.close()


def require_tensorboard_installed() -> None:
    """Raise ConfigError when TensorBoard is not installed."""
    _writer_class()


def _writer_class() -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise ConfigError(
            "learn.tensorboard=true needs a package that is not installed: python -m pip install "
            "tensorboard, or leave it out: metrics.csv holds the same numbers"
        ) from None
    return SummaryWriter
