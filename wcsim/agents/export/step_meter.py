"""Runs an exported model over its reference steps and says what that costs: NumPy and ONNX Runtime alone.

It is started as a program of its own by `footprint.py`, so that what it holds in memory is what a chair's computer
would hold. A line of JSON comes out: wall and processor time of each step in ms, and the most memory that it ever held.
"""

from __future__ import annotations

import json
import re
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

_WARM_UP = 10


def measure(model: Path, reference: Path, keys: list[str]) -> dict[str, Any]:
    """Times of every step, and memory in MB where the system tells it (Linux), else 0."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
    with np.load(reference, allow_pickle=False) as held:
        columns = {key: held[key] for key in keys}
    names = [item.name for item in session.get_outputs()]
    states = {item.name: np.zeros(item.shape, np.float32) for item in session.get_inputs() if item.name not in keys}
    wall_ms, cpu_ms = [], []
    ticks = len(columns[keys[0]])
    for number in range(_WARM_UP + ticks):
        given = {key: column[number % ticks][None] for key, column in columns.items()}
        began, worked = time.perf_counter(), time.thread_time()
        out = dict(zip(names, session.run(None, {**given, **states}), strict=True))
        cpu_ms.append(1000.0 * (time.thread_time() - worked))
        wall_ms.append(1000.0 * (time.perf_counter() - began))
        states = {name: out[f"next_{name}"] for name in states}
    return {"wall_ms": wall_ms[_WARM_UP:], "cpu_ms": cpu_ms[_WARM_UP:], "peak_mb": peak_mb()}


def peak_mb() -> float:
    """The most memory that this process ever held, in MB."""
    status = Path("/proc/self/status")
    found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text()) if status.is_file() else None
    return int(found[1]) / 1000.0 if found else 0.0


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measure(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3].split(","))) + "\n")
