"""Danger networks on disk."""

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from tests.agents.danger.sights import all_of, lectures, small_config
from wcsim.agents.danger.network import DangerNet, channels_last, spec_of
from wcsim.agents.danger.policy import load_danger, load_net, save_danger
from wcsim.agents.runs.policy_file import POLICY_JSON, WEIGHTS
from wcsim.config import RunConfig
from wcsim.config.run_file import DangerRuleSettings
from wcsim.core import files
from wcsim.errors import PolicyError

RULE = DangerRuleSettings(threshold=0.2, warn=0.6)
EYES = (
    (),
    ("danger.eye=both", "learn.network=conv3d", "env.window=2"),
    ("danger.eye=picture", "learn.network=patch"),
)


def saved(folder: Path, config: RunConfig) -> DangerNet:
    torch.manual_seed(3)
    net = channels_last(DangerNet(spec_of(config))).eval()
    save_danger(folder, net, RULE, config)
    return net


@pytest.mark.parametrize("words", EYES, ids=str)
def test_a_network_comes_back_as_it_was_saved(tmp_path: Path, words: tuple[str, ...]):
    config = small_config(*words)
    net = saved(tmp_path / "p", config)
    again, rule = load_net(tmp_path / "p")
    lessons = lectures(config, 8)
    batch = lessons.batch(all_of(lessons))
    assert all(getattr(again.spec, part) == value for part, value in net.spec) and rule == RULE
    assert torch.equal(again(*batch.inputs), net(*batch.inputs))


def reseal(folder: Path) -> None:
    told = json.loads((folder / POLICY_JSON).read_text())
    told["weights_sha256"] = files.sha256_from_file(folder / WEIGHTS)
    (folder / POLICY_JSON).write_text(json.dumps(told))


def test_weights_that_are_not_those_of_the_description_are_refused(tmp_path: Path):
    folder = tmp_path / "p"
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
        *(("eye", "ear"), ("window", 0), ("width", 10**9), ("network", "no/name")),
        *((part, 7) for part in ("schema_version", "algorithm", "net", "rule", "weights_sha256")),
    ],
)
def test_a_description_out_of_bounds_is_refused(tmp_path: Path, key: str, value: object):
    saved(tmp_path / "p", small_config())
    path = tmp_path / "p" / POLICY_JSON
    told = json.loads(path.read_text())
    (told if key in told else told["net"])[key] = value
    path.write_text(json.dumps(told))
    with pytest.raises(PolicyError, match=key):
        load_net(tmp_path / "p")


def test_somebody_elses_class_is_loaded_for_those_who_name_it_alone(tmp_path: Path):
    config = small_config("danger.eye=picture", "learn.network=patch")
    saved(tmp_path / "p", config)
    path = tmp_path / "p" / POLICY_JSON
    told = json.loads(path.read_text())
    told["net"]["network"] = "wcsim.agents.networks.convolutional:PatchNet"
    path.write_text(json.dumps(told))
    with pytest.raises(PolicyError, match="--network"):
        load_net(tmp_path / "p")
    assert load_net(tmp_path / "p", told["net"]["network"])[0].spec.net.network == told["net"]["network"]


def test_a_policy_of_another_camera_is_refused_and_a_level_replaces_its_own(tmp_path: Path):
    config = small_config()
    saved(tmp_path / "p", config)
    with pytest.raises(PolicyError, match="width_px"):
        load_danger(tmp_path / "p", "own", small_config("cameras.0.width_px=40"))
    assert load_danger(tmp_path / "p", "own", config, 0.7).rule.threshold == 0.7
    assert load_danger(tmp_path / "p", "own", config).rule == RULE
