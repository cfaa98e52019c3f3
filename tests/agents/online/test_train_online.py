"""A danger network that learns as it drives, in the toy street: files, resume, and what it has learned."""

from __future__ import annotations

import errno
import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

from tests.agents.danger.sights import a_segment, small_config
from tests.agents.toy import ToyStreet, a_run, full_once, stopped_while_away, toy_camera
from wcsim.agents.collecting.data_folder import (
    DATA,
    key_of,
    read_manifest,
    read_segment,
    segment_path,
    write_segment,
)
from wcsim.agents.collecting.drive_segment import DrivenRow
from wcsim.agents.collecting.segment import FOLLOW, NETWORK, RECKLESS, SegmentKey
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.lessons import Lectures, lessons_of
from wcsim.agents.danger.saved import load_danger
from wcsim.agents.envs.episode_view import EpisodeStep
from wcsim.agents.learning.checkpoint_file import step_folders
from wcsim.agents.learning.extend import extend
from wcsim.agents.learning.phases import LearningPhase
from wcsim.agents.learning.watching.metrics import read_metrics
from wcsim.agents.online.agent import DrivingTurn, OnlineAgent
from wcsim.agents.online.taught_ride import TaughtRide
from wcsim.agents.online.train_online import Listeners, train_online
from wcsim.agents.runs.run_folder import open_run
from wcsim.config import RunConfig, with_overrides
from wcsim.core import files
from wcsim.errors import DiskFullError, InterruptedRunError, PolicyError, ServerGoneError

CAMERA = toy_camera(16, 20)
WORDS = (
    *("learn.head=danger", "learn.total_steps=240", "learn.phase1_steps=80", "learn.learning_starts=20"),
    *("learn.checkpoint_every=60", "learn.replay_frames=200", "learn.train_every=4", "learn.epsilon_start=0.5"),
    *("learn.epsilon_end=0.5", "danger.batch=8", "danger.width=4", "danger.roll_out=false", "danger.context=false"),
)


def config(*words: str) -> RunConfig:
    return with_overrides(RunConfig(cameras=(CAMERA,)), (*WORDS, *words))


class Sensing(gym.Wrapper):
    """The toy street with odometry, turn rates, and an oracle that fears to drive ahead where something is near."""

    def __init__(self, at: int = -1, call=lambda: None) -> None:
        super().__init__(ToyStreet(CAMERA, max_steps=30))
        unit = gym.spaces.Box(-1.0, 1.0, (8,), np.float32)
        spaces = {**self.env.observation_space.spaces, "imu": unit}
        self.observation_space = gym.spaces.Dict({**spaces, "odometry": gym.spaces.Box(-1.0, 1.0, (2,), np.float32)})
        self.at, self.call, self.steps, self.seeds = at, call, 0, []

    def reset(self, *, seed=None, options=None):
        self.seeds.append(seed)
        return self._told(*self.env.reset(seed=seed, options=options))

    def step(self, action):
        self.steps += 1
        if self.steps == self.at:
            self.call()
        seen, *rest, info = self.env.step(action)
        seen, info = self._told(seen, info)
        return (seen, *rest, info)

    def _told(self, seen, info):
        street = self.env
        turns = np.array([0.0, 0.0, street.w / 4.0], np.float32)
        odometry = np.array([street.v / 4.0, street.w / 4.0], np.float32)
        first_s = np.full(81, np.inf)
        if street.clearance() < 1.5:
            first_s[street.actions.points[:, 1] > 0.0] = 0.3
        truth = replace(info["truth"], first_s=first_s)
        return {**seen, "imu": np.concatenate([seen["imu"], turns]), "odometry": odometry}, {**info, "truth": truth}


def comparable(path: Path) -> list[dict[str, str]]:
    return [{k: v for k, v in row.items() if k != "elapsed_s_wall"} for row in read_metrics(path / "metrics.csv")]


def weights(path: Path, stage: str = "final") -> bytes:
    return (path / "policies" / stage / "weights.safetensors").read_bytes()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    torch.set_num_threads(1)
    seen = []
    out = tmp_path_factory.mktemp("online") / "run"
    path = train_online(
        a_run(config(), out, 5, town="toy", town_sha256="0" * 64), Sensing, Listeners(progress=seen.append)
    )
    return path, seen


def test_a_run_leaves_what_one_of_q_learning_leaves(run):
    path, seen = run
    opened = open_run(path)
    assert (opened.manifest.status, opened.manifest.steps) == ("done", 240)
    events = [json.loads(line)["event"] for line in (path / "events.jsonl").read_text().splitlines()]
    assert events == ["checkpoint", "phase2", "checkpoint", "checkpoint", "checkpoint", "done"]
    assert [folder.name for folder in step_folders(path / "checkpoints")] == [f"step-{k:08d}" for k in (120, 180, 240)]
    rows = read_metrics(path / "metrics.csv")
    assert sum(int(row["length"]) for row in rows) == int(rows[-1]["step"])
    assert {row["phase"] for row in rows} == {"1", "2"} and float(rows[0]["kpi1"]) <= 0.1768
    assert rows[0]["kpi1_greedy"] and int(rows[-1]["updates"]) > 40 and float(rows[-1]["loss"]) < 1.0
    assert seen[-1].step == 240 and [p.phase for p in seen] == sorted(p.phase for p in seen)
    assert weights(path) != weights(path, "phase1")


def test_its_policy_is_of_the_same_kind_as_that_of_rounds(run):
    policy = load_danger(run[0] / "policies" / "final", "own", config(), 0.2)
    street = Sensing()
    seen, _ = street.reset(seed=1)
    policy.reset()
    for _ in range(5):
        seen, *_ = street.step(policy.act(seen))
    assert policy.rule.threshold == 0.2


def test_what_was_driven_is_a_data_folder_by_the_user_and_then_by_the_network(run):
    folder = run[0] / DATA
    told = read_manifest(folder)
    segments = [read_segment(folder / "segments" / name, sha) for name, sha in sorted(told.segments.items())]
    drivers = np.concatenate([segment.driver for segment in segments])
    assert len(drivers) == 240 and set(drivers[:80].tolist()) == {FOLLOW}
    assert {NETWORK, RECKLESS} == set(drivers[80:].tolist())
    assert any((segment.visible != 255).any() for segment in segments)
    lessons = Lectures(config())
    for segment in segments:
        lessons.add(lessons_of(segment, config()))
    assert len(lessons) == 240 and lessons.tight_share > 0.02


def test_equal_seeds_give_equal_weights(run, tmp_path):
    again = train_online(a_run(config(), tmp_path / "b", 5, town="toy", town_sha256="0" * 64), Sensing)
    assert weights(again) == weights(run[0]) and comparable(again) == comparable(run[0])


def test_a_run_that_was_stopped_goes_on_in_a_new_world(tmp_path):
    out = tmp_path / "run"
    asked = a_run(config(), out, 5, town="toy", town_sha256="0" * 64)
    with pytest.raises(InterruptedRunError, match="--resume"):
        train_online(asked, lambda: Sensing(at=150, call=lambda: os.kill(os.getpid(), signal.SIGTERM)))
    assert open_run(out).manifest.status == "interrupted"
    newest = step_folders(out / "checkpoints")[-1]
    assert newest.name == "step-00000152"
    (newest / "weights.safetensors").write_bytes(b"torn")
    told, street = [], Sensing()
    train_online(replace(asked, resume=True), lambda: street, Listeners(say=told.append))
    assert "skipped" in told[0] and street.seeds[0] not in (None, 5)
    assert street.steps == 240 - 120 and open_run(out).manifest.steps == 240
    rows = read_metrics(out / "metrics.csv")
    assert [int(row["step"]) for row in rows] == sorted(int(row["step"]) for row in rows)
    assert sum(map(len, (read_segment(p) for p in sorted((out / DATA / "segments").iterdir())))) == 240


def test_a_run_whose_world_is_gone_keeps_what_it_has_learned(tmp_path):
    def fail():
        raise ServerGoneError("gone")

    with pytest.raises(ServerGoneError):
        train_online(a_run(config(), tmp_path / "run", 5, town_sha256="0" * 64), lambda: Sensing(at=31, call=fail))
    assert [folder.name for folder in step_folders(tmp_path / "run" / "checkpoints")] == ["step-00000030"]


def test_a_run_that_is_stopped_while_its_world_is_away_keeps_all_its_steps(tmp_path):
    waits = []
    asked = a_run(config(), tmp_path / "run", 5, town_sha256="0" * 64)
    listeners = Listeners(wait_no_more=lambda: waits.append(True))
    with pytest.raises(InterruptedRunError, match="--resume"):
        train_online(asked, lambda: Sensing(at=31, call=lambda: stopped_while_away(waits)), listeners)
    assert open_run(tmp_path / "run").manifest.status == "interrupted"
    assert [folder.name for folder in step_folders(tmp_path / "run" / "checkpoints")] == ["step-00000030"]


def test_a_disk_that_is_full_at_the_switch_costs_no_policy(run, tmp_path, monkeypatch):
    full_once(monkeypatch, "wcsim.agents.online.train_online.save_danger", "phase1")
    asked = a_run(config(), tmp_path / "run", 5, town="toy", town_sha256="0" * 64)
    with pytest.raises(DiskFullError, match=r"make room and --resume"):
        train_online(asked, Sensing)
    again = train_online(replace(asked, resume=True), Sensing)
    assert weights(again, "phase1") == weights(run[0], "phase1")


def test_a_disk_that_is_full_when_a_run_is_stopped_is_said(tmp_path, monkeypatch):
    def full(*given):
        raise OSError(errno.ENOSPC, "No space left on device")

    def stop():
        monkeypatch.setattr("wcsim.agents.online.train_online.save_online", full)
        os.kill(os.getpid(), signal.SIGTERM)

    asked = a_run(config(), tmp_path / "run", 5, town="toy", town_sha256="0" * 64)
    with pytest.raises(DiskFullError, match=r"stopped after 32 of 240 .*No space left.*--resume continues from"):
        train_online(asked, lambda: Sensing(at=31, call=stop))
    assert open_run(tmp_path / "run").manifest.status == "interrupted"


def test_exploration_lasts_and_some_of_it_is_executed_as_it_is():
    own = config("learn.epsilon_hold=4", "collect.reckless_share=0.5", "danger.threshold=0.01")
    net = DangerLearner(own, 1, 1).net  # it takes all for more dangerous than allowed
    agent, street = OnlineAgent(own, net, np.random.default_rng(2)), Sensing()
    seen, _ = street.reset(seed=1)
    agent.begin(0)
    found = [agent.choose(seen, DrivingTurn(phase=LearningPhase.AGENT_DRIVEN, epsilon=0.4)) for _ in range(200)]
    stick = np.asarray(seen["joystick"], np.float64)
    explores = np.array([not np.array_equal(choice.wish, stick) for choice in found])
    assert 0.25 < explores.mean() < 0.55
    lengths = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], explores, [0]]))))[::2]
    assert (lengths[:-1] % 4 == 0).all()
    reckless = [choice for choice in found if choice.driver == RECKLESS]
    assert 0 < len(reckless) < explores.sum()
    assert all(choice.action == street.unwrapped.actions.nearest(choice.wish) for choice in reckless)
    still = [agent.choose(seen, DrivingTurn(phase=LearningPhase.AGENT_DRIVEN)) for _ in range(8)][4:]
    assert all(np.array_equal(choice.wish, stick) for choice in still)


def test_an_environment_that_tells_no_truth_is_refused(tmp_path):
    class Silent(Sensing):
        def _told(self, seen, info):
            seen, info = super()._told(seen, info)
            return seen, {**info, "truth": None}

    with pytest.raises(PolicyError, match=r"env\.truth=true"):
        train_online(a_run(config(), tmp_path / "run", 5), Silent)


def test_lessons_of_a_ride_are_those_of_its_segments(run, tmp_path):
    """What is learned while it drives is what is learned from the files, pictures of the window and labels too."""
    own = config("danger.eye=both", "learn.network=gru", "env.window=3", "danger.ahead=2")
    agent = OnlineAgent(own, DangerLearner(own, 1, 1).net, np.random.default_rng(0))
    ride, street = TaughtRide(own, tmp_path, 1), Sensing()
    seen, info = street.reset(seed=4)
    agent.begin(0)
    for _ in range(100):
        choice = agent.choose(seen, DrivingTurn(phase=LearningPhase.ACTION_DRIVEN))
        after, reward, crashed, truncated, told = street.step(choice.action)
        step = EpisodeStep(after, float(reward), crashed, truncated, told)
        ride.add(agent.sight, DrivenRow(seen=seen, said=info["truth"], choice=choice, step=step, delay=0))
        seen, info = after, told
        if step.done:
            seen, info = street.reset()
            agent.begin(0)
    ride.write()
    again = TaughtRide(own, tmp_path, 1)
    again.restore(ride.segments)
    live, written = (lectures._rows for lectures in (ride.lectures, again.lectures))
    assert 60 < len(live) <= len(written) == 100
    one, other = ride.lectures.batch(live[:60]), again.lectures.batch(written[:60])
    assert torch.equal(one.unsafe, other.unsafe) and one.unsafe.any()
    for left, right in zip(one.inputs, other.inputs, strict=True):
        assert torch.equal(left, right)
    assert files.sha256(tmp_path / "segments" / min(ride.segments)) == ride.segments[min(ride.segments)]


def test_only_the_newest_steps_are_kept_in_memory():
    lessons = Lectures(small_config())
    for seed in range(4):
        lessons.add(lessons_of(a_segment(10, seed), small_config()))
        lessons.keep_newest(20)
    assert len(lessons) == 20 and len(lessons._parts) == 2
    assert lessons.draw().unsafe.shape == (16, 81)


def test_a_run_none_of_whose_checkpoints_is_sound_is_refused_and_stays_as_it_is(tmp_path):
    out = tmp_path / "run"
    asked = a_run(config(), out, 5, town="toy", town_sha256="0" * 64)
    train_online(asked, Sensing)
    for folder in step_folders(out / "checkpoints"):
        (folder / "weights.safetensors").write_bytes(b"torn")
    before = {path: path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}
    extend(out, 300)
    with pytest.raises(PolicyError, match="no intact checkpoint that fits"):
        train_online(replace(asked, config=config("learn.total_steps=300"), resume=True), Sensing)
    assert all(path.read_bytes() == data for path, data in before.items() if path.name.endswith((".csv", ".zst")))
    assert len(step_folders(out / "checkpoints")) == 3


def test_a_long_ride_is_read_from_its_newest_end_alone(tmp_path):
    """Names are sorted by number: as text, segment 10000 would come before 9999."""
    ride, held = TaughtRide(small_config("learn.replay_frames=100"), tmp_path, 1), {}
    for index in (9998, 9999, 10_000):
        path = segment_path(tmp_path, SegmentKey(run=1, round=0, index=index))
        held[path.name] = write_segment(path, a_segment(60, index))
    (tmp_path / "segments" / min(held, key=lambda name: key_of(name).index)).write_bytes(b"not read")
    ride.restore(held)
    assert len(ride.lectures) == 120 and ride.segments == held
    older, newer = (part.unsafe for part in ride.lectures._parts.values())
    expected = [lessons_of(a_segment(60, index), small_config()).unsafe for index in (9999, 10_000)]
    assert np.array_equal(older, expected[0]) and np.array_equal(newer, expected[1])
