"""Drives with an exported policy from camera frames: NumPy and ONNX Runtime, no wcsim.

    wcsim export runs/mine --onnx exported          # copies this file into the folder
    python exported/exported_policy.py              # drives the reference steps again and compares
    python exported_policy.py exported              # the same for another folder
    python exported_policy.py exported ride.npz     # prints the sticks for a ride with the same inputs

The folder's meaning.json describes each input and the limits of the guard. The action of the highest value is taken.
A port that sees nothing mostly follows the stick, and many of its actions match the recording. So compare the dangers,
or without them the values, too.
"""

import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime


class Guard:
    """Stops the chair when the output cannot be trusted; `stick` is the command to send."""

    def __init__(self, rule: dict[str, float]) -> None:
        self.rule, self.stick, self.good, self.tripped = rule, (0.0, 0.0), 0, False

    def step(self, wanted: tuple[float, float] | None, finite: bool, age_s: float, took_s: float) -> bool:
        """Take the policy's command, or None; returns whether the tick was good."""
        rule = self.rule
        sure = wanted is not None and finite and age_s <= rule["oldest_s"] and took_s <= rule["deadline_s"]
        self.good = self.good + 1 if sure else 0
        self.tripped = not sure or (self.tripped and self.good < rule["good_ticks"])
        if self.tripped:
            travel, length = math.sqrt(2.0) * rule["tick_s"] / rule["stop_s"], max(math.hypot(*self.stick), 1e-9)
            share = max(0.0, 1.0 - travel / length)  # come to rest within stop_s
            wanted = self.stick[0] * share, self.stick[1] * share
        self.stick = wanted or (0.0, 0.0)
        return sure


class Driver:
    """One chair; `reset` at the start of a drive, then `step` once a tick."""

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        (model,) = [folder / name for name in ("policy.onnx", "model.onnx") if (folder / name).exists()]
        self.session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
        self.meaning, self.clock = json.loads((folder / "meaning.json").read_text()), clock
        self.names = [output.name for output in self.session.get_outputs()]
        self.reset()

    def reset(self) -> None:
        """Begin a drive."""
        self.guard, self.warning = Guard(self.meaning["guard"]), False
        self.told = {}  # the model's outputs of the last good tick
        self.forget()

    def forget(self) -> None:
        """Clear the map and all other states."""
        self.states = {name: np.zeros(shape, np.float32) for name, shape in self.meaning["states"].items()}

    def asked(self, frames: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The model's outputs for frames; {} if an input is not finite."""
        if not all(np.isfinite(each).all() for each in frames.values()):
            return {}
        if self.guard.tripped:  # the user's stick is hidden until the policy drives again
            frames = {**frames, "joystick": np.zeros(2, np.float32)}
        given = {key: np.asarray(frame)[None] for key, frame in frames.items()}
        return dict(zip(self.names, self.session.run(None, {**given, **self.states}), strict=True))

    def step(self, frames: dict[str, np.ndarray] | None, age_s: float = 0.0) -> tuple[float, float]:
        """The stick (x right, y ahead) for frames with the inputs of meaning.json, or None."""
        began_s, wanted, told = self.clock(), None, {}
        if frames and age_s <= self.guard.rule["oldest_s"]:
            try:
                told = self.asked(frames)
            except Exception:  # any error makes the tick bad
                told = {}
        finite = bool(told) and all(np.isfinite(value).all() for value in told.values())
        if finite:
            self.states = {name: told[f"next_{name}"] for name in self.states}
            self.told, self.warning = told, "warning" in told and told["warning"][0, 0] > 0.5
            wanted = tuple(self.meaning["actions_xy"][int(told["values"][0].argmax())])
        sure = self.guard.step(wanted, finite, age_s, self.clock() - began_s)
        if not sure or self.guard.stick != wanted:  # its states assume that its own command was sent
            self.forget()
        self.warning = self.warning and sure
        return self.guard.stick


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    ride = dict(np.load(sys.argv[2] if len(sys.argv) > 2 else folder / "reference.npz"))
    driver = Driver(folder, clock=lambda: 0.0)  # a recorded ride has no deadline
    key = "danger" if "danger" in ride else "values"
    driven, close = [], []
    for tick in range(len(ride["joystick"])):
        driven.append(driver.step({name: ride[name][tick] for name in driver.meaning["inputs"]}))
        if "action" in ride:
            off = np.abs(driver.told.get(key, [np.inf])[0] - ride[key][tick]).max()
            close.append(off < 1e-3 * np.abs(ride[key]).max())  # at borders of map cells, another one may be read
        else:
            sys.stdout.write(f"{tick} {driven[-1][0]:.3f} {driven[-1][1]:.3f} {int(driver.warning)}\n")
    if "action" in ride:
        points = np.array(driver.meaning["actions_xy"])
        same = np.all(np.array(driven) == points[ride["action"]], axis=1)
        own = np.linalg.norm(points[None] - ride["joystick"][:, None], axis=2).argmin(axis=1)
        never = "" if "warning" in driver.names else "; it never warns"
        sys.stdout.write(
            f"{same.sum()} of {len(same)} actions as recorded, {np.sum(own != ride['action'])} of them "
            f"interventions; {key} as recorded in {np.mean(close):.0%} of the steps{never}\n"
        )
        sys.exit(0 if same.mean() >= 0.98 and np.mean(close) >= 0.98 else 1)
