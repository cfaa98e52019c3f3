"""A folder with an ONNX model drives: by the names of its inputs, with states, and says what does not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from wcsim.agents.policies.onnx_policy import MODEL_FILE, OnnxPolicy, is_onnx_folder, read_about
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
    graph = helper.make_graph(
        nodes,
        "toy",
        [
            helper.make_tensor_value_info(joystick, TensorProto.FLOAT, [1, 2]),
            helper.make_tensor_value_info("state_h", TensorProto.FLOAT, [1, 1]),
        ],
        [
            helper.make_tensor_value_info("values", TensorProto.FLOAT, [1, actions]),
            helper.make_tensor_value_info(state, TensorProto.FLOAT, [1, 1]),
            helper.make_tensor_value_info("warning", TensorProto.FLOAT, [1, 1]),
        ],
        [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, folder / MODEL_FILE)
    return folder


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
    ("made", "seen", "said"),
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


def test_a_folder_is_read_or_refused(tmp_path: Path) -> None:
    assert not is_onnx_folder(tmp_path)
    with pytest.raises(PolicyError, match="has no output 'next_state_h'"):
        OnnxPolicy(write_model(tmp_path, state="later"), "toy", ACTIONS)
    assert is_onnx_folder(tmp_path)
    (tmp_path / MODEL_FILE).write_bytes(b"no model")
    with pytest.raises(PolicyError, match="expected an ONNX model"):
        OnnxPolicy(tmp_path, "toy", ACTIONS)
    assert read_about(tmp_path).preset == "quick"
    (tmp_path / "policy.toml").write_text('settings = ["env.actions=paper"]\n')
    assert read_about(tmp_path).settings == ("env.actions=paper",)
    for text in ("settings = 3\n", "settings = " + 2000 * "[", "x" * (2 << 20)):
        (tmp_path / "policy.toml").write_text(text)
        with pytest.raises(PolicyError, match=r"policy\.toml"):
            read_about(tmp_path)
