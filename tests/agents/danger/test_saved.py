"""Danger networks on disk."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from tests.agents.danger.sights import TWO, all_of, lectures, observation, small_config
from wcsim.agents.danger.network import DangerNet, channels_last, spec_of
from wcsim.agents.danger.policy import load_danger, load_net, save_danger
from wcsim.agents.opening.learner_registry import DANGER_ROUNDS
from wcsim.agents.runs.policy_file import POLICY_JSON, WEIGHTS
from wcsim.config import RunConfig, resolve
from wcsim.config.run_file import DangerRuleSettings
from wcsim.core import files
from wcsim.errors import PolicyError

RULE = DangerRuleSettings(threshold=0.2, warn=0.6)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "p"


def saved(folder: Path, config: RunConfig) -> DangerNet:
    torch.manual_seed(3)
    net = channels_last(DangerNet(spec_of(config))).eval()
    save_danger(folder, net, RULE, config)
    return net


@pytest.mark.parametrize("words", [(), (TWO,)], ids=str)
def test_a_network_comes_back_as_it_was_saved(folder: Path, words: tuple[str, ...]):
    config = small_config(*words)
    net = saved(folder, config)
    again, rule = load_net(folder)
    lessons = lectures(config, 8)
    batch = lessons.batch(all_of(lessons))
    assert all(getattr(again.spec, part) == value for part, value in net.spec) and rule == RULE
    assert torch.equal(again(*batch.inputs), net(*batch.inputs))


@contextmanager
def description(folder: Path) -> Iterator[dict[str, Any]]:
    """What the description of a network says, to be changed."""
    path = folder / POLICY_JSON
    told = json.loads(path.read_text())
    yield told
    path.write_text(json.dumps(told))


def reseal(folder: Path) -> None:
    with description(folder) as told:
        told["weights_sha256"] = files.sha256_from_file(folder / WEIGHTS)


def test_weights_that_are_not_those_of_the_description_are_refused(folder: Path):
    saved(folder, small_config())
    weights = load_file(folder / WEIGHTS)
    changed = {**weights, "base": weights["base"] + 1.0}
    save_file(changed, folder / WEIGHTS)
    with pytest.raises(PolicyError, match="SHA-256"):
        load_net(folder)
    for name, value in (("base", weights["base"].double()), ("direct.0.weight", weights["direct.0.weight"][:-1])):
        save_file({**weights, name: value.contiguous()}, folder / WEIGHTS)
        reseal(folder)
        with pytest.raises(PolicyError, match=r"does not fit|has weights of"):
            load_net(folder)
    save_file({**weights, "base": torch.tensor(float("nan"))}, folder / WEIGHTS)
    reseal(folder)
    with pytest.raises(PolicyError, match="not finite"):
        load_net(folder)


@pytest.mark.parametrize(
    "key, value",
    [
        *(("eye", "ear"), ("window", 1), ("width", 10**9)),
        *((part, 7) for part in ("schema_version", "algorithm", "net", "rule", "weights_sha256")),
    ],
)
def test_a_description_out_of_bounds_is_refused(folder: Path, key: str, value: object):
    saved(folder, small_config())
    with description(folder) as told:
        (told if key in told else told["net"])[key] = value
    with pytest.raises(PolicyError, match=key):
        load_net(folder)


def test_a_network_of_a_shorter_way_is_refused(folder: Path):
    saved(folder, small_config())
    with description(folder) as told:
        told["schema_version"] = 1
    with pytest.raises(
        PolicyError, match=r"schema_version: Input should be 2, got 1: another version wrote it, make it again"
    ):
        load_net(folder)


def test_several_cameras_are_those_of_the_training(tmp_path: Path, folder: Path):
    two, one = small_config(TWO), small_config()
    saved(folder, two)
    for config, told in (
        (one, r'2 cameras.* has 1; .*\["front", "rear"\]'),
        (resolve(two, "cameras.1.yaw_deg=90"), "yaw"),
    ):
        with pytest.raises(PolicyError, match=told):
            load_danger(folder, "own", config)
    saved(tmp_path / "one", one)
    alone, beside = (load_danger(tmp_path / "one", "own", config) for config in (one, two))
    for tick in range(6):
        seen = observation(two, tick)
        assert beside.act(seen) == alone.act({key: seen[key] for key in observation(one)})
        assert np.array_equal(beside.features.picture, alone.features.picture)
    settings = DANGER_ROUNDS.policy_settings(folder)
    assert load_danger(folder, "own", resolve("quick", settings)).senses == ("odometry", "gyro")


def test_a_policy_of_another_camera_is_refused_and_a_level_replaces_its_own(folder: Path):
    config = small_config()
    saved(folder, config)
    with pytest.raises(PolicyError, match="width_px"):
        load_danger(folder, "own", small_config("cameras.0.width_px=40"))
    assert load_danger(folder, "own", config, 0.7).rule.threshold == 0.7
    assert load_danger(folder, "own", config).rule == RULE
