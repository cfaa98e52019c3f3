"""Drives with an exported policy from camera frames: NumPy and ONNX Runtime, no wcsim.

    wcsim export runs/mine --onnx exported
    python examples/exported_policy.py exported

The folder's meaning.json says what each input is. Run as above, it drives the recorded reference steps again.
"""

import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime

RAMP, OLDEST_S = 0.2, 0.3  # stick travel a tick when nothing is known, and how old a frame may be


class Driver:
    """One chair; `reset` at the start of a drive, then `step` once a tick."""

    def __init__(self, folder: Path) -> None:
        self.session = onnxruntime.InferenceSession(str(folder / "policy.onnx"), providers=["CPUExecutionProvider"])
        meaning = json.loads((folder / "meaning.json").read_text())
        self.names = [output.name for output in self.session.get_outputs()]
        self.points, self.shapes = np.array(meaning["actions_xy"]), meaning["states"]
        self.reset()

    def reset(self) -> None:
        """Begin a drive."""
        self.states = {name: np.zeros(shape, np.float32) for name, shape in self.shapes.items()}
        self.stick, self.warning = np.zeros(2), False

    def step(self, frames: dict[str, np.ndarray], age_s: float = 0.0) -> np.ndarray:
        """The stick (x right, y ahead) for frames {"depth", "seg", "imu", "odometry", "joystick"}, age in seconds."""
        given = {key: np.asarray(frame)[None] for key, frame in frames.items()}
        told = dict(zip(self.names, self.session.run(None, {**given, **self.states}), strict=True))
        if age_s > OLDEST_S or not all(np.isfinite(value).all() for value in told.values()):
            length = max(np.hypot(*self.stick), 1e-9)
            self.stick = self.stick * max(0.0, 1.0 - RAMP / length)  # nothing is sure: come to rest
            return self.stick
        self.states = {name: told[f"next_{name}"] for name in self.states}
        self.warning = bool(told["warning"][0, 0] > 0.5)
        self.stick = self.points[int(told["values"][0].argmax())]
        return self.stick


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    steps, driver = np.load(folder / "reference.npz"), Driver(folder)
    keys = ("depth", "seg", "imu", "odometry", "joystick")
    driven = [driver.step({key: steps[key][tick] for key in keys}) for tick in range(len(steps["action"]))]
    same = np.all(np.array(driven) == driver.points[steps["action"]], axis=1)
    sys.stdout.write(f"{same.sum()} of {len(same)} steps as recorded\n")
    sys.exit(0 if same.all() else 1)
