"""Exports a trained policy for whoever has no wcsim: one ONNX model per tick, what it means, and reference steps."""

from __future__ import annotations

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
from wcsim.agents.envs.episode_view import FrameWindow, newest
from wcsim.agents.export.export_folder import LOOP, REFERENCE, as_words, settings_apart
from wcsim.agents.export.footprint import PERIOD_S, SHARE, Footprint, footprint, steps_of
from wcsim.agents.export.guard import MEANING
from wcsim.agents.export.policy_graphs import DangerGraph, ValueGraph
from wcsim.agents.networks.onnx_form import exported
from wcsim.agents.policies.onnx_policy import ABOUT_FILE, open_session
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
from wcsim.config import RunConfig, resolve
from wcsim.config.run_file import GuardRule
from wcsim.core import files
from wcsim.core.reading import escaped, is_file
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.supervisor.observation import imu_size
from wcsim.types import F32, ClassId

_PRESET: Final = "quick"  # that policy.toml begins with
MOST_OFF: Final = (
    1e-4  # of the largest danger or value, between the model and the network it was made of
)
BORDER_OFF: Final = (
    0.05  # of it, in a step in which a place on the border of two cells was read in the other
)
LEAST_SAME: Final = (
    0.95  # of the actions, as wcsim's own policy chooses: a border may lead on to others
)
Graph = DangerGraph | ValueGraph


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportFacts:
    """What was measured of an export on this machine, on one core."""

    steps: int
    interventions: int  # steps whose action is not the user's own
    warnings: int  # steps with a warning
    most_off: float  # of the largest danger or value, over all reference steps but those at borders
    border_steps: int  # in which a place on the border of two cells was read in the other
    border_off: float  # of the largest danger, in these
    same_actions: float  # share of the steps
    same_as_wcsim: float  # share of the steps that the policy of wcsim itself chooses
    same_as_recorded: float | None = (
        None  # share of a recording's actions that are these; None without a recording
    )
    cost: Footprint
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
) -> ExportFacts:
    """Write an ONNX folder that `wcsim test` takes as a policy, in one step.

    Args:
        graph: The policy as a graph, see `agents/opening/learner_registry.py`.
        own: The policy as wcsim drives with it.
        out: To make.
        config: Of its run.
        ride: Observations of successive ticks of one episode, for the reference steps.
        limit_ms: For a decision, 99 of 100 times.
        recorded: What was chosen in the ride when it was recorded, by whomever, to compare with; None for no recording.

    Raises:
        PolicyError: The network cannot be exported, the model differs from it or is too slow, or ONNX is not
            installed.
        DiskFullError: There is no room.
    """
    torch.set_num_threads(
        1
    )  # one picture is too little for two threads, as in `agents/opening/named_policy.py`
    graph.train(False)
    config = resolve(config, sense_settings(config, senses_of(own)))
    ride = [newest(seen, 1) for seen in ride]
    chosen = _chosen(own, ride, graph.window)
    shapes = graph.shapes()
    given = tuple(torch.as_tensor(ride[0][key])[None] for key in graph.inputs)
    states = tuple(torch.zeros(shape) for shape in shapes.values())
    outputs = (*graph.outputs, *(f"next_{name}" for name in shapes))
    model = exported(graph, (*given, *states), (*graph.inputs, *shapes), outputs)
    with files.whole_folder(out) as target:
        (target / MODEL_FILE).write_bytes(model)
        facts = _write_reference(
            target, graph, ride, chosen, action_set(config.env.actions), recorded
        )
        if facts.cost.p99_ms > limit_ms:
            raise PolicyError(
                f"a decision takes {facts.cost.p99_ms:.0f} ms (99th percentile); expected at most {limit_ms:g} ms: "
                "export it anyway with --force"
            )
        (target / ABOUT_FILE).write_text(_about(config), encoding="utf-8")
        shutil.copyfile(_loop_place(), target / LOOP)
        measured = {"sha256": files.sha256(target / MODEL_FILE), "facts": asdict(facts)}
        files.write_json(target / MEANING, {**_meaning_of(graph, config), **measured})
    return facts


def _loop_place() -> Path:
    """The loop in NumPy that drives an exported policy: in a wheel within the package, in a checkout beside it.

    Raises PolicyError when it is in neither.
    """
    package = Path(wcsim.__file__).parent
    for place in (package, package.parent):
        if is_file(place / "examples" / LOOP):
            return place / "examples" / LOOP
    raise PolicyError(
        f"wcsim has no examples/{LOOP}; expected one in {escaped(package)} or beside it: install it again"
    )


def _run_model(
    path: Path,
    ride: Sequence[Observation],
    keys: Sequence[str],
    before: Sequence[Sequence[F32]] | None = None,
) -> dict[str, Any]:
    """Outputs by name, stacked over the steps of a ride.

    Args:
        path: The model.
        ride: What it is shown.
        keys: Of its inputs.
        before: The states that each step begins with; None for those that the model itself told.
    """
    told: dict[str, list[Any]] = {}
    for out in steps_of(open_session(path), ride, keys, before):
        for name, values in out.items():
            if not name.startswith("next_"):
                told.setdefault(name, []).append(values[0])
    return {name: np.stack(values) for name, values in told.items()}


def _chosen(policy: Policy, ride: Sequence[Observation], window: int) -> list[int]:
    """What the policy itself does on a ride of single images."""
    held = FrameWindow(window)
    policy.begin()
    policy.reset()
    return [policy.act(held.add(dict(seen))) for seen in ride]


def _write_reference(
    target: Path,
    graph: Graph,
    ride: Sequence[Observation],
    chosen: Sequence[int],
    points: ActionSet,
    recorded: Sequence[int] | None,
) -> ExportFacts:
    wanted, actions, before = [], [], []
    at, state = (
        graph.outputs.index(graph.checked),
        [torch.zeros(shape) for shape in graph.shapes().values()],
    )
    with torch.inference_mode():
        for seen in ride:
            before.append([part.numpy() for part in state])
            out = graph(*(torch.as_tensor(seen[key])[None] for key in graph.inputs), *state)
            state = list(out[len(graph.outputs) :])
            wanted.append(out[at][0].numpy())
            actions.append(int(out[0].argmax()))
    off = _off(
        _run_model(target / MODEL_FILE, ride, graph.inputs, before)[graph.checked],
        np.stack(wanted),
        graph,
    )
    told = _run_model(target / MODEL_FILE, ride, graph.inputs)
    inputs = {key: np.stack([seen[key] for seen in ride]) for key in graph.inputs}
    # Its own actions, whoever drove a recording: whoever runs the model again can have no others.
    kept: dict[str, Any] = {
        **inputs,
        graph.checked: told[graph.checked],
        "action": np.array(actions),
    }
    np.savez_compressed(target / REFERENCE, **kept)
    own = points.nearest_many(inputs["joystick"])
    at_border = off > MOST_OFF
    same = told["values"].argmax(axis=1) == np.array(chosen)
    if np.mean(same) < LEAST_SAME:
        raise PolicyError(
            f"the exported model chooses the action of wcsim's policy in {np.mean(same):.1%} of the steps "
            f"(first difference: step {int(np.argmin(same))}); expected at least {LEAST_SAME:.0%}: this is a "
            "bug of the export, please report it; nothing was written"
        )
    return ExportFacts(
        steps=len(ride),
        interventions=int(np.sum(own != np.array(actions))),
        warnings=int(sum(np.sum(told[name] > 0.5) for name in graph.outputs if name == "warning")),
        most_off=float(off[~at_border].max(initial=0.0)),
        border_steps=int(at_border.sum()),
        border_off=float(off.max()),
        same_actions=float(np.mean(told["values"].argmax(axis=1) == actions)),
        same_as_wcsim=float(np.mean(same)),
        same_as_recorded=None
        if recorded is None
        else float(np.mean(np.array(actions) == np.array(recorded))),
        cost=footprint(target / MODEL_FILE, target / REFERENCE, graph.inputs),
        bytes=(target / MODEL_FILE).stat().st_size,
    )


def _off(told: F32, wanted: F32, graph: Graph) -> F32:
    """How far the worst number of each step is off, (steps,), of the largest. Raises PolicyError where it is a fault.

    Two libraries round the place of a cell in their last bit each in its own way: on the border of two cells one
    reads this and the other that, and what is read there may differ a little.
    """
    off: F32 = np.abs(told - wanted).max(axis=1) / max(float(np.abs(wanted).max()), 1e-9)
    share, worst = float(np.mean(off > MOST_OFF)), int(off.argmax())
    if share > graph.border_share or off[worst] > BORDER_OFF:
        raise PolicyError(
            f"the exported model's {graph.checked} differ by up to {off[worst]:.2g} of the largest (step {worst}), and "
            f"by more than {MOST_OFF:g} in {share:.1%} of the steps; expected at most {BORDER_OFF:g}, and "
            f"{graph.border_share:.0%}: in a network of your own, compute the same for whatever it is shown, without "
            "`if`; in one of wcsim this is a bug of the export, please report it; nothing was written"
        )
    return off


def _about(config: RunConfig) -> str:
    """The settings with which `wcsim test` shows the model what it was trained on, over those of a preset."""
    usual = resolve(_PRESET)
    told = [
        (f"chair.{key}", value) for key, value in config.chair if value is not None
    ]  # a plant brings its own
    told += [("imu.tilt", config.imu.tilt)] if config.imu.tilt != usual.imu.tilt else []
    told += [("world.action_delay_ticks", config.world.action_delay_ticks)]
    size = as_words(
        (f"cameras.0.{key}", getattr(config.eye, key)) for key in ("width_px", "height_px")
    )
    settings = dict.fromkeys((*size, *settings_apart(config, usual), *as_words(told)))
    lines = ",\n  ".join(json.dumps(setting) for setting in settings)
    return f'preset = "{_PRESET}"\nsettings = [\n  {lines},\n]\n'


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


def _meaning_of(graph: DangerGraph | ValueGraph, config: RunConfig) -> dict[str, Any]:
    """Units, scales, signs, classes, camera, chair and guard of an exported policy, as JSON values."""
    actions, sensors = action_set(config.env.actions), config.sensors.on()
    folded = config.env.classes == "cityscapes"
    sensed = {
        key: section.model_dump(mode="json")
        for key, section in sensors.items()
        if key in graph.inputs
    }
    return {
        "not_for": _NOT_FOR,
        "inputs": {key: _input(key, config) for key in graph.inputs},
        "when": _WHEN,
        "states": {name: list(shape) for name, shape in graph.shapes().items()},
        "reset": _RESET,
        "outputs": {key: _OUTPUTS[key] for key in graph.outputs},
        "actions_xy": actions.points.tolist(),
        **_of_kind(graph, config),
        "classes": {
            kind.name.lower(): int(kind) for kind in ClassId if kind < ClassId.KERB or not folded
        },
        "camera": config.cameras[0].model_dump(mode="json"),
        "senses": {"imu": config.imu.model_dump(mode="json"), **sensed},
        "senses_meaning": _SENSES,
        "chair": config.chair.model_dump(mode="json"),
        "tick_s": config.world.tick_s,
        "action_delay_ticks": config.world.action_delay_ticks,
        "guard": GuardRule(tick_s=config.world.tick_s, deadline_s=config.world.tick_s).model_dump(),
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
    parts = ", ".join(
        f"{part} / {scale:g}" for part, scale in zip(measure.parts, measure.full_scale, strict=True)
    )
    return f"float32 (1, {len(measure.parts)}), each within -1..1: {parts}, means of the tick; to the left is positive"


def _of_kind(graph: DangerGraph | ValueGraph, config: RunConfig) -> dict[str, Any]:
    """How a danger network's dangers become an action, or what the values of Q-learning are."""
    if isinstance(graph, DangerGraph):
        return {"rule": graph.rule.model_dump(), "rule_meaning": _RULE}
    scale = graph.net.spec.prior.reward_scale
    return {"values_meaning": _VALUES, "reward_scale": scale, "discount": config.learn.gamma}
