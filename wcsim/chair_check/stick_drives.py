"""Drives that a chair's own electronics recorded: the stick, and the speeds of its wheels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.core.reading import CHAIR, escape, is_file, read_lines
from wcsim.errors import ConfigError
from wcsim.types import F64

STEP_S: Final = 0.02
_STICK: Final = "t_s,axis0,axis1"
_ODOMETRY: Final = "t_s,v_mps,w_radps"
_LONGEST_GAP_S: Final = 1.0  # over more it is not known what the stick did
_SHORTEST_S: Final = 2.0
_LONGEST_S: Final = 86_400.0
# After which a turn of the stick shows, roughly: enough for the sign of an axis.
_ANSWER_S: Final = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedDrive:
    """A drive that begins at rest, a sample every `STEP_S`."""

    name: str  # of its files
    stick: F64  # (n, 2) to the right, ahead
    motion: F64  # (n, 2) speed ahead in m/s, turn rate to the left in rad/s


def read_recorded_drives(paths: Sequence[Path]) -> tuple[RecordedDrive, ...]:
    """Read drives. The sign of their first axis is the one that fits all their turns best.

    Args:
        paths: `NAME.joy.csv` (`t_s,axis0,axis1`, axis1 ahead, both from -1 to 1), each with
            `NAME.odom.csv` (`t_s,v_mps,w_radps`) beside it; one or both may end in `.gz`.

    Raises:
        ConfigError: A file is missing or no such table, or all drives together turn too little to
            tell the axis.
    """
    drives = [_read(path) for path in paths]
    late = round(_ANSWER_S / STEP_S)
    turned = sum(float(drive.stick[:-late, 0] @ drive.motion[late:, 1]) for drive in drives)
    if abs(turned) * STEP_S < 1.0:
        raise ConfigError(
            f"{len(drives)} drives turn too little to say whether axis0 points right or left; "
            "expected some turns: add drives with turns"
        )
    # To the left is positive for turns and negative for the stick.
    turn = np.array([-np.sign(turned), 1.0])
    return tuple(replace(drive, stick=drive.stick * turn) for drive in drives)


def _read(path: Path) -> RecordedDrive:
    name, found, _ = path.name.partition(".joy.csv")
    if not found:
        raise ConfigError(
            f"{escape(path)}: expected the name of a file as NAME.joy.csv or NAME.joy.csv.gz"
        )
    beside = [path.with_name(f"{name}.odom.csv{end}") for end in ("", ".gz")]
    stick = _table(path, _STICK)
    odometry = _table(next(filter(is_file, beside), beside[0]), _ODOMETRY)
    if np.abs(stick[:, 1:]).max() > 1.1:
        raise ConfigError(
            f"{escape(path)}: the stick is at {np.abs(stick[:, 1:]).max():g}; expected -1 to 1"
        )
    first_s, last_s = max(stick[0, 0], odometry[0, 0]), min(stick[-1, 0], odometry[-1, 0])
    if not _SHORTEST_S <= last_s - first_s <= _LONGEST_S:
        raise ConfigError(
            f"{escape(path)}: stick and odometry have {last_s - first_s:.1f} s in common; "
            f"expected {_SHORTEST_S:g} s to a day: record both by one clock"
        )
    at_s = np.arange(first_s, last_s, STEP_S)
    both = [
        np.stack([np.interp(at_s, rows[:, 0], rows[:, k]) for k in (1, 2)], axis=1)
        for rows in (stick, odometry)
    ]
    return RecordedDrive(name=name, stick=both[0], motion=both[1])


def _table(path: Path, columns: str) -> F64:
    """The rows (n, 3) of a table with times that do not fall. Raises ConfigError."""
    lines = read_lines(path, CHAIR)
    head = next(lines, "")
    try:
        rows = np.loadtxt(lines, delimiter=",", ndmin=2)
    except ValueError as error:
        raise ConfigError(
            f"{escape(path)}: is no table ({escape(error, 80)}); expected {CHAIR.what}"
        ) from None
    if head.strip() != columns:
        raise ConfigError(
            f"{escape(path)}: begins with {escape(head, 40)!r}; expected {columns}, in {CHAIR.what}"
        )
    apart_s = (
        np.diff(rows[:, 0]) if rows.shape[1] == 3 and np.isfinite(rows).all() else np.array([])
    )
    if not len(apart_s) or apart_s.min() < 0.0 or apart_s.max() > _LONGEST_GAP_S:
        raise ConfigError(
            f"{escape(path)}: expected rows of three finite numbers whose times rise by at most "
            f"{_LONGEST_GAP_S:g} s; split it where the recording stopped"
        )
    return rows
