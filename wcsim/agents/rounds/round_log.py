"""metrics.csv of a danger network's run: one row a round, written when it is done."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from wcsim.agents.runs.metrics import MetricsFile, read_metrics
from wcsim.config import parse
from wcsim.config.run_file import TrainedRound
from wcsim.core.reading import FileKind, escaped, read_text
from wcsim.errors import ConfigError, PolicyError

_COLUMNS: Final = (
    *("round", "steps", "new_steps", "tight_share", "crashes", "updates", "loss"),
    *("wait_s_wall", "learn_s_wall"),
)
_KIND = FileKind(what="the metrics.csv of a run", limit_bytes=1 << 30, error=PolicyError)


def note_round(path: Path, row: Sequence[float]) -> None:
    """Add a row to metrics.csv; rows from its round on belong to work that was lost.

    Raises:
        DiskFullError: There is no room.
        PolicyError: The file is damaged, or of another version.
    """
    MetricsFile(path, int(row[0]) - 1, _COLUMNS).add(dict(zip(_COLUMNS, row, strict=True)))


def logs_rounds(path: Path) -> bool:
    """Whether a metrics.csv is one of rounds."""
    return read_text(path, _KIND).startswith(",".join(_COLUMNS[:2]) + ",")


def read_rounds(path: Path) -> tuple[TrainedRound, ...]:
    """All rows of it. Raises PolicyError when it is damaged, or of another version."""
    rows = [dict(zip(TrainedRound.model_fields, row.values(), strict=True)) for row in read_metrics(path, _COLUMNS)]
    try:
        found = tuple(parse(TrainedRound, row, path.name) for row in rows)
    except ConfigError as error:
        raise PolicyError(
            f"{escaped(path)}: is damaged ({error}); expected the numbers of a round in each row"
        ) from None
    if [row.round for row in found] != list(range(len(found))):
        raise PolicyError(f"{escaped(path)}: is damaged; expected a row for each round, from 0 on")
    return found
