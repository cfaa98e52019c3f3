"""How the options of a command become the run that is made: each setting is decided once, and in this order."""

from dataclasses import replace

import pytest

from tests.cli.training.test_clients import q_config
from wcsim.agents.opening.learner_registry import DANGER_ROUNDS, Q_LEARNING
from wcsim.cli.shared.run_config import (
    list_sumo_overrides,
    require_matching_learner,
    require_usable_policy,
    resolve_run_settings,
    settings_from_learner,
)
from wcsim.cli.training.train import _QLearningOptions
from wcsim.config import resolve
from wcsim.errors import ConfigError, PolicyError
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.town import streets_hash

INFO = RunInfo(seed=3, command=("wcsim", "train"))


def test_what_is_laid_over_what(tmp_path):
    file, own = tmp_path / "a.toml", tmp_path / "own.toml"
    file.write_text('[learn]\ngamma = 0.1\nbatch_size = 9\nnetwork = "convlstm"\ntotal_steps = 77\n')
    own.write_text("[learn]\nbatch_size = 11\n")
    asked = _QLearningOptions(config=file, set=("learn.gamma=0.5",), steps=60)
    learn = q_config(asked, "fig6").learn
    assert (learn.gamma, learn.batch_size, learn.network, learn.total_steps) == (0.5, 9, "fig6", 60)
    assert q_config(asked).learn.network == "convlstm"
    assert q_config(asked, "fig6", None, own).learn == learn.model_copy(update={"batch_size": 11})


def test_a_run_is_learned_with_episodes_of_its_own_length():
    config = q_config(_QLearningOptions(set=("learn.episode_steps=123", "learn.aid=oracle")))
    assert (config.env.max_steps, config.env.truth) == (123, True)
    assert config == resolve(config, settings_from_learner(config))


def test_a_resolved_run_says_all_of_its_town_and_its_network_and_nothing_is_left_to_do(corner_town, tmp_path):
    config = q_config(_QLearningOptions(), "fig6")
    assert config.env.window is None
    run = resolve_run_settings(config, INFO, corner_town, tmp_path / "run")
    assert run.config == config.model_copy(update={"env": config.env.model_copy(update={"window": 4})})
    assert run.info.overrides == list_sumo_overrides(corner_town, config, 3) != ()
    told = replace(INFO, town=corner_town.name, town_sha256=streets_hash(corner_town))
    assert replace(run.info, overrides=()) == told
    assert resolve_run_settings(run.config, run.info, corner_town, run.out) == run
    assert not run.out.exists()


def test_what_cannot_be_used_is_refused(corner_town, tmp_path):
    config = resolve("quick")
    (tmp_path / "file").write_text("mine")
    for info, out, error in (
        (INFO, tmp_path / "file", ConfigError),
        (replace(INFO, rewards=("nonesuch:Term",)), tmp_path / "run", PolicyError),
    ):
        with pytest.raises(error):
            resolve_run_settings(config, info, corner_town, out)


def test_what_needs_pytorch_says_so_before_a_street_is_built(monkeypatch):
    monkeypatch.setattr("wcsim.errors.find_spec", lambda name: None)
    require_usable_policy("shipped", "")
    with pytest.raises(PolicyError, match=r"needs PyTorch.*pip install 'wcsim\[train\]'"):
        require_usable_policy("shipped@0.3", "")


def test_each_command_refuses_the_other_kind_of_learning():
    for preset, own, other, told in (
        ("quick", DANGER_ROUNDS, Q_LEARNING, "preset dqn or paper"),
        ("dqn", Q_LEARNING, DANGER_ROUNDS, "preset quick, laptop"),
    ):
        require_matching_learner(resolve(preset), own)
        with pytest.raises(ConfigError, match=told):
            require_matching_learner(resolve(preset), other)


def test_a_first_phase_that_the_user_gave_is_taken_as_it_is(tmp_path):
    file = tmp_path / "own.toml"
    file.write_text("[learn]\nphase1_steps = 900\n")

    def phases(own=None, **said):
        learn = q_config(_QLearningOptions(preset="paper", steps=900, **said), "", None, own).learn
        return learn.phase1_steps, learn.learning_starts

    by_preset = phases()
    assert by_preset[0] <= 450
    assert phases(set=("learn.phase1_steps=900",)) == (900, by_preset[1])
    assert phases(set=("learn={phase1_steps=900, learning_starts=800}",)) == (900, 800)
    assert phases(config=file) == phases(file) == (900, by_preset[1])
