"""Exports a trained policy for programs without wcsim: an ONNX model, its meaning, and examples."""

import json
import math
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

import wcsim
from wcsim.agents.envs.episode_view import FrameStacker, trim_frame_window
from wcsim.agents.export.export_folder import (
    LOOP,
    REFERENCE,
    find_differing_settings,
    format_setting_overrides,
)
from wcsim.agents.export.footprint import (
    PERIOD_S,
    SHARE,
    OnnxModelCost,
    measure_onnx_model_cost,
    run_onnx_steps,
)
from wcsim.agents.export.guard import MEANING
from wcsim.agents.export.policy_graphs import DangerPolicyGraph, ValuePolicyGraph
from wcsim.agents.networks.onnx_form import network_to_onnx
from wcsim.agents.perception.alarm import CALM, TWO_TICKS
from wcsim.agents.policies.onnx_policy import ABOUT_FILE, open_onnx_session
from wcsim.agents.policy_api import (
    CLASS_KEY,
    DEPTH_KEY,
    IMU_KEY,
    JOYSTICK_KEY,
    MODEL_FILE,
    Observation,
    Policy,
    sense_settings,
    senses_of,
)
from wcsim.agents.runs.policy_file import CAMERA_KEYS
from wcsim.config import RunConfig, resolve
from wcsim.config.run_file import PolicyGuardSettings
from wcsim.core import files
from wcsim.core.reading import JsonObject, escape, is_file
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.supervisor.observation import count_imu_values
from wcsim.types import F32, ClassId

_PRESET: Final = "quick"  # of policy.toml
# Largest difference between the model and the network it was made of, as a share of the largest
# danger or value. Two cells have a border: there a place may be read in the other cell.
MOST_OFF: Final = 1e-4
BORDER_OFF: Final = 0.05
# Least share of actions as wcsim's own policy chooses them: after one border others follow.
LEAST_SAME: Final = 0.95
Graph = DangerPolicyGraph | ValuePolicyGraph

# The texts of meaning.json.
_NOT_FOR: Final = (
    "this says nothing about a real street or a real chair: it was trained and tested in a "
    "simulation, and no person has driven with it"
)
_INPUTS: Final = {
    DEPTH_KEY: "uint8 (1, 1, H, W): 0 not measured, else 1 + 254 log(d / 0.1 m) / log(range / 0.1 "
    "m), rounded to the nearest, d along the optical axis, at least 0.1 m and at most the range; "
    "a pixel is what lies in the direction of its middle (of a larger picture: the nearest pixel, "
    "no mean)",
    CLASS_KEY: "uint8 (1, 1, H, W): the numbers of `classes` (Cityscapes labelIds; where 34 to 36 "
    "are not among them, kerbs are sidewalk and crosswalks road), at the pixels of depth",
    JOYSTICK_KEY: "float32 (1, 2): the user's stick, x right, y ahead, in -1..1",
}
_FORCE_AND_TILT: Final = (
    "each within -1..1: mean specific force x, y, z of the tick / 40 m/s2 (at rest z is +0.245), "
    "roll / pi (right side down is positive), pitch / (pi / 2) (nose up is positive)"
)
_TURNS: Final = ", turn rates about x, y, z / 4 rad/s (right-handed)"
_HEADING: Final = ", sine and cosine of the heading"
_WHEN: Final = (
    "all inputs describe the end of a tick; one tick every tick_s. Use each picture once: a tick "
    "without a new picture has no frame (see the guard)"
)
_RESET: Final = (
    "set every state to zero at the start, and whenever the chair did not execute the output of "
    "this model (an emergency stop, an attendant) or was carried; the output next_state_X goes "
    "into state_X at the next tick"
)
_OUTPUTS: Final = {
    "values": "float32 (1, A): the action is that of the highest value",
    "warning": "float32 (1, 1): above 0.5 the user should be warned",
    "danger": "float32 (1, A) in 0..1: the danger of each action",
}
_VALUES: Final = (
    "the reward that the network expects from an action on, reward_scale times the sum of "
    "discount^n times the reward of the nth tick (of head=residual the reward for the distance of "
    "sticks is that of the action alone); compare values of one tick, they are no probabilities "
    "and no dangers"
)
_WARNING: Final = (
    "already in `warning`: with level = the mean of its last value and of 1 where the action "
    "nearest to the user's stick is worth less than the best one by more than tolerated_loss, else "
    f"0: it warns above {TWO_TICKS:g}, and then until level is at most {CALM * TWO_TICKS:g}; "
    "state_alarm holds level and warning"
)
_RULE: Final = (
    "already in `values`: the user's own action until the odds of its danger are 12 times those "
    "of the threshold for two ticks, or its danger at_once; then the nearest action below the "
    "threshold, until the own one is below half of that or state_recent has run out: each is "
    "farther by danger_cost times its danger over the threshold, the last one nearer by hysteresis "
    "and allowed up to hysteresis_factor times the threshold; it warns above warn"
)
_SENSES: Final = (
    "settings in training, in wcsim's words. Of imu: mean_gravity is about the specific force of "
    "`inputs` (included: at rest z is 9.81 m/s2), tilt says what its roll and pitch are made of; "
    "lowpass_hz, accel_window and gravity are about the shocks by which wcsim judges a drive, "
    "which are no input; the rest are the sensor's place, range and errors"
)
_GUARD: Final = (
    "a tick is bad without frames, with an input or output that is not finite, a frame older than "
    "oldest_s, or an answer later than deadline_s, and when the model fails: then all states are "
    "reset, and the stick goes to zero within stop_s, by sqrt(2) * tick_s / stop_s per tick; the "
    "policy drives again after good_ticks good ticks with a joystick at rest as its input"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportMeasurements:
    """What was measured of an export on this machine, on one core."""

    steps: int
    interventions: int  # steps whose action is not the user's own
    warnings: int  # steps with a warning
    most_off: float  # of the largest danger or value, over all reference steps but those at borders
    border_steps: int  # in which a place on the border of two cells was read in the other
    border_off: float  # of the largest danger, in these
    same_actions: float  # share of the steps
    same_as_wcsim: float  # share of the steps that the policy of wcsim itself chooses
    same_as_recorded: float | None = None  # share of a recording's actions that are these
    cost: OnnxModelCost
    bytes: int
    quota_share: float = SHARE
    quota_period_s: float = PERIOD_S
    quota_by: str = "SIGSTOP and SIGCONT"


def export_policy(
    graph: Graph,
    own: Policy,
    out: Path,
    config: RunConfig,
    ride: Sequence[Observation],
    limit_ms: float = math.inf,
    recorded: Sequence[int] | None = None,
) -> ExportMeasurements:
    """Write an ONNX folder that `wcsim test` takes as a policy, all of it or nothing.

    Args:
        graph: The policy as a graph, see `agents/opening/learner_registry.py`.
        own: The policy as wcsim drives with it.
        out: To make.
        config: Of its run.
        ride: Observations of successive ticks of one episode, for the reference steps.
        limit_ms: For a decision, 99 of 100 times.
        recorded: Actions of the ride's recording, by any driver, to compare with.

    Raises:
        PolicyError: The network cannot be exported, the model differs from it or is too slow, or
            ONNX is not installed.
        DiskFullError: There is no room.
    """
    # One picture is too little work for two threads, as in `agents/opening/named_policy.py`.
    torch.set_num_threads(1)
    # 1. Let the policy drive the ride.
    graph.train(False)
    config = resolve(config, sense_settings(config, senses_of(own)))
    ride = [trim_frame_window(seen, 1) for seen in ride]
    window = FrameStacker(graph.window)
    own.begin()
    own.reset()
    chosen = [own.act(window.add(dict(seen))) for seen in ride]
    # 2. Trace the graph.
    shapes = graph.shapes()
    inputs = tuple(torch.as_tensor(ride[0][key])[None] for key in graph.inputs)
    states = tuple(torch.zeros(shape) for shape in shapes.values())
    outputs = (*graph.outputs, *(f"next_{name}" for name in shapes))
    model = network_to_onnx(graph, (*inputs, *states), (*graph.inputs, *shapes), outputs)
    # 3. Write the folder; what is wrong with the model leaves no folder behind.
    with files.write_folder_atomically(out) as target:
        (target / MODEL_FILE).write_bytes(model)
        facts = _write_reference(
            target, graph, ride, chosen, action_set(config.env.actions), recorded
        )
        if facts.cost.p99_ms > limit_ms:
            raise PolicyError(
                f"a decision takes {facts.cost.p99_ms:.0f} ms (99th percentile); expected at most "
                f"{limit_ms:g} ms: export it anyway with --force"
            )
        (target / ABOUT_FILE).write_text(_about(config), encoding="utf-8")
        shutil.copyfile(_loop_source(), target / LOOP)
        measured = {"sha256": files.sha256_from_file(target / MODEL_FILE), "facts": asdict(facts)}
        files.write_json(target / MEANING, {**_meaning_of(graph, config), **measured})
    return facts


def _write_reference(
    target: Path,
    graph: Graph,
    ride: Sequence[Observation],
    chosen: Sequence[int],
    points: ActionSet,
    recorded: Sequence[int] | None,
) -> ExportMeasurements:
    """Write the reference steps beside a model, compare it with graph and wcsim, measure it.

    Raises:
        PolicyError: It differs by too much.
    """
    model = target / MODEL_FILE
    # 1. The graph in torch, with the states before each step.
    expected, graph_actions, states_before = [], [], []
    checked = graph.outputs.index(graph.checked)
    states = [torch.zeros(shape) for shape in graph.shapes().values()]
    with torch.inference_mode():
        for seen in ride:
            states_before.append([state.numpy() for state in states])
            out = graph(*(torch.as_tensor(seen[key])[None] for key in graph.inputs), *states)
            states = list(out[len(graph.outputs) :])
            expected.append(out[checked][0].numpy())
            graph_actions.append(int(out[0].argmax()))
    actions = np.array(graph_actions)
    # 2. The model, each step from the graph's states: so that no difference adds up.
    stepwise = _run_model(model, ride, graph.inputs, states_before)
    off = _require_equal(stepwise[graph.checked], np.stack(expected), graph)
    at_border = off > MOST_OFF
    # 3. The model by itself. Its actions are the reference, whoever drove a recording: a program
    # that runs the model again can have no others.
    outputs = _run_model(model, ride, graph.inputs)
    inputs = {key: np.stack([seen[key] for seen in ride]) for key in graph.inputs}
    reference: dict[str, Any] = {
        **inputs,
        graph.checked: outputs[graph.checked],
        "action": actions,
    }
    np.savez_compressed(target / REFERENCE, **reference)
    model_actions = outputs["values"].argmax(axis=1)
    same = model_actions == np.array(chosen)
    if np.mean(same) < LEAST_SAME:
        raise PolicyError(
            f"the exported model chooses the action of wcsim's policy in {np.mean(same):.1%} of "
            f"the steps (first difference: step {int(np.argmin(same))}); expected at least "
            f"{LEAST_SAME:.0%}: this is a bug of the export, please report it; nothing was written"
        )
    # 4. What it costs.
    own = points.nearest_many(inputs["joystick"])
    return ExportMeasurements(
        steps=len(ride),
        interventions=int(np.sum(own != actions)),
        warnings=int(np.sum(outputs["warning"] > 0.5)),
        most_off=float(off[~at_border].max(initial=0.0)),
        border_steps=int(at_border.sum()),
        border_off=float(off.max()),
        same_actions=float(np.mean(model_actions == actions)),
        same_as_wcsim=float(np.mean(same)),
        same_as_recorded=None
        if recorded is None
        else float(np.mean(actions == np.array(recorded))),
        cost=measure_onnx_model_cost(model, target / REFERENCE, graph.inputs),
        bytes=model.stat().st_size,
    )


def _run_model(
    path: Path,
    ride: Sequence[Observation],
    keys: Sequence[str],
    states_before: Sequence[Sequence[F32]] | None = None,
) -> dict[str, Any]:
    """Outputs of a model by name, stacked over the steps of a ride; see `run_onnx_steps`."""
    columns: dict[str, list[Any]] = {}
    for outputs in run_onnx_steps(open_onnx_session(path), ride, keys, states_before):
        for name, values in outputs.items():
            if not name.startswith("next_"):
                columns.setdefault(name, []).append(values[0])
    return {name: np.stack(values) for name, values in columns.items()}


def _require_equal(found: F32, expected: F32, graph: Graph) -> F32:
    """How far the worst number of each step is off, (steps,), as a share of the largest number.

    Two libraries round the last bit of a cell's place in different ways. On the border of two cells
    one reads this cell and the other that one, whose content may differ a little.

    Raises:
        PolicyError: They differ by more than borders explain.
    """
    off: F32 = np.abs(found - expected).max(axis=1) / max(float(np.abs(expected).max()), 1e-9)
    share, worst = float(np.mean(off > MOST_OFF)), int(off.argmax())
    if share > graph.border_share or off[worst] > BORDER_OFF:
        raise PolicyError(
            f"the exported model's {graph.checked} differ by up to {off[worst]:.2g} of the "
            f"largest (step {worst}), and by more than {MOST_OFF:g} in {share:.1%} of the steps; "
            f"expected at most {BORDER_OFF:g}, and {graph.border_share:.0%}: in a network of your "
            "own, compute the same for whatever it is shown, without `if`; in one of wcsim this "
            "is a bug of the export, please report it; nothing was written"
        )
    return off


def _about(config: RunConfig) -> str:
    """policy.toml: the settings with which `wcsim test` shows the model what it was trained on."""
    eyes = config.eyes.values()
    cameras = [{key: getattr(eye, key) for key in ("name", *CAMERA_KEYS)} for eye in eyes]
    seen = (
        f"cameras={json.dumps(cameras, separators=(', ', ' = '))}",
        *format_setting_overrides([("env.camera", [eye.name for eye in eyes])]),
    )
    usual = resolve(_PRESET, seen)
    # A value of None is that of the plant, which brings its own.
    more = [(f"chair.{key}", value) for key, value in config.chair if value is not None]
    if config.imu.tilt != usual.imu.tilt:
        more.append(("imu.tilt", config.imu.tilt))
    more.append(("world.action_delay_ticks", config.world.action_delay_ticks))
    settings = dict.fromkeys(
        (
            *seen,
            *find_differing_settings(config, usual),
            *format_setting_overrides(more),
        )
    )
    lines = ",\n  ".join(json.dumps(setting) for setting in settings)
    return f'preset = "{_PRESET}"\nsettings = [\n  {lines},\n]\n'


def _loop_source() -> Path:
    """The loop in NumPy that drives an exported policy, in a wheel or in a checkout.

    Raises:
        PolicyError: It is in neither.
    """
    package = Path(wcsim.__file__).parent
    # A wheel holds it within the package, a checkout beside it.
    for place in (package, package.parent):
        if is_file(place / "examples" / LOOP):
            return place / "examples" / LOOP
    raise PolicyError(
        f"wcsim has no examples/{LOOP}; expected one in {escape(package)} or beside it: install "
        "it again"
    )


def _meaning_of(graph: Graph, config: RunConfig) -> JsonObject:
    """meaning.json: units, scales, signs, classes, camera, chair and guard, as JSON values."""
    folded = config.env.classes == "cityscapes"
    senses = {
        key: section.model_dump(mode="json")
        for key, section in config.sensors.on().items()
        if key in graph.inputs
    }
    values: JsonObject
    if isinstance(graph, DangerPolicyGraph):
        values = {"rule": graph.rule.model_dump(), "rule_meaning": _RULE}
    else:
        scale = graph.net.spec.prior.reward_scale
        values = {
            "values_meaning": _VALUES,
            "reward_scale": scale,
            "discount": config.learn.gamma,
            "tolerated_loss": graph.tolerated_loss,
            "warning_meaning": _WARNING,
        }
    return {
        "not_for": _NOT_FOR,
        "inputs": {key: _input_text(key, config) for key in graph.inputs},
        "when": _WHEN,
        "states": {name: list(shape) for name, shape in graph.shapes().items()},
        "reset": _RESET,
        "outputs": {key: _OUTPUTS[key] for key in graph.outputs},
        "actions_xy": action_set(config.env.actions).points.tolist(),
        **values,
        "classes": {
            kind.name.lower(): int(kind) for kind in ClassId if kind < ClassId.KERB or not folded
        },
        "cameras": [eye.model_dump(mode="json") for eye in config.eyes.values()],
        "senses": {"imu": config.imu.model_dump(mode="json"), **senses},
        "senses_meaning": _SENSES,
        "chair": config.chair.model_dump(mode="json"),
        "tick_s": config.world.tick_s,
        "action_delay_ticks": config.world.action_delay_ticks,
        "guard": PolicyGuardSettings(
            tick_s=config.world.tick_s, deadline_s=config.world.tick_s
        ).model_dump(),
        "guard_meaning": _GUARD,
    }


def _input_text(key: str, config: RunConfig) -> str:
    """Type, shape, unit and signs of an input."""
    if key == IMU_KEY:
        more = _TURNS * config.env.observe_gyro + _HEADING * config.env.observe_yaw
        size = count_imu_values(config.env.observe_gyro, config.env.observe_yaw)
        axes = "x ahead, y left, z up, of the chair; see `senses`"
        return f"float32 (1, {size}), {_FORCE_AND_TILT}{more}; {axes}"
    # Keys of further cameras begin with their names.
    if (usual := key.rpartition("_")[2]) in _INPUTS:
        return _INPUTS[usual]
    measure = config.sensors.measures()[key]
    parts = ", ".join(
        f"{part} / {scale:g}" for part, scale in zip(measure.parts, measure.full_scale, strict=True)
    )
    size = len(measure.parts)
    means = f"{parts}, means of the tick; to the left is positive"
    return f"float32 (1, {size}), each within -1..1: {means}"
