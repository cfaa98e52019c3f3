"""The rows of metrics.csv for TensorBoard too, where it is installed and asked for (`learn.tensorboard`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from wcsim.errors import ConfigError

FOLDER: Final = "tensorboard"  # in a run folder
_TRAINS: Final = frozenset({"epsilon", "margin_weight", "loss", "max_abs_q", "updates"})
_LEFT_OUT: Final = frozenset({"step", "episode"})


class BoardLog:
    """Writes each number of a row as a scalar, `episode/NAME` or `train/NAME`, at the row's step; close it."""

    def __init__(self, run: Path, keep_to_step: int | None = None) -> None:
        """Begin in a run folder, or go on there: what is after `keep_to_step` belongs to work that was lost.

        Raises:
            ConfigError: TensorBoard is not installed.
        """
        self._writer = _writer_class()(str(run / FOLDER), purge_step=None if keep_to_step is None else keep_to_step + 1)

    def add(self, row: Mapping[str, float | int | str | None]) -> None:
        """Write a row of metrics.csv; what is no number is left out."""
        step = int(row["step"] or 0)
        for name, value in row.items():
            if isinstance(value, int | float) and name not in _LEFT_OUT:
                self._writer.add_scalar(f"{'train' if name in _TRAINS else 'episode'}/{name}", value, step)
        self._writer.flush()

    def close(self) -> None:
        """End the files."""
        self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def require_tensorboard() -> None:
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
