import csv
import errno
import json
import shutil
import signal
from dataclasses import replace
from itertools import count
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.callbacks import CheckpointCallback, EvalCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

import wcsim
from tests.agents.toy import CutStreet, ToyStreet, a_run, full_once, q_config, toy_camera, train_toy
from tests.support.events import read_events
from wcsim.agents.learning.build import build_q_learner
from wcsim.agents.learning.checkpoint import _generator_state, _restored_generator
from wcsim.agents.learning.saved_policy import load_policy
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.learning.train import train_dqn
from wcsim.agents.opening.named_policy import open_named_policy, resolve_policy_config
from wcsim.agents.runs.metrics import COLUMNS, STEP_COLUMNS, MetricsFile, read_metrics
from wcsim.agents.runs.run_folder import (
    create_run_folder,
    make_run_manifest,
    open_run,
    policy_folder_from_name,
    run_from_policy_name,
)
from wcsim.config import RunConfig, resolve
from wcsim.core import files
from wcsim.errors import ConfigError, DiskFullError, InterruptedRunError, PolicyError
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.overrides import Override

CAMERA = toy_camera(16, 20)
INFO = RunInfo(seed=1, town="t", town_sha256="ab", command=("wcsim", "train"))


def config(**learn):
    small = {
        "total_steps": 240, "phase1_steps": 80, "learning_starts": 20, "replay_frames": 200, "batch_size": 8,
        "checkpoint_every": 60,
    }  # fmt: skip
    return q_config(CAMERA, **{**small, **learn})


class Nervous(gym.Wrapper):
    """Calls something once, at a certain step."""

    def __init__(self, at, call, env=None):
        super().__init__(env or street())
        self.at, self.call, self.done_steps, self.seeds = at, call, 0, []

    def reset(self, *, seed=None, options=None):
        self.seeds.append(seed)
        return super().reset(seed=seed, options=options)

    def step(self, action):
        self.done_steps += 1
        if self.done_steps == self.at:
            self.call()
        return super().step(action)


def street():
    return ToyStreet(CAMERA, max_steps=30)


def comparable(path):
    """metrics.csv without the wall-clock columns."""
    rows = read_metrics(path / "metrics.csv")
    return [{k: v for k, v in row.items() if not k.endswith("_s_wall")} for row in rows]


def weights(path, stage="final"):
    return (path / "policies" / stage / "weights.safetensors").read_bytes()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    seen, heard = [], []
    asked = a_run(config(), tmp_path_factory.mktemp("a") / "run", 5, town="toy", town_sha256="00")
    path = train_dqn(asked, street, seen.append, alive=lambda: heard.append(len(list(asked.out.rglob("step-*")))))
    return path, seen, heard


def test_a_run_folder_says_everything(run):
    path, seen, _ = run
    names = {"manifest.json", "config.json", "metrics.csv", "steps.csv", "events.jsonl", "checkpoints", "policies"}
    assert {p.name for p in path.iterdir()} == names
    opened = open_run(path)
    assert opened.config == config()
    assert (opened.manifest.status, opened.manifest.steps, opened.manifest.seed) == ("done", 240, 5)
    assert opened.manifest.config_sha256 == config().digest()
    events = read_events(path)
    assert [e["event"] for e in events] == ["checkpoint", "phase2", "checkpoint", "checkpoint", "checkpoint", "done"]
    assert seen[-1].step == 240
    assert [p.phase for p in seen] == sorted(p.phase for p in seen)
    rows = read_metrics(path / "metrics.csv")
    assert sum(int(row["length"]) for row in rows) == int(rows[-1]["step"])
    assert seen[-1].episodes == len(rows)
    assert seen[-1].crashes == sum(int(row["crashed"]) for row in rows)
    assert float(rows[0]["kpi1"]) <= 0.1768  # the user's own action is executed first
    steps = read_metrics(path / "steps.csv", STEP_COLUMNS)
    assert [(row["step"], row["phase"]) for row in steps] == [("100", "2"), ("200", "2")]
    assert seen[-1].kpi1 == pytest.approx(sum(float(row["kpi1_greedy"]) for row in steps) / 2, abs=1e-5)
    assert sorted(p.name for p in (path / "checkpoints").glob("step*")) == [f"step-{k:08d}" for k in (120, 180, 240)]


def test_an_episode_that_its_world_cut_says_so_and_counts_no_step_that_nobody_drove(tmp_path):
    path = train_toy(config(total_steps=120), tmp_path / "run", lambda: CutStreet(75, CAMERA, max_steps=1000))
    rows = read_metrics(path / "metrics.csv")
    (cut,) = (row for row in rows if row["cut"] == "1")
    assert int(cut["step"]) == 75 and cut["crashed"] == "0"
    assert sum(int(row["length"]) for row in rows if int(row["step"]) <= 75) == 74


def test_work_is_saved_by_wall_time(tmp_path, monkeypatch):
    """Weights every 60 s, weights and replay every 900 s; here each reading of the clock is 10 s later."""
    clock = count(0, 10)
    monkeypatch.setattr("wcsim.agents.learning.train._now_s", lambda: float(next(clock)))
    path = train_toy(config(checkpoint_every=10**6), tmp_path / "run", street)
    events = read_events(path)
    kinds = [event["event"] for event in events if event["event"] in ("weights", "checkpoint")]
    assert kinds.count("weights") > 5 * kinds.count("checkpoint") > 0, kinds
    last = max(event["step"] for event in events if event["event"] == "weights")
    assert 240 - last <= 40


def test_both_policies_can_be_named(run):
    path, *_ = run
    assert policy_folder_from_name(str(path)) == policy_folder_from_name(f"{path}:final") == path / "policies" / "final"
    assert open_named_policy(f"{path}:phase1", config(), 0).name == f"{path}:phase1"
    assert weights(path) != weights(path, "phase1")
    assert load_policy(policy_folder_from_name(str(path))).file.manifest_sha256 == open_run(path).manifest_sha256()


def test_what_a_policy_was_made_with_can_be_asked(run, tmp_path):
    path, *_ = run
    for name in (str(path), f"{path}:phase1", str(path / "policies" / "final")):
        assert run_from_policy_name(name) == open_run(path)
        assert resolve_policy_config(name, "dqn", ("learn.gamma=0.5",)).learn == config(gamma=0.5).learn
    shutil.copytree(path / "policies" / "final", tmp_path / "copy")
    assert run_from_policy_name(str(tmp_path / "copy")) is None
    alone = resolve_policy_config(str(tmp_path / "copy"), "dqn", ("env.max_steps=7",))
    assert (alone.cameras, alone.env.max_steps) == ((CAMERA,), 7)
    assert open_named_policy(str(tmp_path / "copy"), alone, 0).name == str(tmp_path / "copy")
    with pytest.raises(PolicyError, match="20x16 images"):
        open_named_policy(str(path), RunConfig(), 0)


def test_equal_seeds_give_equal_runs_and_other_seeds_do_not(run, tmp_path):
    path, *_ = run
    again = train_toy(config(), tmp_path / "again", street)
    other = train_toy(config(), tmp_path / "other", street, seed=6)
    assert weights(path) == weights(again) != weights(other)
    assert comparable(path) == comparable(again) != comparable(other)
    assert not torch.are_deterministic_algorithms_enabled()


def test_a_checkpoint_is_heard_of_while_it_is_written(run):
    _, _, heard = run
    written = config().learn.total_steps // config().learn.checkpoint_every
    assert len(heard) >= 2 * written
    assert heard[0] == 0, "before the first one was whole"


@pytest.mark.parametrize("stop", ["exception", "signal"])
def test_an_interrupted_run_is_usable_and_can_be_continued(stop, tmp_path):
    def interrupt():
        if stop == "exception":
            raise KeyboardInterrupt
        signal.raise_signal(signal.SIGINT)

    env, before = Nervous(150, interrupt), signal.getsignal(signal.SIGINT)
    with pytest.raises(InterruptedRunError, match="wcsim resume"):
        train_toy(config(), tmp_path / "run", lambda: env)
    path = tmp_path / "run"
    first = open_run(path).manifest
    assert (first.status, first.steps) == ("interrupted", 149 if stop == "exception" else 152)
    assert load_policy(policy_folder_from_name(f"{path}:phase1")).act(street().reset(seed=0)[0]) in range(81)
    assert load_policy(policy_folder_from_name(str(path))).act(street().reset(seed=0)[0]) in range(81)
    assert signal.getsignal(signal.SIGINT) is before  # ignored, when the tests run in a shell's background

    follower = Nervous(-1, interrupt)
    train_toy(config(), path, lambda: follower, resume=True)
    done = open_run(path).manifest
    assert (done.status, done.steps) == ("done", 240)
    # What was torn out of a step goes on from the last checkpoint, what was asked to stop from where it stopped.
    assert follower.done_steps == 240 - (120 if stop == "exception" else 152)
    assert follower.seeds[0] not in (None, 5)  # a new segment has a seed of its own
    steps = [int(row["step"]) for row in read_metrics(path / "metrics.csv")]
    assert steps == sorted(set(steps))
    assert [int(r["episode"]) for r in read_metrics(path / "metrics.csv")] == list(range(1, len(steps) + 1))


def test_the_first_decision_of_a_sitting_explores_as_any_other(tmp_path, monkeypatch):
    rates, draw = [], SeqDQN._draw_explorers
    monkeypatch.setattr(SeqDQN, "_draw_explorers", lambda self, n: rates.append(self.exploration_rate) or draw(self, n))
    always = {"phase1_steps": 0, "epsilon_start": 0.7, "epsilon_end": 0.7}
    asked = a_run(config(total_steps=60, **always), tmp_path / "run", 5)
    with pytest.raises(InterruptedRunError):
        train_dqn(asked, lambda: Nervous(30, lambda: signal.raise_signal(signal.SIGINT)))
    train_dqn(replace(asked, resume=True), street)
    assert rates == [pytest.approx(0.7)] * 60


def test_a_reward_that_the_environment_refuses_ends_the_run_and_it_goes_on_without_it(tmp_path):
    """As a term that is not finite: kept, it would be in every tenth batch of this memory, and in the returns of five
    steps."""

    def refuse():
        raise ConfigError("reward term Broken returned nan")

    asked = config(total_steps=120, phase1_steps=40, checkpoint_every=30)
    assert asked.learn.n_step > 1
    with pytest.raises(ConfigError, match="Broken returned nan"):
        train_toy(asked, tmp_path / "run", lambda: Nervous(70, refuse))
    train_toy(asked, tmp_path / "run", street, resume=True)
    assert open_run(tmp_path / "run").manifest.status == "done"
    assert all(row["loss"] and row["return"] for row in read_metrics(tmp_path / "run" / "metrics.csv")[2:])


@pytest.mark.parametrize("value, told", [(1e6, 1e6), (float("inf"), "inf")])
def test_values_beyond_all_returns_are_said_once(value, told, tmp_path, monkeypatch):
    monkeypatch.setattr(SeqDQN, "_update", lambda self, loss: setattr(self, "max_abs_q", value))
    short = config(total_steps=60, phase1_steps=20, checkpoint_every=20)
    run = train_toy(short, tmp_path / "run", street)
    events = read_events(run)
    assert [event["max_abs_q"] for event in events if event["event"] == "q_alarm"] == [told]
    assert open_run(run).manifest.status == "done"


def test_a_disk_that_is_full_at_the_switch_costs_no_policy(run, tmp_path, monkeypatch):
    full_once(monkeypatch, "wcsim.agents.learning.train.save_policy", "phase1")
    asked = a_run(config(total_steps=100), tmp_path / "run", 5, town="toy", town_sha256="00")
    with pytest.raises(DiskFullError, match=r"make room, then continue: wcsim resume"):
        train_dqn(asked, street)
    again = train_dqn(replace(asked, resume=True), street)
    assert weights(again, "phase1") == weights(run[0], "phase1")


def test_a_disk_that_is_full_when_a_run_is_stopped_is_said(tmp_path, monkeypatch):
    def full(*given, **named):
        raise OSError(errno.ENOSPC, "No space left on device")

    def stop():
        monkeypatch.setattr("wcsim.agents.learning.train.save_checkpoint", full)
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(DiskFullError, match=r"stopped after 32 of 60 .*No space left.*wcsim resume .* continues from"):
        train_toy(config(total_steps=60, phase1_steps=20), tmp_path / "run", lambda: Nervous(30, stop))
    assert open_run(tmp_path / "run").manifest.status == "interrupted"


def test_wrong_folders_are_explained(run, tmp_path):
    path, *_ = run
    with pytest.raises(PolicyError, match="not empty"):
        train_toy(config(), path, street)
    with pytest.raises(PolicyError, match="not a run"):
        open_run(tmp_path)
    with pytest.raises(PolicyError, match="another configuration"):
        train_dqn(a_run(config(gamma=0.5), path, 5, town="toy", town_sha256="00", resume=True), street)
    with pytest.raises(PolicyError, match="another town_sha256"):
        train_dqn(a_run(config(), path, 5, town="other", town_sha256="01", resume=True), street)
    with pytest.raises(PolicyError, match="another rewards"):
        train_dqn(a_run(config(), path, 5, town="toy", town_sha256="00", rewards=("a:B",), resume=True), street)
    with pytest.raises(PolicyError, match="unknown stage"):
        policy_folder_from_name(f"{path}:best")
    fresh = create_run_folder(tmp_path / "new", config(), make_run_manifest(config(), RunInfo(seed=1, town="t")))
    with pytest.raises(PolicyError, match="it has: none"):
        policy_folder_from_name(str(fresh.path))
    (fresh.path / "manifest.json").write_text("{")
    with pytest.raises(PolicyError, match=r"is not JSON.*train again"):
        open_run(fresh.path)


def test_a_network_that_does_not_exist_leaves_a_clear_error(tmp_path):
    with pytest.raises(PolicyError, match="expected one of"):
        train_toy(config(network="enormous"), tmp_path / "run", street, seed=0)


def test_a_run_of_one_phase_has_both_policies(tmp_path):
    path = train_toy(config(total_steps=60, phase1_steps=60), tmp_path / "run", street, seed=0)
    assert weights(path) == weights(path, "phase1")


def test_callbacks_of_stable_baselines3_run_beside_wcsim_s_own_and_what_they_save_is_loaded(run, tmp_path):
    judge = EvalCallback(
        Monitor(street()), eval_freq=60, n_eval_episodes=1, verbose=0, log_path=str(tmp_path / "judged"),
        best_model_save_path=str(tmp_path / "best"),
    )  # fmt: skip
    keep = CheckpointCallback(100, str(tmp_path / "kept"))
    watched = train_toy(config(), tmp_path / "run", street, callbacks=(judge, keep))
    assert list(np.load(tmp_path / "judged" / "evaluations.npz")["timesteps"]) == [60, 120, 180, 240]
    assert {path.name for path in (tmp_path / "kept").iterdir()} == {f"rl_model_{k}_steps.zip" for k in (100, 200)}
    seen = street().reset(seed=2)[0]
    for path in (tmp_path / "best" / "best_model.zip", tmp_path / "kept" / "rl_model_200_steps.zip"):
        again = SeqDQN.load(path, env=DummyVecEnv([street]), device="cpu")
        action, _ = again.predict({key: value[None] for key, value in seen.items()}, deterministic=True)
        before = again.num_timesteps
        assert before > 0 and 0 <= int(action[0]) < 81
        assert again.learn(20, reset_num_timesteps=False).num_timesteps == before + 20
    assert weights(watched) == weights(run[0])  # they change nothing


# --- the parts ---


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(0, 50))
def test_generators_survive_json(seed, draws):
    rng = np.random.Generator(np.random.Philox(seed))
    rng.integers(0, 7, draws)
    rng.random(draws, dtype=np.float32)
    twin = _restored_generator(json.loads(json.dumps(_generator_state(rng))))
    assert np.array_equal(rng.normal(size=9), twin.normal(size=9))
    assert np.array_equal(rng.integers(0, 9, 9, dtype=np.int32), twin.integers(0, 9, 9, dtype=np.int32))


def test_metrics_drop_lost_rows_and_torn_lines(tmp_path):
    path = tmp_path / "metrics.csv"
    metrics = MetricsFile(path)
    for step in (10, 20, 30):
        metrics.add({**dict.fromkeys(COLUMNS), "step": step, "loss": float("nan"), "return": 0.5})
    assert [row["step"] for row in read_metrics(path)] == ["10", "20", "30"]
    assert read_metrics(path)[0]["loss"] == ""
    with path.open("a") as file:
        file.write("40,,,,,,,,,,,,,,,,,,,,,\n" * 70_000 + "40,4,")  # more than a report would read
    MetricsFile(path, last_step=20)
    with path.open(newline="") as file:
        assert [row["step"] for row in csv.DictReader(file)] == ["10", "20"]
    path.write_text("a,b\n1,2\n")
    with pytest.raises(PolicyError, match="columns a, b"):
        read_metrics(path)


def test_a_folder_is_written_whole_or_not_at_all(tmp_path):
    target = tmp_path / "x"
    with files.write_folder_atomically(target) as folder:
        (folder / "a").write_text("1")
    with pytest.raises(RuntimeError), files.write_folder_atomically(target) as folder:
        (folder / "a").write_text("2")
        raise RuntimeError
    assert (target / "a").read_text() == "1"
    with files.write_folder_atomically(target) as folder:
        (folder / "b").write_text("3")
    assert [p.name for p in target.iterdir()] == ["b"]
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


def test_a_manifest_says_its_status_and_keeps_its_digest(tmp_path):
    run = create_run_folder(tmp_path / "r", config(), make_run_manifest(config(), INFO))
    digest = run.manifest_sha256()
    run = run.with_status("interrupted", 7)
    assert open_run(run.path).manifest == run.manifest == replace(run.manifest, status="interrupted", steps=7)
    assert run.manifest_sha256() == digest


def test_a_manifest_keeps_what_it_was_told(tmp_path):
    override = Override(option="--step-length", author="1", wcsim="0.1", why="ticks")
    told = replace(INFO, rewards=("a:B",), hook="c:D", overrides=(override,))
    run = create_run_folder(tmp_path / "r", config(), make_run_manifest(config(), told))
    assert open_run(run.path).manifest.info == run.manifest.info == told


def test_a_run_keeps_the_user_s_own_plant(tmp_path):
    own = tmp_path / "own.toml"
    own.write_bytes((Path(wcsim.__file__).parent / "config" / "plants" / "rwd.toml").read_bytes())
    wanted = resolve(config(), f"chair.plant={own}")
    run = create_run_folder(tmp_path / "r", wanted, make_run_manifest(wanted, INFO))
    text = own.read_bytes()
    own.unlink()
    kept = open_run(run.path).config.chair.plant
    assert kept == run.config.chair.plant != str(own)
    assert Path(kept).read_bytes() == text


def test_a_replay_beyond_the_memory_is_named(monkeypatch):
    def full(*words, **more):
        raise MemoryError

    monkeypatch.setattr("wcsim.agents.learning.build.SeqDQN", full)
    with pytest.raises(ConfigError, match=r"learn\.replay_frames=200 do not fit into memory"):
        build_q_learner(config(), ToyStreet(CAMERA), 0)
