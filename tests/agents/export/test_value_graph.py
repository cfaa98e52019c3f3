"""Exported networks of Q-learning: the folder drives as the policy of wcsim does, whatever it remembers."""

import json
import subprocess
import sys
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from tests.agents.export.test_danger_graph import ride
from tests.agents.export.test_guarded_policy import EXAMPLE
from tests.agents.toy import ToyStreet, WindowedStreet, toy_camera
from wcsim.agents.envs.episode_view import FrameStacker
from wcsim.agents.export import onnx_export
from wcsim.agents.export.export_folder import WRITTEN
from wcsim.agents.export.footprint import OnnxModelCost
from wcsim.agents.export.guard import MEANING
from wcsim.agents.export.onnx_export import MOST_OFF, ExportMeasurements, export_policy
from wcsim.agents.learning.build import build_q_learner, default_settings_for_network
from wcsim.agents.learning.saved_policy import load_policy, save_policy
from wcsim.agents.networks.names import NETWORK_NAMES
from wcsim.agents.opening.learner_registry import Q_LEARNING
from wcsim.agents.opening.named_policy import open_named_policy
from wcsim.agents.policies.onnx_policy import OnnxPolicy
from wcsim.config import CameraConfig, LearnConfig, RunConfig, resolve
from wcsim.errors import PolicyError

CAMERA = toy_camera(16, 20)
RIDE = [{**seen, "imu": seen["imu"][:5]} for seen in ride(40, RunConfig(cameras=(CAMERA,)))]
COST = OnnxModelCost(**dict.fromkeys((field.name for field in fields(OnnxModelCost)), 1.0))
KINDS = (("patch", "groups"), ("fig6", "groups"), ("conv3d", "windows"), ("convlstm", "groups"), ("fig6", "windows"))
ALONE = """import runpy, sys
sys.modules.update(dict.fromkeys(("wcsim", "torch", "onnx", "gymnasium", "scipy")))  # to import one of them fails
del sys.argv[0]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def config_of(network: str, memory: str = "windows", camera: CameraConfig = CAMERA) -> RunConfig:
    learn = LearnConfig(
        network=network, memory=memory, head="plain", replay_frames=200, learning_starts=40, reward_scale=0.02
    )  # half of the ticks lose enough for a warning
    config = RunConfig(cameras=(camera,), learn=learn)
    return resolve(config, default_settings_for_network(config))


def saved(folder: Path, config: RunConfig) -> Path:
    """A policy whose choice depends on all that it is shown."""
    torch.manual_seed(5)
    window, (camera,) = config.env.frames, config.cameras
    model = build_q_learner(config, WindowedStreet(window, camera) if window > 1 else ToyStreet(camera), 0)
    with torch.no_grad():
        for value in model.q_net.parameters():
            value.add_(0.5 * torch.randn_like(value) * (value.abs().mean() + 0.02))
    return save_policy(folder, model, camera)


@pytest.fixture(scope="module", autouse=True)
def at_once():
    """Nobody waits for the cost of a model to be measured."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(onnx_export, "measure_onnx_model_cost", lambda *given: COST)
        yield


@pytest.fixture(scope="module", params=KINDS, ids="-".join)
def made(request, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ExportMeasurements, Path]:
    place = tmp_path_factory.mktemp("export")
    config = config_of(*request.param)
    policy = saved(place / "policy", config)
    graph = Q_LEARNING.open_graph(policy, config)
    return place / "onnx", export_policy(*graph, place / "onnx", config, RIDE), policy


def test_the_folder_has_what_the_network_says_and_means(made):
    folder, facts, policy = made
    assert facts.most_off < MOST_OFF and facts.border_steps == 0
    assert facts.same_actions == facts.same_as_wcsim == 1.0
    meaning = json.loads((folder / MEANING).read_text())
    net = load_policy(policy).net
    assert tuple(meaning["inputs"]) == ("depth", "seg", "imu", "joystick")
    assert tuple(meaning["outputs"]) == ("values", "warning") and meaning["tolerated_loss"] == pytest.approx(0.18)
    assert meaning["inputs"]["imu"].startswith("float32 (1, 5)") and meaning["facts"] == asdict(facts)
    assert meaning["reward_scale"] == net.spec.prior.reward_scale and meaning["discount"] == 0.97
    looks_back = set(meaning["states"]) - {"state_alarm"}
    assert bool(looks_back) == (net.spec.network != "patch"), "what looks back has a state, of either kind"
    with np.load(folder / "reference.npz") as kept:
        assert kept["depth"].shape == kept["seg"].shape == (40, 1, 16, 20), "one picture a tick"
        assert kept["values"].shape == (40, 81) and len(np.unique(kept["action"])) > 1
    assert {path.name for path in folder.iterdir()} == set(WRITTEN)


def test_over_several_episodes_the_folder_chooses_and_warns_as_the_policy_of_wcsim_does(made):
    folder, facts, policy = made
    own, other = load_policy(policy), open_named_policy(str(folder), RunConfig(cameras=(CAMERA,)), 0)
    driver = EXAMPLE["Driver"](folder, clock=lambda: 0.0)
    view, chosen, warned = FrameStacker(own.file.window), [], []
    for each in (own, other):
        each.begin()
    for episode in (RIDE[:11], RIDE[5:7], RIDE):
        view.reset()
        own.reset()
        other.reset()
        driver.reset()
        for seen in episode:
            driver.step({key: seen[key] for key in driver.meaning["inputs"]})
            chosen.append((own.act(view.add(seen)), other.act(seen)))
            warned.append((own.warning, other.warning, bool(driver.warning)))
    assert all(mine == its for mine, its in chosen) and len(set(chosen)) > 1
    assert set(warned) == {(False,) * 3, (True,) * 3}
    assert facts.warnings == sum(mine for mine, *_ in warned[-len(RIDE) :]), "what the export reports of the ride"


def test_beside_a_policy_that_needs_a_window_it_sees_the_newest_picture_alone(made):
    folder, _, _ = made
    view, alone, beside = FrameStacker(4), OnnxPolicy(folder, "one", 81), OnnxPolicy(folder, "other", 81)
    for policy in (alone, beside):
        policy.reset()
    assert [alone.act(seen) for seen in RIDE[:9]] == [beside.act(view.add(dict(seen))) for seen in RIDE[:9]]


def test_the_example_repeats_the_reference_with_numpy_and_the_runtime_alone(made):
    words = [sys.executable, "-P", "-c", ALONE, str(made[0] / "exported_policy.py")]
    done = subprocess.run([*words, str(made[0])], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("40 of 40 actions as recorded, ")
    assert done.stdout.endswith("values as recorded in 100% of the steps\n")


def test_every_network_of_wcsim_is_exported_here():
    assert {name for name, _ in KINDS} == set(NETWORK_NAMES)


def test_what_takes_too_long_is_refused_and_nothing_is_written(tmp_path):
    config = config_of("patch")
    with pytest.raises(PolicyError, match="--force"):
        graph = Q_LEARNING.open_graph(saved(tmp_path / "policy", config), config)
        export_policy(*graph, tmp_path / "onnx", config, RIDE[:2], limit_ms=0.5)
    assert not (tmp_path / "onnx").exists()


class Plain(nn.Module):
    """A network of a user."""

    def __init__(self, image_shape, vector_size: int) -> None:
        super().__init__()
        self.dense = nn.Linear(image_shape[0] + vector_size, 8)

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        return self.dense(torch.cat([image.mean((2, 3)), vector], 1))


class Branches(Plain):
    """One that decides by what it is shown, which is not in the traced model."""

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        return super().forward(image, vector) * (1.0 if bool(vector[0, 5] > 0.0) else -1.0)


class Strange(Plain):
    """One with an operation that ONNX lacks."""

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        return super().forward(image, vector) + torch.linalg.svdvals(image.mean(1)).sum()


def test_a_network_of_ones_own_is_exported_when_it_is_named_or_refused_with_the_reason(tmp_path):
    refusals = {"Plain": "", "Branches": "without `if`", "Strange": "cannot be exported to ONNX"}
    for name, refusal in refusals.items():
        network = f"{__name__}:{name}"
        config = config_of(network)
        policy, out = saved(tmp_path / name, config), tmp_path / f"{name} onnx"
        with pytest.raises(PolicyError, match=f"--network {network}"):
            Q_LEARNING.open_graph(policy, config)
        if not refusal:
            graph = Q_LEARNING.open_graph(policy, config, network=network)
            assert export_policy(*graph, out, config, RIDE).same_as_wcsim == 1.0
            continue
        with pytest.raises(PolicyError, match=refusal):
            export_policy(*Q_LEARNING.open_graph(policy, config, network=network), out, config, RIDE)
        assert not out.exists()
