"""Values on top of a danger network that stays as it is, in the toy street."""

from __future__ import annotations

import json
import shutil
import stat
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from tests.agents.online.test_train_online import Sensing
from tests.agents.online.test_train_online import config as danger_config
from tests.agents.toy import a_run
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.danger.rule import rule_of
from wcsim.agents.danger.saved import load_net, save_danger
from wcsim.agents.evaluation.matrix import open_policy
from wcsim.agents.evaluation.suite.named_policy import identity_of
from wcsim.agents.learning.build import build_model
from wcsim.agents.learning.callbacks import EpisodeMetrics, EpisodeSums
from wcsim.agents.learning.flip_augmentation import mirrored
from wcsim.agents.learning.saved_policy import load_policy
from wcsim.agents.learning.shielded import shielded_policy
from wcsim.agents.learning.shielded.danger_part import PART, codes_of_dangers, dangers_of_codes
from wcsim.agents.learning.shielded.danger_sense import DangerSense
from wcsim.agents.learning.shielded.shielded_dqn import ShieldedDQN
from wcsim.agents.learning.shielded.shielded_policy import ShieldedPolicy
from wcsim.agents.learning.train import train
from wcsim.agents.learning.watching.metrics import MetricsFile, read_metrics
from wcsim.agents.policy_api import DANGER_KEY
from wcsim.agents.runs.parcels import policy_parcel
from wcsim.agents.runs.policy_file import POLICY_JSON, WEIGHTS
from wcsim.config import RunConfig, with_overrides
from wcsim.core import files
from wcsim.errors import ConfigError, PolicyError
from wcsim.server.workers.cluster import bundle
from wcsim.supervisor.actions import action_set

ACTIONS = action_set("square81")


@pytest.fixture(scope="module")
def part(tmp_path_factory) -> Path:
    """A danger network that fears to drive ahead, whatever it sees."""
    own = danger_config()
    net = DangerLearner(own, 1, 1).net
    with torch.no_grad():
        net.direct[-1].bias.copy_(torch.as_tensor(8.0 * (ACTIONS.points[:, 1] > 0.5) - 1.0))
    return save_danger(tmp_path_factory.mktemp("part") / "danger", net, rule_of(own.danger), own)


def config(part: Path, *words: str) -> RunConfig:
    own = (
        *("learn.head=residual", f"learn.danger={part}", "learn.danger_weight=2", "learn.phase1_steps=40"),
        *("learn.total_steps=160", "learn.mirror=true", "learn.margin=0", "env.observe_gyro=true"),
        *("sensors.odometry=typical", "learn.network=patch", *words),
    )
    return with_overrides(danger_config(), own)


@pytest.fixture(scope="module")
def run(part, tmp_path_factory) -> Path:
    torch.set_num_threads(1)
    return train(a_run(config(part), tmp_path_factory.mktemp("shielded") / "run", 3), Sensing)


def weights_of(path: Path) -> bytes:
    return (path / WEIGHTS).read_bytes()


def test_it_trains_and_the_danger_network_stays_as_it_is_to_the_byte(run: Path, part: Path):
    for stage in ("phase1", "final"):
        folder = run / "policies" / stage
        assert weights_of(folder / PART) == weights_of(part) == weights_of(run / PART)
        assert (folder / PART / POLICY_JSON).read_bytes() == (part / POLICY_JSON).read_bytes()
    assert weights_of(run / "policies" / "final") != weights_of(run / "policies" / "phase1")
    rows = read_metrics(run / "metrics.csv")
    assert all(np.isfinite(float(row["loss"])) for row in rows if int(row["updates"])) and int(rows[-1]["updates"]) > 20


def test_whoever_may_read_a_policy_may_read_its_danger_network(run: Path):
    for folder in (run / PART, run / "policies" / "final" / PART):
        assert stat.S_IMODE(folder.stat().st_mode) & 0o111, "the right to enter it"
        assert {stat.S_IMODE(file.stat().st_mode) for file in folder.iterdir()} == {0o644}


def test_in_the_second_phase_nothing_unsafe_is_done_where_something_is_safe(run: Path, part: Path):
    policy, street = open_policy(str(run), config(part)), Sensing()
    assert isinstance(policy, ShieldedPolicy) and policy.senses == ("odometry", "gyro")
    seen, _ = street.reset(seed=2)
    policy.reset()
    for _ in range(20):
        action = policy.act(seen)
        assert ACTIONS.points[action][1] <= 0.5, "the network fears all that lies ahead"
        seen, _, crashed, *_ = street.step(action)
        if crashed:
            break
    assert isinstance(policy.warning, bool)


def test_it_travels_to_other_machines_with_its_danger_network(run: Path, part: Path, tmp_path: Path):
    parcel = policy_parcel(str(run))
    assert f"policies/final/{PART}/{POLICY_JSON}" in parcel.names
    node = tmp_path / "node"
    node.mkdir()
    bundle.unpack(bundle.packed(parcel), node)
    assert isinstance(open_policy(str(node / parcel.inner), config(part)), ShieldedPolicy)
    assert weights_of(node / parcel.inner / PART) == weights_of(part)
    bare = policy_parcel(str(shutil.copytree(run / "policies" / "final", tmp_path / "without" / "a" / "run")))
    assert f"{PART}/{WEIGHTS}" in bare.names and bare.inner == ""


def test_it_is_another_policy_where_its_danger_network_has_another_rule(run: Path, tmp_path: Path):
    folder = Path(shutil.copytree(run / "policies" / "final", tmp_path / "copy"))
    before = identity_of(str(folder), "dqn")
    file = folder / PART / POLICY_JSON
    file.write_text(file.read_text() + " ")
    assert identity_of(str(folder), "dqn") != before


def test_an_assistance_level_is_the_threshold_of_values_too(run: Path, part: Path):
    street = Sensing()
    seen, _ = street.reset(seed=2)
    bold, own = (open_policy(name, config(part)) for name in (f"{run}@1.0", str(run)))
    for policy in (bold, own):
        policy.reset()
    assert bold.level == 1.0 and own.level == 0.2
    assert own.act(seen) in range(81) and bold.act(seen) in range(81)


def test_it_goes_on_from_a_checkpoint_with_its_own_copy(part: Path, tmp_path: Path):
    from dataclasses import replace

    own = shutil.copytree(part, tmp_path / "own")
    asked = a_run(config(own, "learn.checkpoint_every=80"), tmp_path / "run", 3)
    calls = iter([None] * 100 + [KeyboardInterrupt])

    class Stops(Sensing):
        def step(self, action):
            if next(calls, None) is not None:
                raise KeyboardInterrupt
            return super().step(action)

    with pytest.raises(Exception, match="--resume"):
        train(asked, Stops)
    shutil.rmtree(own)
    out = train(replace(asked, resume=True), Sensing)
    assert weights_of(out / "policies" / "final" / PART) == weights_of(part)


def test_values_are_follow_reward_plus_learned_part_minus_dangers(part: Path):
    env = DangerSense(Sensing(), config(part), part)
    model = build_model(config(part), env, 1)
    assert isinstance(model, ShieldedDQN)
    seen, _ = env.reset(seed=1)
    batch = {key: torch.as_tensor(value)[None] for key, value in seen.items()}
    blank = {**batch, DANGER_KEY: torch.zeros_like(batch[DANGER_KEY])}
    with torch.no_grad():
        values, without = model.q_net(batch)[0], model.q_net(blank)[0]
    danger = dangers_of_codes(seen[DANGER_KEY])[0, 0]
    assert np.allclose((without - values).numpy(), 2.0 * danger, atol=1e-5) and danger.max() > 0.9
    follow = model.q_net.follow_reward(batch["joystick"])[0]
    learned = without - follow
    assert (learned - learned.mean()).abs().max() < 0.05, "F is small at first"
    action, _ = model.predict(seen, deterministic=True)
    assert ACTIONS.points[int(action)][1] <= 0.5
    assert int(blank["joystick"].shape[1]) == 2


def test_what_is_explored_is_safe_too(part: Path):
    env = DangerSense(Sensing(), config(part), part)
    model = build_model(config(part, "learn.epsilon_start=1", "learn.phase1_steps=0"), env, 1)
    model.exploration_rate = 1.0
    seen, _ = env.reset(seed=1)
    done = {int(model.predict(seen)[0]) for _ in range(60)}
    assert len(done) > 5 and all(ACTIONS.points[action][1] <= 0.5 for action in done)


def test_the_next_value_is_that_of_a_safe_action(part: Path):
    env = DangerSense(Sensing(), config(part), part)
    model = build_model(config(part), env, 1)
    seen, _ = env.reset(seed=1)
    batch = {key: torch.as_tensor(value)[None] for key, value in seen.items()}
    values = torch.linspace(0.0, 1.0, 81)[None]
    danger = torch.full((1, 1, 1, 81), 254, dtype=torch.uint8)
    danger[..., 7], danger[..., 5] = 10, 20
    assert int(model.q_net.choice(values, {**batch, DANGER_KEY: danger})) == 7
    danger[..., 7], danger[..., 5] = 250, 240
    assert int(model.q_net.choice(values, {**batch, DANGER_KEY: danger})) == 5


def test_the_value_at_the_start_of_an_episode_is_that_of_the_action_that_is_taken(part: Path, tmp_path, monkeypatch):
    model = build_model(config(part), DangerSense(Sensing(), config(part), part), 1)
    watch = EpisodeMetrics(MetricsFile(tmp_path / "metrics.csv"), 0.0)
    watch.init_callback(model)
    watch.sums, model._last_obs = [EpisodeSums()], model.env.reset()
    values = torch.as_tensor(ACTIONS.points[:, 1], dtype=torch.float32)[None]  # the farther ahead, the better
    monkeypatch.setattr(model.q_net, "forward", lambda seen: values)
    watch._look_at_starts()
    safe = dangers_of_codes(model._last_obs[DANGER_KEY])[0, -1, 0] < model.shield.threshold
    assert watch.sums[0].values.value == float(values[0, safe].max()) <= 0.5 < float(values.max())


def test_dangers_are_kept_in_a_byte_each_and_mirrored_with_the_actions(part: Path):
    dangers = np.linspace(0.0, 1.0, 81)
    assert np.abs(dangers_of_codes(codes_of_dangers(dangers)) - dangers).max() < 0.002
    model = build_model(config(part), DangerSense(Sensing(), config(part), part), 1)
    layout = dict(model.replay_buffer.layout.images)
    assert layout[DANGER_KEY] == (1, 1, 81)
    model.learn(12)
    batch = model.replay_buffer.sample(4)
    turned = mirrored(batch, torch.as_tensor(ACTIONS.mirror), model.settings.mirror_signs)
    for before, after in (
        (batch.observations, turned.observations),
        (batch.next_observations, turned.next_observations),
    ):
        assert torch.equal(after[DANGER_KEY], before[DANGER_KEY][..., torch.as_tensor(ACTIONS.mirror)])


def test_the_dangers_of_a_tick_are_those_of_the_network_that_drives(part: Path):
    own = config(part)
    env, street = DangerSense(Sensing(), own, part), Sensing()
    net, rule = load_net(part)
    alone = DangerPolicy("own", net, own, rule)
    alone.reset()
    (seen, _), (plain, _) = env.reset(seed=5), street.reset(seed=5)
    for action in (40, 50, 60):
        assert np.array_equal(seen[DANGER_KEY][-1, 0], codes_of_dangers(alone.dangers(plain)))
        alone.sent(action)
        seen, plain = env.step(action)[0], street.step(action)[0]


def test_another_danger_network_than_the_one_of_training_is_refused(run: Path, part: Path, tmp_path: Path):
    folder = shutil.copytree(run / "policies" / "final", tmp_path / "copy")
    other = DangerLearner(danger_config(), 9, 1).net
    save_danger(folder / PART, other, rule_of(danger_config().danger), danger_config())
    with pytest.raises(PolicyError, match="is not the danger network"):
        open_policy(str(folder), config(part))
    with pytest.raises(PolicyError, match="drives with both"):
        load_policy(run / "policies" / "final")
    told = json.loads((folder / POLICY_JSON).read_text())
    assert told["shield"]["danger_sha256"] == files.sha256(part / WEIGHTS)


def test_an_own_eye_of_the_danger_network_is_loaded_when_it_is_named(monkeypatch, tmp_path: Path):
    asked = []
    monkeypatch.setattr(shielded_policy, "load_danger", lambda *given: asked.append(given[-1]))
    values = SimpleNamespace(name="a", file=SimpleNamespace(shield=object()))
    with pytest.raises(FileNotFoundError):  # there are no weights to compare
        shielded_policy.shielded(tmp_path, values, danger_config(), None, "own_file:Own")
    assert asked == ["own_file:Own"]


def test_a_head_that_is_not_residual_and_a_policy_of_values_are_refused(run: Path, part: Path, tmp_path: Path):
    with pytest.raises(ConfigError, match="residual"):
        train(a_run(config(part, "learn.head=plain"), tmp_path / "a", 1), Sensing)
    with pytest.raises(PolicyError, match="expected a danger network"):
        train(a_run(config(run / "policies" / "final"), tmp_path / "b", 1), Sensing)


def test_a_network_that_carries_a_state_is_refused_for_its_values_know_no_dangers(part: Path, tmp_path: Path):
    words = ("learn.memory=groups", "learn.network=gru", "learn.mirror=false")
    with pytest.raises(ConfigError, match=r"learn\.danger with learn\.memory=groups"):
        train(a_run(config(part, *words), tmp_path / "a", 1), Sensing)
