"""In a list all policies drive under the same rules, whatever a run learned under."""

from pathlib import Path

import pytest

from wcsim.agents.evaluation.suite import run as driving
from wcsim.agents.evaluation.suite.run import _identity_of
from wcsim.agents.evaluation.suite.shifts import CLEAN
from wcsim.agents.opening.list_file import open_suite
from wcsim.agents.opening.named_policy import (
    RULES,
    describe_rule_differences,
    resolve_policy_config,
)
from wcsim.agents.runs.policy_file import POLICY_JSON
from wcsim.agents.runs.run_folder import RunInfo, create_run_folder, make_run_manifest
from wcsim.config import RunConfig, resolve
from wcsim.errors import PolicyError

OWN = (
    "reward.drop=false", "world.button=false", "world.street=careless", "world.tick_s=0.05", "chair.plant=mwd",
    "vary.action_delay_ticks=[0,3]", "cameras.0.width_px=32", "imu.tilt=accelerometer", "env.actions=disc69",
    "sensors.odometry=typical",
)  # fmt: skip


def run_of(folder: Path, preset: str, *settings: str) -> str:
    config = resolve(preset, settings)
    run = create_run_folder(
        folder, config, make_run_manifest(config, RunInfo(seed=1, town="helsinki", town_sha256="a" * 64))
    )
    stage = run.policy("final")
    stage.mkdir(parents=True)
    (stage / POLICY_JSON).write_text("{}")
    return str(folder)


def listed(name: str = "dev2") -> tuple[str, ...]:
    return open_suite(name).file.settings


def drives_as_the_user(policy: RunConfig) -> RunConfig:
    """Under the rules of the user alone, who is given back."""
    user = resolve_policy_config("follow", "quick", listed(), in_list=True)
    assert [getattr(policy, name) for name in RULES] == [getattr(user, name) for name in RULES]
    return user


def test_a_run_of_the_paper_drives_under_the_rules_of_whom_it_is_compared_with(tmp_path):
    run = run_of(tmp_path / "run", "paper")
    policy = resolve_policy_config(run, "quick", listed(), in_list=True)
    user = drives_as_the_user(policy)
    assert user.reward.drop and user.world.button
    assert policy.cameras[0].width_px == 320 and policy.cameras[0].noise == user.cameras[0].noise
    assert policy.learn.network == "fig6"
    (line,) = describe_rule_differences(["follow", "stop", run], "quick", listed())
    assert line.startswith(run) and "world.button=false" in line and "reward.drop=true" in line


def test_a_run_keeps_what_it_senses_and_does_and_brings_no_street_chair_or_range(tmp_path):
    run = run_of(tmp_path / "run", "quick", *OWN)
    own, policy = (
        resolve_policy_config(run, "quick", ()),
        resolve_policy_config(run, "quick", listed(), in_list=True),
    )
    drives_as_the_user(policy)
    assert policy.world.action_delay_ticks == 2 and policy.vary.nothing
    for name in ("imu", "sensors", "learn", "danger", "collect"):
        assert getattr(policy, name) == getattr(own, name)
    assert policy.env == own.env.model_copy(update={"max_steps": 10_000})
    assert policy.cameras[0].width_px == 32 and policy.cameras[0].noise is not None
    (line,) = describe_rule_differences([run], "quick", listed())
    for word in ("chair.plant=mwd", "world.tick_s=0.05", "with world.tick_s=0.1", "vary.action_delay_ticks=[0, 3]"):
        assert word in line


def test_what_is_typed_for_the_test_holds_for_all(tmp_path):
    run, typed = run_of(tmp_path / "run", "paper", "world.tick_s=0.05"), ("reward.drop=false", "world.tick_s=0.2")
    found = [resolve_policy_config(name, "quick", (*listed(), *typed), in_list=True) for name in ("follow", run)]
    assert found[0].world == found[1].world and found[0].reward == found[1].reward
    assert not found[1].reward.drop and found[1].world.tick_s == 0.2
    paper = [resolve_policy_config(name, "paper", listed(), in_list=True) for name in ("follow", run)]
    assert not paper[0].reward.drop and paper[0].reward == paper[1].reward and paper[0].world == paper[1].world


@pytest.mark.parametrize("name", ["quick", "laptop", "best", "dqn", "shipped"])
@pytest.mark.parametrize("more", [(), CLEAN])
def test_presets_that_change_no_rule_are_tested_as_their_runs_learned(tmp_path, name, more):
    policy, settings = "shipped" if name == "shipped" else run_of(tmp_path / "run", name), (*listed(), *more)
    assert resolve_policy_config(policy, "quick", settings, in_list=True) == resolve_policy_config(
        policy, "quick", settings
    )
    assert not list(describe_rule_differences([policy], "quick", settings))


def test_a_model_in_onnx_drives_under_the_rules_too(tmp_path):
    (tmp_path / "policy.onnx").write_bytes(b"")
    told = '"reward.drop=false", "chair.plant=mwd", "cameras.0.width_px=32"'
    (tmp_path / "policy.toml").write_text(f'preset = "quick"\nsettings = [{told}]\n')
    found = resolve_policy_config(str(tmp_path), "quick", listed(), in_list=True)
    drives_as_the_user(found)
    assert found.cameras[0].width_px == 32
    (line,) = describe_rule_differences([str(tmp_path)], "quick", listed())
    assert "chair.plant=mwd" in line
    assert _identity_of(str(tmp_path), "quick") != _identity_of(str(tmp_path), "paper")


def test_a_block_is_driven_under_them(tmp_path, monkeypatch):
    run, configs = run_of(tmp_path / "run", "paper"), []

    def no_policy(name, config, seed, network):
        configs.append(config)
        raise PolicyError("none")

    monkeypatch.setattr(driving, "open_named_policy", no_policy)
    order = driving.SuiteOrder(suite=open_suite("dev2"), out=tmp_path)
    records = driving.drive_piece(driving.piece_of(order, 0, run, {}, judged=False))
    assert {record.status for record in records} == {"refused"}
    assert configs == [resolve_policy_config(run, "quick", listed(), in_list=True)] and configs[0].reward.drop
