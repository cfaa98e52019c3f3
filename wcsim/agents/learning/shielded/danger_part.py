"""The danger network that a run of values is shielded by, as files; and dangers as bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from wcsim.agents.runs.policy_file import POLICY_JSON, WEIGHTS, is_danger
from wcsim.agents.runs.run_folder import RunFolder, policy_path
from wcsim.core import files
from wcsim.core.reading import is_folder
from wcsim.errors import PolicyError
from wcsim.types import F64, U8

PART: Final = "danger"  # folder of the danger network within a run, and within a policy
MOST: Final = 254  # the code of a danger of 1; Stable-Baselines3 takes arrays of up to 255 for pictures


def codes_of_dangers(danger: F64) -> U8:
    """Dangers (A,) in 0..1 as bytes.

    >>> codes_of_dangers(np.array([0.0, 0.3, 1.0])).tolist()
    [0, 76, 254]
    """
    codes: U8 = np.rint(MOST * danger).astype(np.uint8)
    return codes


def dangers_of_codes(codes: npt.NDArray[np.uint8]) -> F64:
    """The dangers that such bytes stand for."""
    return codes.astype(np.float64) / MOST


def danger_part(run: RunFolder) -> Path | None:
    """The folder of the danger network that a run learns on top of, None for one that does not.

    It is copied into the run once, so that the run goes on with the same one whatever becomes of its own run.

    Raises:
        PolicyError: There is no such policy, or it is no danger network.
        DiskFullError: There is no room.
    """
    name, own = run.config.learn.danger, run.path / PART
    if not name:
        return None
    if not is_folder(own):
        path = policy_path(name)
        if not is_danger(path):
            raise PolicyError(f"learn.danger={name}: was trained by Q-learning; expected a danger network")
        copy_part(path, own)
    return own


def copy_part(source: Path, target: Path) -> None:
    """Copy a danger network's policy folder, byte for byte. Raises DiskFullError."""

    def fill(work: Path) -> None:
        for name in (POLICY_JSON, WEIGHTS):
            files.write_bytes(work / name, (source / name).read_bytes())

    files.write_folder(target, fill)
