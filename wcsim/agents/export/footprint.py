"""What an exported model tells in each step, and what that costs: time on a whole core and on a share of it, memory.

It measures itself as a program of its own (`python footprint.py MODEL REFERENCE KEYS`), with NumPy and ONNX Runtime
alone: what that holds in memory is what a chair's computer would hold. The share of a core is made by stopping and
continuing the process (SIGSTOP, SIGCONT): machines without control groups have no quota, and it comes to the same for
who waits for an answer.
"""

from __future__ import annotations

import contextlib
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.core.processes import run_command
from wcsim.errors import PolicyError

SHARE: Final = 0.5  # of a core, while the quota is measured
PERIOD_S: Final = 0.01  # in which it runs for its share, and stands still for the rest
_PATIENCE_S: Final = 300.0
_PROGRAM: Final = __file__
_WARM_UP: Final = 10  # steps that are not measured
Arrays = Mapping[str, Any]


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
    words = [sys.executable, _PROGRAM, str(model), str(reference), ",".join(keys)]
    try:
        run = run_command(words, _PATIENCE_S, on_start=lambda process: _throttle(process, share))
    except subprocess.TimeoutExpired:
        raise PolicyError(
            f"{model}: no answer within {_PATIENCE_S:g} s; expected its reference steps"
        ) from None
    if run.returncode:
        last = run.stderr.strip().splitlines()[-1:] or ["no word"]
        raise PolicyError(
            f"{model} cannot be run by itself: {last[0][:200]}; expected ONNX Runtime to take it"
        )
    told: dict[str, Any] = json.loads(run.stdout)
    return told


def _throttle(process: subprocess.Popen[bytes], share: float) -> None:
    """Let a process run for its share of each period, until it ends; a whole core is no bound."""
    if share == 1.0:
        return
    until_s = time.monotonic() + _PATIENCE_S
    while process.poll() is None and time.monotonic() < until_s:
        time.sleep(share * PERIOD_S)
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGSTOP)
            time.sleep((1.0 - share) * PERIOD_S)
            process.send_signal(signal.SIGCONT)


def steps_of(
    session: Any,
    shown: Iterable[Arrays],
    keys: Sequence[str],
    before: Sequence[Sequence[Any]] | None = None,
) -> Iterator[dict[str, Any]]:
    """What a model tells in each step, by name.

    Args:
        session: Of ONNX Runtime.
        shown: Observations of successive steps.
        keys: Of its inputs.
        before: The states that each step begins with; None for zeros, and then those that the model itself told.
    """
    names = [item.name for item in session.get_outputs()]
    states = {
        item.name: np.zeros(item.shape, np.float32)
        for item in session.get_inputs()
        if item.name not in keys
    }
    for step, seen in enumerate(shown):
        if before is not None:
            states = dict(zip(states, before[step], strict=True))
        given = {key: np.ascontiguousarray(seen[key])[None] for key in keys}
        told = dict(zip(names, session.run(None, {**given, **states}), strict=True))
        states = {name: told[f"next_{name}"] for name in states}
        yield told


def _measure(model: str, reference: str, keys: Sequence[str]) -> dict[str, Any]:
    """Wall and processor time of every step, ms, and the most memory that this process ever held, MB."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    with np.load(reference, allow_pickle=False) as held:
        columns = {key: held[key] for key in keys}
    ticks = len(columns[keys[0]])
    shown = (
        {key: column[number % ticks] for key, column in columns.items()}
        for number in range(_WARM_UP + ticks)
    )
    wall_ms, cpu_ms = [], []
    began, worked = time.perf_counter(), time.thread_time()
    for _ in steps_of(session, shown, keys):
        cpu_ms.append(1000.0 * (time.thread_time() - worked))
        wall_ms.append(1000.0 * (time.perf_counter() - began))
        began, worked = time.perf_counter(), time.thread_time()
    return {"wall_ms": wall_ms[_WARM_UP:], "cpu_ms": cpu_ms[_WARM_UP:], "peak_mb": _peak_mb()}


def _peak_mb() -> float:
    """The most memory that this process ever held, MB, where the system tells it (Linux), else 0."""
    status = Path("/proc/self/status")
    found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text()) if status.is_file() else None
    return int(found[1]) / 1000.0 if found else 0.0


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_measure(sys.argv[1], sys.argv[2], sys.argv[3].split(","))) + "\n")
