"""What somebody without wcsim must know to run an exported model: the folder's meaning.json."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from wcsim.agents.danger.export.onnx_graph import DangerGraph
from wcsim.agents.danger.guard import GuardRule
from wcsim.agents.danger.rule import RIVAL_KEYS
from wcsim.agents.runs.policy_file import read_danger_file
from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set
from wcsim.types import ClassId

_NOT_FOR: Final = (
    "this says nothing about a real street or a real chair: it was trained and tested in a simulation, and no person "
    "has driven with it"
)
_INPUTS: Final = {
    "depth": "uint8 (1, 1, H, W): 0 not measured, else 1 + 254 log(d / 0.1 m) / log(range / 0.1 m), rounded to the "
    "nearest, d along the optical axis, at least 0.1 m and at most the range; a pixel is what lies in the direction of "
    "its middle (of a larger picture: the nearest pixel, no mean)",
    "seg": "uint8 (1, 1, H, W): the numbers of `classes` (Cityscapes labelIds; where 34 to 36 are not among them, "
    "kerbs are sidewalk and crosswalks road), at the pixels of depth",
    "imu": "float32 (1, 8), each within -1..1: mean specific force x, y, z of the tick / 40 m/s2 (at rest z is "
    "+0.245), roll / pi (right side down is positive), pitch / (pi / 2) (nose up is positive), turn rates about x, y, "
    "z / 4 rad/s (right-handed); x ahead, y left, z up, of the chair; see `senses`",
    "odometry": "float32 (1, 2), each within -1..1: mean speed of the tick / 4 m/s, turn rate / 4 rad/s, to the left "
    "is positive",
    "joystick": "float32 (1, 2): the user's stick, x right, y ahead, in -1..1",
}
_WHEN: Final = (
    "all inputs describe the end of a tick; one tick every tick_s. Use each picture once: a tick without a new picture "
    "has no frame (see the guard)"
)
_RESET: Final = (
    "set every state to zero at the start, and whenever the chair did not execute the output of this model (an "
    "emergency stop, an attendant) or was carried; the output next_state_X goes into state_X at the next tick"
)
_OUTPUTS: Final = {
    "values": "float32 (1, A): the action is that of the highest value",
    "warning": "float32 (1, 1): above 0.5 the user should be warned",
    "danger": "float32 (1, A) in 0..1: the danger of each action",
}
_RULE: Final = (
    "already in `values`: the user's own action where its danger is below threshold, or below at_once and it was not "
    "above the threshold in the ticks before, which state_recent counts; else the nearest action that is below it, "
    "each farther by shy times its danger over the threshold, the last one nearer by keep and allowed up to lenient "
    "times the threshold; it warns above warn"
)
_SENSES: Final = (
    "settings in training, in wcsim's words. Of imu: mean_gravity is about the specific force of `inputs` (included: "
    "at rest z is 9.81 m/s2), tilt says what its roll and pitch are made of; lowpass_hz, accel_window and gravity are "
    "about the shocks by which wcsim judges a drive, which are no input; the rest are the sensor's place, range and "
    "errors"
)
_GUARD: Final = (
    "a tick is bad without frames, with an input or output that is not finite, a frame older than oldest_s, or an "
    "answer later than deadline_s, and when the model fails: then all states are reset, and the stick "
    "goes to zero within stop_s, by sqrt(2) * tick_s / stop_s per tick; the policy drives again after good_ticks good "
    "ticks with a joystick at rest as its input"
)


def meaning_of(policy: Path, graph: DangerGraph, config: RunConfig) -> dict[str, Any]:
    """Units, scales, signs, classes, rule, camera, chair and guard of an exported policy, as JSON values."""
    file, actions = read_danger_file(policy), action_set(config.env.actions)
    folded = config.env.classes == "cityscapes"
    return {
        "not_for": _NOT_FOR,
        "inputs": _INPUTS,
        "when": _WHEN,
        "states": {name: list(shape) for name, shape in graph.shapes().items()},
        "reset": _RESET,
        "outputs": _OUTPUTS,
        "actions_xy": actions.points.tolist(),
        "rule": {key: value for key, value in asdict(graph.rule).items() if key not in RIVAL_KEYS},
        "rule_meaning": _RULE,
        "classes": {kind.name.lower(): int(kind) for kind in ClassId if kind < ClassId.KERB or not folded},
        "camera": file.camera.model_dump(mode="json"),
        "senses": {"imu": config.imu.model_dump(mode="json"), "odometry": "typical"},
        "senses_meaning": _SENSES,
        "chair": file.chair.model_dump(mode="json"),
        "tick_s": config.world.tick_s,
        "action_delay_ticks": config.world.action_delay_ticks,
        "guard": asdict(GuardRule(tick_s=config.world.tick_s, deadline_s=config.world.tick_s)),
        "guard_meaning": _GUARD,
    }
