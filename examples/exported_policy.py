"""Drives with an exported policy from camera frames: NumPy and ONNX Runtime, no wcsim.

    wcsim export runs/mine --onnx exported
    python examples/exported_policy.py exported              # drives the recorded reference steps again
    python examples/exported_policy.py exported ride.npz     # or another ride, with the same columns

The folder's meaning.json says what each input is, and what the guard trusts. The model's values follow its rule: the
action nearest to the user's stick that is safe enough has the highest one.
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
    """Nothing that is not sure drives the chair; `stick` is the command to send."""

    def __init__(self, rule: dict[str, float]) -> None:
        self.rule, self.stick, self.good, self.tripped = rule, (0.0, 0.0), 0, False

    def step(self, wanted: tuple[float, float] | None, finite: bool, age_s: float, took_s: float) -> bool:
        """Take the policy's command, None for none; whether the tick was good."""
        rule = self.rule
        sure = wanted is not None and finite and age_s <= rule["oldest_s"] and took_s <= rule["deadline_s"]
        self.good = self.good + 1 if sure else 0
        self.tripped = not sure or (self.tripped and self.good < rule["good_ticks"])
        if self.tripped:
            travel, length = math.sqrt(2.0) * rule["tick_s"] / rule["stop_s"], max(math.hypot(*self.stick), 1e-9)
            share = max(0.0, 1.0 - travel / length)  # nothing is sure: come to rest within stop_s
            wanted = self.stick[0] * share, self.stick[1] * share
        self.stick = wanted or (0.0, 0.0)
        return sure


class Driver:
    """One chair; `reset` at the start of a drive, then `step` once a tick."""

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self.session = onnxruntime.InferenceSession(str(folder / "policy.onnx"), providers=["CPUExecutionProvider"])
        self.meaning, self.clock = json.loads((folder / "meaning.json").read_text()), clock
        self.names = [output.name for output in self.session.get_outputs()]
        self.reset()

    def reset(self) -> None:
        """Begin a drive."""
        self.guard, self.warning = Guard(self.meaning["guard"]), False
        self.forget()

    def forget(self) -> None:
        """Know nothing of the street."""
        self.states = {name: np.zeros(shape, np.float32) for name, shape in self.meaning["states"].items()}

    def step(self, frames: dict[str, np.ndarray] | None, age_s: float = 0.0) -> tuple[float, float]:
        """The stick (x right, y ahead) for frames {"depth", "seg", "imu", "odometry", "joystick"}, None for none."""
        began_s, wanted, finite = self.clock(), None, True
        if frames and age_s <= self.guard.rule["oldest_s"] and all(np.isfinite(each).all() for each in frames.values()):
            if self.guard.tripped:  # it hears of no wish until it drives again
                frames = {**frames, "joystick": np.zeros(2, np.float32)}
            given = {key: np.asarray(frame)[None] for key, frame in frames.items()}
            told = dict(zip(self.names, self.session.run(None, {**given, **self.states}), strict=True))
            finite = all(np.isfinite(value).all() for value in told.values())
            self.states = {name: told[f"next_{name}"] for name in self.states}
            self.warning = bool(told["warning"][0, 0] > 0.5)
            wanted = tuple(self.meaning["actions_xy"][int(told["values"][0].argmax())])
        if not self.guard.step(wanted, finite, age_s, self.clock() - began_s):
            self.warning = False
            self.forget()
        return self.guard.stick


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    ride = np.load(sys.argv[2] if len(sys.argv) > 2 else folder / "reference.npz")
    driver = Driver(folder, clock=lambda: 0.0)  # a recorded ride waits for nobody
    keys = ("depth", "seg", "imu", "odometry", "joystick")
    driven = [driver.step({key: ride[key][tick] for key in keys}) for tick in range(len(ride["action"]))]
    same = np.all(np.array(driven) == np.array(driver.meaning["actions_xy"])[ride["action"]], axis=1)
    sys.stdout.write(f"{same.sum()} of {len(same)} steps as recorded\n")
    sys.exit(0 if same.all() else 1)
