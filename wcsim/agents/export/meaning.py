"""What somebody without wcsim must know to run an exported model: the folder's meaning.json."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Final

from wcsim.agents.export.danger_graph import DangerGraph
from wcsim.agents.export.guard import GuardRule
from wcsim.agents.export.value_graph import ValueGraph
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, IMU_KEY, JOYSTICK_KEY
from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.observation import imu_size
from wcsim.types import ClassId

_NOT_FOR: Final = (
    "this says nothing about a real street or a real chair: it was trained and tested in a simulation, and no person "
    "has driven with it"
)
_INPUTS: Final = {
    DEPTH_KEY: "uint8 (1, 1, H, W): 0 not measured, else 1 + 254 log(d / 0.1 m) / log(range / 0.1 m), rounded to the "
    "nearest, d along the optical axis, at least 0.1 m and at most the range; a pixel is what lies in the direction of "
    "its middle (of a larger picture: the nearest pixel, no mean)",
    CLASS_KEY: "uint8 (1, 1, H, W): the numbers of `classes` (Cityscapes labelIds; where 34 to 36 are not among them, "
    "kerbs are sidewalk and crosswalks road), at the pixels of depth",
    JOYSTICK_KEY: "float32 (1, 2): the user's stick, x right, y ahead, in -1..1",
}
_FORCE_AND_TILT: Final = (
    "each within -1..1: mean specific force x, y, z of the tick / 40 m/s2 (at rest z is +0.245), roll / pi (right side "
    "down is positive), pitch / (pi / 2) (nose up is positive)"
)
_TURNS: Final = ", turn rates about x, y, z / 4 rad/s (right-handed)"
_HEADING: Final = ", sine and cosine of the heading"
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
_VALUES: Final = (
    "the reward that the network expects from an action on, reward_scale times the sum of discount^n times the reward "
    "of the nth tick; compare values of one tick, they are no probabilities and no dangers"
)
_RULE: Final = (
    "already in `values`: the user's own action where its danger is below threshold, or below at_once and it was not "
    "above the threshold in the ticks before, which state_recent counts; else the nearest action that is below it, "
    "each farther by danger_cost times its danger over the threshold, the last one nearer by hysteresis and allowed up "
    "to hysteresis_factor times the threshold; it warns above warn"
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


def meaning_of(graph: DangerGraph | ValueGraph, config: RunConfig) -> dict[str, Any]:
    """Units, scales, signs, classes, camera, chair and guard of an exported policy, as JSON values."""
    actions, sensors = action_set(config.env.actions), config.sensors.on()
    folded = config.env.classes == "cityscapes"
    sensed = {key: section.model_dump(mode="json") for key, section in sensors.items() if key in graph.inputs}
    return {
        "not_for": _NOT_FOR,
        "inputs": {key: _input(key, config) for key in graph.inputs},
        "when": _WHEN,
        "states": {name: list(shape) for name, shape in graph.shapes().items()},
        "reset": _RESET,
        "outputs": {key: _OUTPUTS[key] for key in graph.outputs},
        "actions_xy": actions.points.tolist(),
        **_of_kind(graph, config),
        "classes": {kind.name.lower(): int(kind) for kind in ClassId if kind < ClassId.KERB or not folded},
        "camera": config.cameras[0].model_dump(mode="json"),
        "senses": {"imu": config.imu.model_dump(mode="json"), **sensed},
        "senses_meaning": _SENSES,
        "chair": config.chair.model_dump(mode="json"),
        "tick_s": config.world.tick_s,
        "action_delay_ticks": config.world.action_delay_ticks,
        "guard": asdict(GuardRule(tick_s=config.world.tick_s, deadline_s=config.world.tick_s)),
        "guard_meaning": _GUARD,
    }


def _input(key: str, config: RunConfig) -> str:
    """What an input holds."""
    if key == IMU_KEY:
        more = _TURNS * config.env.observe_gyro + _HEADING * config.env.observe_yaw
        size = imu_size(config.env.observe_gyro, config.env.observe_yaw)
        return f"float32 (1, {size}), {_FORCE_AND_TILT}{more}; x ahead, y left, z up, of the chair; see `senses`"
    if key in _INPUTS:
        return _INPUTS[key]
    measure = config.sensors.measures()[key]
    parts = ", ".join(f"{part} / {scale:g}" for part, scale in zip(measure.parts, measure.full_scale, strict=True))
    return f"float32 (1, {len(measure.parts)}), each within -1..1: {parts}, means of the tick; to the left is positive"


def _of_kind(graph: DangerGraph | ValueGraph, config: RunConfig) -> dict[str, Any]:
    """How a danger network's dangers become an action, or what the values of Q-learning are."""
    if isinstance(graph, DangerGraph):
        return {"rule": graph.rule.model_dump(), "rule_meaning": _RULE}
    scale = graph.net.spec.prior.reward_scale
    return {"values_meaning": _VALUES, "reward_scale": scale, "discount": config.learn.gamma}
