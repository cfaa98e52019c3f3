"""A run that is to be longer than it was made for, and a process that ends while that is written."""

import pytest

from tests.support.one_process import die_after
from wcsim.agents.runs.run_folder import create_run_folder, make_run_manifest, open_run
from wcsim.cli.main import main
from wcsim.cli.shared.run_config import settings_from_learner
from wcsim.cli.training.resume import _Options, _resumed
from wcsim.config import RunConfig, resolve
from wcsim.errors import PolicyError
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.town import streets_hash


@pytest.fixture
def run(tmp_path, corner, corner_town):
    command = ("wcsim", "train-q", "--town", str(corner))
    info = RunInfo(seed=1, town="corner", town_sha256=streets_hash(corner_town), command=command)
    config = RunConfig.model_validate({"learn": {"total_steps": 100}})
    return create_run_folder(tmp_path / "run", config, make_run_manifest(config, info)).path


def steps_of(path, steps=None):
    run, _ = _resumed(_Options(run=path, steps=steps))
    return run.config.learn.total_steps


def test_a_run_can_be_longer_and_not_shorter(run):
    assert steps_of(run) == 100 and steps_of(run, 300) == 300 and steps_of(run) == 300
    with pytest.raises(PolicyError, match="made for 300"):
        steps_of(run, 200)


@pytest.mark.parametrize("written", [0, 1, 2])
def test_a_process_that_ends_between_two_files_leaves_a_run_that_goes_on(run, monkeypatch, written):
    with monkeypatch.context() as dying:
        die_after(dying, written)
        with pytest.raises(KeyboardInterrupt):
            steps_of(run, 300)
    assert steps_of(run) == (100 if written < 2 else 300)
    open_run(run).with_status("running", 0)
    assert steps_of(run) == (100 if written < 2 else 300)
    assert steps_of(run, 300) == steps_of(run) == 300


def test_a_run_goes_on_without_options_that_it_would_not_hear_of(corner, corner_town, tmp_path, capsys):
    info = RunInfo(seed=1, town=str(corner), town_sha256=streets_hash(corner_town))
    refused = {"quick": ("--steps 40000", "learns in 2 rounds"), "dqn": ("--cluster local", "learns from every step")}
    for preset, (typed, told) in refused.items():
        config = resolve(resolve(preset), settings_from_learner(resolve(preset)))
        create_run_folder(tmp_path / preset, config, make_run_manifest(config, info))
        assert main(["resume", str(tmp_path / preset), *typed.split()]) == 2
        assert told in capsys.readouterr().err
        assert open_run(tmp_path / preset).config == config


def test_a_run_of_wcsim_join_is_told_to_join_again(run):
    joined = make_run_manifest(RunConfig(), RunInfo(seed=1, command=("wcsim", "join", "ipc:///x")))
    path = create_run_folder(run.parent / "joined", RunConfig(), joined).path
    with pytest.raises(PolicyError, match="wcsim join ipc:///x --resume"):
        _resumed(_Options(run=path))


def test_folders_of_data_are_kept_by_their_whole_path(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = resolve(open_run(run).config, 'collect.data=["mine"]')
    config = resolve(config, settings_from_learner(config))
    assert config.collect.data == (str(tmp_path / "mine"),)
    monkeypatch.chdir(tmp_path.parent)
    assert resolve(config, settings_from_learner(config)) == config
