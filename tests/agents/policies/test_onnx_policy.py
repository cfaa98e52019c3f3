"""A folder with an ONNX model drives: by the names of its inputs, with states, and says what does not fit."""

import os
import signal
import threading
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from wcsim.agents.opening.named_policy import describe_rule_differences
from wcsim.agents.policies import onnx_policy
from wcsim.agents.policies.onnx_policy import OnnxPolicy, read_onnx_policy_file
from wcsim.agents.policy_api import MODEL_FILE, Warns
from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.errors import PolicyError

ACTIONS = 9
SEEN = {"joystick": np.array([0.25, 0.5], np.float32), "depth": np.zeros((1, 6, 8), np.uint8)}


def write_model(folder: Path, joystick: str = "joystick", actions: int = ACTIONS, state: str = "next_state_h") -> Path:
    """Values of action k: joystick x minus the steps driven at k = 0, y at k = 3, 0 elsewhere; warns from step 2 on."""
    weight = np.zeros((2, actions), np.float32)
    weight[0, 0], weight[1, 3] = 1.0, 1.0
    nodes = [
        helper.make_node("MatMul", [joystick, "weight"], ["q"]),
        helper.make_node("Add", ["state_h", "one"], [state]),
        helper.make_node("Mul", [state, "first"], ["tired"]),
        helper.make_node("Sub", ["q", "tired"], ["values"]),
        helper.make_node("Mul", [state, "third"], ["warning"]),
    ]
    first = np.zeros((1, actions), np.float32)
    first[0, 3] = 1.0
    constants = {"weight": weight, "one": np.ones((1, 1), np.float32), "first": first}
    constants["third"] = np.full((1, 1), 0.3, np.float32)
    info = helper.make_tensor_value_info
    inputs = [info(joystick, TensorProto.FLOAT, [1, 2]), info("state_h", TensorProto.FLOAT, [1, 1])]
    outputs = [info("values", TensorProto.FLOAT, [1, actions]), info(state, TensorProto.FLOAT, [1, 1])]
    outputs.append(info("warning", TensorProto.FLOAT, [1, 1]))
    return save_model(folder, nodes, inputs, outputs, constants)


def save_model(folder: Path, nodes: list, inputs: list, outputs: list, constants: dict[str, np.ndarray]) -> Path:
    tensors = [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "toy", inputs, outputs, tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, folder / MODEL_FILE)
    return folder


def write_step(folder: Path, *nodes: onnx.NodeProto, **constants: np.ndarray) -> Path:
    """A model whose nodes make `values` of the joystick."""
    info = helper.make_tensor_value_info
    given, made = info("joystick", TensorProto.FLOAT, [1, 2]), info("values", TensorProto.FLOAT, None)
    return save_model(folder, list(nodes), [given], [made], constants)


def write_endless(folder: Path) -> Path:
    """A model whose step does not end."""
    info = helper.make_tensor_value_info
    inside = [helper.make_node("Identity", [name], [f"{name}_next"]) for name in ("goes_on", "x")]
    body = helper.make_graph(
        inside,
        "body",
        [info("i", TensorProto.INT64, []), info("goes_on", TensorProto.BOOL, []), info("x", TensorProto.FLOAT, [1, 2])],
        [info("goes_on_next", TensorProto.BOOL, []), info("x_next", TensorProto.FLOAT, [1, 2])],
    )
    loop = helper.make_node("Loop", ["", "true", "joystick"], ["values"], body=body)
    return write_step(folder, loop, true=np.array(True))


def test_the_highest_value_wins_states_go_round_and_an_episode_begins_anew(tmp_path: Path) -> None:
    policy = OnnxPolicy(write_model(tmp_path), "toy", ACTIONS)
    for _ in range(2):
        policy.begin()
        policy.reset()
        assert not policy.warning
        # 0.25 at action 0; at action 3 half the throttle less the steps driven
        assert [(policy.act(SEEN), policy.warning) for _ in range(3)] == [(0, False), (0, True), (0, True)]
    policy.reset()
    assert policy.act({**SEEN, "joystick": np.array([0.0, 1.5], np.float32)}) == 3


@pytest.mark.parametrize(
    "made, seen, said",
    [
        ({"joystick": "speed"}, SEEN, "wants an input 'speed'; this test observes depth, joystick"),
        ({"actions": 5}, SEEN, "expected 9 finite ones"),
        ({}, {**SEEN, "joystick": np.array([np.nan, 0.0], np.float32)}, "of them NaN"),
        ({}, {**SEEN, "joystick": np.zeros(3, np.float32)}, "refuses the observation"),
    ],
)
def test_what_does_not_fit_is_told(tmp_path: Path, made: dict, seen: dict, said: str) -> None:
    policy = OnnxPolicy(write_model(tmp_path, **made), "toy", ACTIONS)
    policy.reset()
    with pytest.raises(PolicyError, match=said):
        policy.act(seen)


def test_a_folder_of_an_earlier_version_has_no_warning_and_a_test_reports_it(tmp_path: Path) -> None:
    policy = OnnxPolicy(write_step(tmp_path, helper.make_node("Identity", ["joystick"], ["values"])), "old", 2)
    assert policy.act(SEEN) == 1 and not isinstance(policy, Warns)
    (tmp_path / "new").mkdir()
    names = (str(tmp_path), f"veto:{tmp_path}", str(write_model(tmp_path / "new")))
    (line,) = (line for line in describe_rule_differences(names, "quick", ()) if "never" in line)
    assert line.startswith(f"{tmp_path} never warns")


def test_a_folder_is_read_or_refused(tmp_path: Path) -> None:
    assert parse_policy_name(str(tmp_path)).kind == "folder"
    with pytest.raises(PolicyError, match="has no output 'next_state_h'"):
        OnnxPolicy(write_model(tmp_path, state="later"), "toy", ACTIONS)
    assert parse_policy_name(str(tmp_path)).kind == "onnx"
    (tmp_path / MODEL_FILE).write_bytes(b"no model")
    with pytest.raises(PolicyError, match="expected an ONNX model"):
        OnnxPolicy(tmp_path, "toy", ACTIONS)
    assert read_onnx_policy_file(tmp_path).preset == "quick"
    (tmp_path / "policy.toml").write_text('settings = ["env.actions=paper"]\n')
    assert read_onnx_policy_file(tmp_path).settings == ("env.actions=paper",)
    for text in ("settings = 3\n", "settings = " + 2000 * "[", "x" * (2 << 20)):
        (tmp_path / "policy.toml").write_text(text)
        with pytest.raises(PolicyError, match=r"policy\.toml"):
            read_onnx_policy_file(tmp_path)


def test_a_step_that_does_not_end_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    policy = OnnxPolicy(write_endless(tmp_path), "endless", 2)
    policy.reset()
    monkeypatch.setattr(onnx_policy, "ANSWER_S", 0.2)
    with pytest.raises(PolicyError, match=r"no answer for 0\.2 s; expected one a tick"):
        policy.act(SEEN)


def test_a_signal_ends_a_step_that_does_not_end(tmp_path: Path) -> None:
    policy = OnnxPolicy(write_endless(tmp_path), "endless", 2)
    policy.reset()
    threading.Timer(0.2, os.kill, [os.getpid(), signal.SIGINT]).start()
    with pytest.raises(KeyboardInterrupt):
        policy.act(SEEN)


def test_a_model_is_bounded_in_memory(tmp_path: Path) -> None:
    large = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, 2 * [1 << 20]) for name in ("state_a", "next_state_a")
    ]
    node = helper.make_node("Identity", ["state_a"], ["next_state_a"])
    with pytest.raises(PolicyError, match="its states have 4398046511104 bytes; expected at most 1073741824"):
        OnnxPolicy(save_model(tmp_path, [node], large[:1], large[1:], {}), "large", ACTIONS)
    node = helper.make_node("ConstantOfShape", ["shape"], ["values"])
    policy = OnnxPolicy(write_step(tmp_path, node, shape=np.array([1 << 17, 1 << 16], np.int64)), "34 GB", 2)
    policy.reset()
    with pytest.raises(PolicyError, match="refuses the observation"):
        policy.act(SEEN)


def test_what_a_model_says_is_bounded_and_printable(tmp_path: Path) -> None:
    node = helper.make_node("MatMul", ["joystick", "joystick"], ["values"], name="a\nb\x1b[31m" + 5000 * "c")
    with pytest.raises(PolicyError) as told:
        policy = OnnxPolicy(write_step(tmp_path, node), "x", 2)
        policy.reset()
        policy.act(SEEN)
    assert str(told.value).isprintable() and len(str(told.value)) < 500
