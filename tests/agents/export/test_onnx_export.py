"""An exported folder: what it says, what it costs, and that the example drives it as wcsim does."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.agents.export.test_danger_graph import CONFIG, network, ride
from tests.agents.export.test_guarded_policy import EXAMPLE
from wcsim.agents.danger.policy import save_danger
from wcsim.agents.export import onnx_export
from wcsim.agents.export.guard import MEANING, GuardedPolicy, read_guard_rule
from wcsim.agents.export.onnx_export import ExportMeasurements, export_policy
from wcsim.agents.opening.learner_registry import DANGER_ROUNDS
from wcsim.agents.opening.named_policy import open_named_policy
from wcsim.agents.policies.onnx_policy import read_onnx_policy_file
from wcsim.agents.policy_api import Policy
from wcsim.agents.runs.policy_file import CAMERA_KEYS
from wcsim.config import resolve
from wcsim.config.run_file import DangerRuleSettings, PolicyGuardSettings
from wcsim.errors import PolicyError

RIDE = ride(200)


def opened(folder: Path, level: float | None = None) -> tuple[onnx_export.Graph, Policy]:
    return DANGER_ROUNDS.open_graph(folder, CONFIG, level)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ExportMeasurements]:
    place = tmp_path_factory.mktemp("export")
    save_danger(place / "policy", network(), DangerRuleSettings(threshold=0.4), CONFIG)
    return place / "onnx", export_policy(*opened(place / "policy", 0.35), place / "onnx", CONFIG, RIDE)


def test_200_steps_are_those_of_the_network_and_of_wcsim(made):
    folder, facts = made
    assert facts.steps == 200 and facts.border_off < 1e-3 and facts.same_actions == 1.0
    assert facts.border_steps <= 2, "places on the border of two cells"
    assert facts.same_as_wcsim > 0.97, "cells at a border may go either way"
    meaning = json.loads((folder / MEANING).read_text())
    assert meaning["rule"]["threshold"] == 0.35 and meaning["facts"]["steps"] == 200
    assert read_guard_rule(folder) == PolicyGuardSettings()
    for key in ("gravity", "mean_gravity"):  # one of what is judged, one of the input: side by side they want a word
        assert key in meaning["senses"]["imu"] and key in meaning["senses_meaning"]


def test_what_it_costs_is_measured_in_a_process_of_its_own(made):
    _, facts = made
    cost = facts.cost
    assert 0.0 < cost.p50_ms <= cost.p99_ms and 0.0 < cost.quota_p50_ms <= cost.quota_p99_ms
    assert cost.cpu_p50_ms > 0.0 and 20.0 < cost.peak_mb < 400.0, "Python and ONNX Runtime, without torch"
    assert (facts.quota_share, facts.quota_by) == (0.5, "SIGSTOP and SIGCONT")


@pytest.mark.parametrize("eyes", ['"front"', '"front", "rear"'])
def test_a_test_of_the_folder_shows_it_the_cameras_and_the_chair_of_its_training(tmp_path, eyes):
    own = (
        f"env.camera=[{eyes}]",
        *("cameras.0.hfov_deg=70", "cameras.0.p_BC_m=[0.3,0.0,1.1]", "chair.plant=whill", "chair.accel_mps2=1.0"),
        *("env.classes=wcsim", "env.actions=disc69", "world.action_delay_ticks=1"),
        *("env.observe_yaw=true", "sensors.odometry={radius_error=0.02}"),
    )
    config = resolve("laptop", own)
    (tmp_path / "policy.toml").write_text(onnx_export._about(config), encoding="utf-8")
    about = read_onnx_policy_file(tmp_path)
    tested = resolve(about.preset, about.settings)
    assert tested.chair == config.chair and tested.env.classes == "wcsim" and tested.env.actions == "disc69"
    keys = CAMERA_KEYS
    pairs = zip(tested.eyes.values(), config.eyes.values(), strict=True)
    assert all(getattr(one, key) == getattr(other, key) for one, other in pairs for key in keys)
    assert tested.world.action_delay_ticks == 1
    assert tested.env.observe_yaw and not tested.env.observe_gyro and tested.sensors == config.sensors


def test_the_example_and_wcsim_do_the_same_with_bad_frames(made):
    """NaN in the odometry, and good frames after it."""
    folder, _ = made
    mine = open_named_policy(str(folder), CONFIG, 0)
    assert isinstance(mine, GuardedPolicy)
    mine.begin()
    mine.reset()
    other = EXAMPLE["Driver"](folder, clock=lambda: 0.0)
    tripped = 0
    for tick, seen in enumerate(RIDE[:80]):
        frames = {**seen, "odometry": np.array([np.nan, 0.0], np.float32)} if tick in (10, 11, 40) else dict(seen)
        mine.act(frames)
        assert mine.stick == tuple(other.step(frames)) and mine.warning == other.warning
        tripped += mine.tripped
    assert 15 < tripped < 30


def test_a_guard_that_cannot_be_read_is_refused_in_a_line(tmp_path):
    (tmp_path / MEANING).write_text(json.dumps({"guard": {"oldest_s": -1.0}}))
    with pytest.raises(PolicyError, match="oldest_s"):
        read_guard_rule(tmp_path)


@pytest.mark.parametrize("part", [{"imu": np.zeros(8)}, {"depth": np.zeros((1, 480, 640), np.uint8)}, {"seg": "sky"}])
def test_what_ends_the_model_in_an_error_stops_the_chair_of_the_example(made, part):
    driver = EXAMPLE["Driver"](made[0], clock=lambda: 0.0)
    for seen in RIDE[:5]:
        driver.step(dict(seen))
    before = np.hypot(*driver.guard.stick)
    sticks = [np.hypot(*driver.step({**RIDE[5], **part})) for _ in range(6)]
    assert driver.guard.tripped and sticks[0] < before and sticks[-1] == 0.0
