"""Danger networks and data that do not fit what they are given to: one message each, and nothing that runs."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.agents.export.test_danger_graph import CONFIG, network, ride
from wcsim.agents.danger.policy import load_danger, save_danger
from wcsim.agents.danger.street_map import FeatureExtractor
from wcsim.agents.runs.data_folder import read_data_manifest, require_same_data_settings, write_data_manifest
from wcsim.config import resolve
from wcsim.config.run_file import DangerRuleSettings
from wcsim.errors import PolicyError


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    return save_danger(tmp_path / "policy", network(), DangerRuleSettings(), CONFIG)


@pytest.mark.parametrize(
    "setting, told",
    [
        ("env.actions=disc69", "actions differ"),
        ("env.classes=wcsim", "classes differ"),
        ("cameras.0.width_px=64", "width_px differ"),
        ("cameras.0.pitch_deg=10", "pitch_deg differ"),
    ],
)
def test_a_run_with_other_actions_classes_or_pictures_is_refused(saved: Path, setting: str, told: str):
    with pytest.raises(PolicyError, match=told):
        load_danger(saved, "own", resolve(CONFIG, setting))


@pytest.mark.parametrize(
    "bad, told",
    [
        ({"odometry": None}, "no odometry"),
        ({"imu": np.zeros(5, np.float32)}, "5 numbers of the IMU.*env.observe_gyro=true"),
        ({"depth": np.zeros((1, 30, 40), np.uint8)}, r"\(30, 40\).*expected .*'depth': \(36, 48\)"),
    ],
)
def test_an_observation_without_its_senses_is_refused(bad, told):
    seen = {key: value for key, value in {**ride(1)[0], **bad}.items() if value is not None}
    with pytest.raises(PolicyError, match=told):
        FeatureExtractor(CONFIG).extract(seen)


def test_data_that_says_nothing_of_its_world_is_refused(tmp_path: Path):
    write_data_manifest(tmp_path, CONFIG, {"corner": "0" * 64}, {})
    said = json.loads((tmp_path / "data.json").read_text())
    (tmp_path / "data.json").write_text(json.dumps({**said, "config": {"cameras": 3}}))
    with pytest.raises(PolicyError, match="other settings"):
        require_same_data_settings(tmp_path, read_data_manifest(tmp_path), CONFIG)
