"""Danger networks and data that do not fit what they are given to: one message each, and nothing that runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from tests.agents.export.test_danger_graph import CONFIG, network, ride
from wcsim.agents.danger.policy import load_danger, save_danger
from wcsim.agents.danger.street_map import FeatureExtractor
from wcsim.agents.runs.data_folder import read_manifest, require_same_settings, write_manifest
from wcsim.agents.runs.policy_file import WEIGHTS
from wcsim.config import resolve
from wcsim.config.run_file import DangerRule
from wcsim.core import files
from wcsim.errors import PolicyError


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    return save_danger(tmp_path / "policy", network(), DangerRule(), CONFIG)


def exchanged(saved: Path, data: bytes) -> None:
    """Other weights, and a policy.json that says they are the right ones."""
    (saved / WEIGHTS).write_bytes(data)
    said = json.loads((saved / "policy.json").read_text())
    said["weights_sha256"] = files.sha256(saved / WEIGHTS)
    (saved / "policy.json").write_text(json.dumps(said))


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("env.actions=disc69", "actions differ"),
        ("env.classes=wcsim", "classes differ"),
        ("cameras.0.width_px=64", "width_px differ"),
        ("cameras.0.pitch_deg=10", "pitch_deg differ"),
    ],
)
def test_a_run_with_other_actions_classes_or_pictures_is_refused(saved: Path, setting: str, told: str):
    with pytest.raises(PolicyError, match=told):
        load_danger(saved, "own", resolve(CONFIG, (setting,)))


@pytest.mark.parametrize(
    ("bad", "told"),
    [
        ({"odometry": None}, "no odometry"),
        ({"imu": np.zeros(5, np.float32)}, "5 numbers of the IMU.*env.observe_gyro=true"),
        ({"depth": np.zeros((1, 30, 40), np.uint8)}, r"\(30, 40\).*expected \(36, 48\)"),
    ],
)
def test_an_observation_without_its_senses_is_refused(bad, told):
    seen = {key: value for key, value in {**ride(1)[0], **bad}.items() if value is not None}
    with pytest.raises(PolicyError, match=told):
        FeatureExtractor(CONFIG).extract(seen)


def test_weights_of_another_hash_type_shape_or_form_are_refused(saved: Path):
    whole = (saved / WEIGHTS).read_bytes()
    (saved / WEIGHTS).write_bytes(whole[:-1] + b"x")
    with pytest.raises(PolicyError, match="damaged or replaced"):
        load_danger(saved, "own", CONFIG)
    (saved / WEIGHTS).write_bytes(whole)
    tensors = load_file(saved / WEIGHTS)
    save_file({**tensors, "base": tensors["base"].double()}, saved / "other")
    exchanged(saved, (saved / "other").read_bytes())
    with pytest.raises(PolicyError, match=r"base is float64 \[\], expected float32"):
        load_danger(saved, "own", CONFIG)
    torch.save(tensors, saved / "foreign")
    foreign = (saved / "foreign").read_bytes()
    exchanged(saved, foreign[: len(whole)].ljust(len(whole), b"\0"))
    with pytest.raises(PolicyError, match="not a safetensors file"):
        load_danger(saved, "own", CONFIG)


@pytest.mark.parametrize("field", ["schema_version", "algorithm", "net", "rule", "weights_sha256"])
def test_a_policy_json_of_another_kind_is_refused(saved: Path, field: str):
    said = json.loads((saved / "policy.json").read_text())
    (saved / "policy.json").write_text(json.dumps({**said, field: 7}))
    with pytest.raises(PolicyError, match=r"policy\.json"):
        load_danger(saved, "own", CONFIG)


@pytest.mark.parametrize("setting", ["world.tick_s=0.05", "cameras.0.pitch_deg=10", "chair.v_max_mps=1.0"])
def test_data_of_another_world_is_refused(tmp_path: Path, setting: str):
    write_manifest(tmp_path, CONFIG, {"corner": "0" * 64}, {})
    file = read_manifest(tmp_path)
    require_same_settings(tmp_path, file, CONFIG)
    name = setting.partition("=")[0]
    with pytest.raises(PolicyError, match="chair" if "chair" in name else name.replace(".", r"\.")):
        require_same_settings(tmp_path, file, resolve(CONFIG, (setting,)))


def test_data_that_says_nothing_of_its_world_is_refused(tmp_path: Path):
    write_manifest(tmp_path, CONFIG, {"corner": "0" * 64}, {})
    said = json.loads((tmp_path / "data.json").read_text())
    (tmp_path / "data.json").write_text(json.dumps({**said, "config": {"cameras": 3}}))
    with pytest.raises(PolicyError, match="other settings"):
        require_same_settings(tmp_path, read_manifest(tmp_path), CONFIG)
