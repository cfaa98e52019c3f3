"""What an exported model costs in a process of its own: time of a step on a whole core and on a share of it, memory.

The share of a core is made by stopping and continuing the process (SIGSTOP, SIGCONT): machines without control groups
have no quota, and it comes to the same for who waits for an answer.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from wcsim.agents.export import step_meter
from wcsim.errors import PolicyError

SHARE: Final = 0.5  # of a core, while the quota is measured
PERIOD_S: Final = 0.01  # in which it runs for its share, and stands still for the rest
_PATIENCE_S: Final = 300.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Footprint:
    """Of one model, on this machine."""

    p50_ms: float  # of a step, one thread
    p99_ms: float
    cpu_p50_ms: float  # of the processor's time: what others do on the machine counts for less
    quota_p50_ms: float  # with SHARE of a core
    quota_p99_ms: float
    peak_mb: float  # of the process, ONNX Runtime and Python with it


def footprint(model: Path, reference: Path, keys: Sequence[str]) -> Footprint:
    """Measure a model over its reference steps. Raises PolicyError when it does not run."""
    whole = _told(model, reference, keys, 1.0)
    part = _told(model, reference, keys, SHARE)
    return Footprint(
        p50_ms=float(np.median(whole["wall_ms"])),
        p99_ms=float(np.percentile(whole["wall_ms"], 99)),
        cpu_p50_ms=float(np.median(whole["cpu_ms"])),
        quota_p50_ms=float(np.median(part["wall_ms"])),
        quota_p99_ms=float(np.percentile(part["wall_ms"], 99)),
        peak_mb=float(whole["peak_mb"]),
    )


def _told(model: Path, reference: Path, keys: Sequence[str], share: float) -> dict[str, Any]:
    words = [sys.executable, str(step_meter.__file__), str(model), str(reference), ",".join(keys)]
    # Files take whatever it says: nobody reads a pipe while the process is throttled.
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as said:
        try:
            code = _run(words, share, out, said)
        except subprocess.TimeoutExpired:
            raise PolicyError(f"{model}: no answer within {_PATIENCE_S:g} s; expected its reference steps") from None
        answer, complaint = _read(out), _read(said)
    if code:
        last = complaint.strip().splitlines()[-1:] or ["no word"]
        raise PolicyError(f"{model} cannot be run by itself: {last[0][:200]}; expected ONNX Runtime to take it")
    told: dict[str, Any] = json.loads(answer)
    return told


def _run(words: Sequence[str], share: float, out: IO[bytes], said: IO[bytes]) -> int:
    """The exit code of a command that gets a share of a core. Raises TimeoutExpired."""
    with subprocess.Popen(words, stdout=out, stderr=said) as process:
        try:
            if share < 1.0:
                _throttle(process, share)
            return process.wait(timeout=_PATIENCE_S)
        except BaseException:  # it may stand still, and would be waited for
            process.kill()
            raise


def _read(written: IO[bytes]) -> str:
    written.seek(0)
    return written.read().decode(errors="replace")


def _throttle(process: subprocess.Popen[bytes], share: float) -> None:
    """Let a process run for its share of each period, until it ends."""
    until_s = time.monotonic() + _PATIENCE_S
    while process.poll() is None and time.monotonic() < until_s:
        time.sleep(share * PERIOD_S)
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGSTOP)
            time.sleep((1.0 - share) * PERIOD_S)
            process.send_signal(signal.SIGCONT)
