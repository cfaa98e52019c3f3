"""What a step of an exported model costs: time on a whole core and on a share of it, and memory.

The measurement runs as a program of its own (`python footprint.py MODEL REFERENCE KEYS`) with NumPy
and ONNX Runtime alone, so its memory is that of a chair's computer. The share of a core comes from
stopping and continuing the process (SIGSTOP, SIGCONT), as machines without control groups have no
quota; an answer takes as long either way.
"""

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
PERIOD_S: Final = 0.01  # the process runs for its share of each period, and is stopped for the rest
_TIMEOUT_S: Final = 300.0
_PROGRAM: Final = __file__
_WARM_UP: Final = 10  # steps that are not measured
Arrays = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class OnnxModelCost:
    """Of one model, on this machine."""

    p50_ms: float  # of a step, one thread
    p99_ms: float
    cpu_p50_ms: float  # processor time: other processes of the machine count for less
    quota_p50_ms: float  # with SHARE of a core
    quota_p99_ms: float
    peak_mb: float  # of the process, ONNX Runtime and Python with it


def measure_onnx_model_cost(model: Path, reference: Path, keys: Sequence[str]) -> OnnxModelCost:
    """Measure a model over its reference steps. Raises PolicyError when it does not run."""
    whole = _measure_apart(model, reference, keys, 1.0)
    part = _measure_apart(model, reference, keys, SHARE)
    return OnnxModelCost(
        p50_ms=float(np.median(whole["wall_ms"])),
        p99_ms=float(np.percentile(whole["wall_ms"], 99)),
        cpu_p50_ms=float(np.median(whole["cpu_ms"])),
        quota_p50_ms=float(np.median(part["wall_ms"])),
        quota_p99_ms=float(np.percentile(part["wall_ms"], 99)),
        peak_mb=float(whole["peak_mb"]),
    )


def run_onnx_steps(
    session: Any,
    observations: Iterable[Arrays],
    keys: Sequence[str],
    states_before: Sequence[Sequence[Any]] | None = None,
) -> Iterator[dict[str, Any]]:
    """Run a model step by step, and yield its outputs by name.

    Args:
        session: Of ONNX Runtime.
        observations: Of successive steps.
        keys: Of its inputs.
        states_before: The states that each step starts with. Without them a run starts with zeros,
            and goes on with the states that the model itself returns.
    """
    names = [item.name for item in session.get_outputs()]
    states = {
        item.name: np.zeros(item.shape, np.float32)
        for item in session.get_inputs()
        if item.name not in keys
    }
    for step, observation in enumerate(observations):
        if states_before is not None:
            states = dict(zip(states, states_before[step], strict=True))
        inputs = {key: np.ascontiguousarray(observation[key])[None] for key in keys}
        outputs = dict(zip(names, session.run(None, {**inputs, **states}), strict=True))
        states = {name: outputs[f"next_{name}"] for name in states}
        yield outputs


def _measure_apart(
    model: Path, reference: Path, keys: Sequence[str], share: float
) -> dict[str, Any]:
    """Run `_measure` as a program of its own, on a share of a core."""
    words = [sys.executable, _PROGRAM, str(model), str(reference), ",".join(keys)]
    try:
        run = run_command(words, _TIMEOUT_S, on_start=lambda process: _throttle(process, share))
    except subprocess.TimeoutExpired:
        raise PolicyError(
            f"{model}: no answer within {_TIMEOUT_S:g} s; expected its reference steps"
        ) from None
    if run.returncode:
        last = run.stderr.strip().splitlines()[-1:] or ["no word"]
        raise PolicyError(
            f"{model} cannot be run by itself: {last[0][:200]}; expected ONNX Runtime to take it"
        )
    found: dict[str, Any] = json.loads(run.stdout)
    return found


def _throttle(process: subprocess.Popen[bytes], share: float) -> None:
    """Let a process run for its share of each period, until it ends; a whole core is no limit."""
    if share == 1.0:
        return
    until_s = time.monotonic() + _TIMEOUT_S
    while process.poll() is None and time.monotonic() < until_s:
        time.sleep(share * PERIOD_S)
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGSTOP)
            time.sleep((1.0 - share) * PERIOD_S)
            process.send_signal(signal.SIGCONT)


def _measure(model: str, reference: str, keys: Sequence[str]) -> dict[str, Any]:
    """Wall and processor time of every step, ms; peak memory of this process, MB, 0 off Linux."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    with np.load(reference, allow_pickle=False) as arrays:
        columns = {key: arrays[key] for key in keys}
    ticks = len(columns[keys[0]])
    observations = (
        {key: column[number % ticks] for key, column in columns.items()}
        for number in range(_WARM_UP + ticks)
    )
    wall_ms, cpu_ms = [], []
    start_s, start_cpu_s = time.perf_counter(), time.thread_time()
    for _ in run_onnx_steps(session, observations, keys):
        cpu_ms.append(1000.0 * (time.thread_time() - start_cpu_s))
        wall_ms.append(1000.0 * (time.perf_counter() - start_s))
        start_s, start_cpu_s = time.perf_counter(), time.thread_time()
    status = Path("/proc/self/status")
    peak = re.search(r"VmHWM:\s+(\d+) kB", status.read_text()) if status.is_file() else None
    return {
        "wall_ms": wall_ms[_WARM_UP:],
        "cpu_ms": cpu_ms[_WARM_UP:],
        "peak_mb": int(peak[1]) / 1000.0 if peak else 0.0,
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_measure(sys.argv[1], sys.argv[2], sys.argv[3].split(","))) + "\n")
