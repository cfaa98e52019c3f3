"""The training aid: what the oracle says of every action, from the environment's info to the values."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

import wcsim.agents.learning.seqdqn as seqdqn
from tests.agents.toy import make_replay, q_config, q_learner, toy_camera
from tests.support.samples import ACTIONS
from wcsim.agents.envs.episode_view import OBJECTS, InfoObjects
from wcsim.agents.learning.checkpoint import _replay_arrays, _restore_replay
from wcsim.agents.learning.seqdqn import (
    MARGIN_OFFSET,
    _aid_loss,
    _draw_other_sticks,
    _mirror_batch,
    _teacher_actions,
)
from wcsim.config import resolve
from wcsim.errors import ConfigError
from wcsim.supervisor.observation import make_observation_space
from wcsim.types import ClassId

CAMERA = toy_camera(24, 32)
POINTS = ACTIONS.points
AHEAD = POINTS[:, 1] > 0.3
SPACE = make_observation_space("compact", 32, 24)


def distances(*sticks):
    return torch.as_tensor(ACTIONS.distances(np.array(sticks)), dtype=torch.float32)


def safe_rows(*rows):
    return torch.as_tensor(np.stack(rows))


# --- teacher and loss ---


def test_the_teacher_is_the_safe_action_nearest_to_the_stick():
    safe = safe_rows(np.ones(81, bool), ~AHEAD)
    assert POINTS[_teacher_actions(distances((0, 1), (0, 1)), safe)].tolist() == [[0, 1], [0, 0.25]]


def test_a_moment_in_which_nothing_is_safe_teaches_nothing():
    values = torch.zeros(1, 81, requires_grad=True)
    _aid_loss(values, distances((0, 1)), safe_rows(np.zeros(81, bool)), 0.05, 1.0).backward()
    assert not values.grad.any()


def test_the_loss_by_hand():
    g = np.random.default_rng(0)
    values, safe, stick = g.normal(size=81), g.random(81) < 0.7, (0.3, 0.6)
    gap = ACTIONS.distances(np.array([stick]))[0]
    label = int(np.where(safe, gap, np.inf).argmin())
    behind = values + 0.05 * (np.maximum(gap - gap[label], 0) + MARGIN_OFFSET + 3.0 * ~safe) - values[label]
    behind[label] = 0.0
    behind = np.maximum(behind, 0)
    expected = behind.max() + behind[~safe].mean()
    tensor = torch.as_tensor(values, dtype=torch.float32)[None]
    got = _aid_loss(tensor, distances(stick), safe_rows(safe), scale=0.05, unsafe=3.0)
    assert float(got) == pytest.approx(expected, rel=1e-4)


def test_the_loss_is_zero_when_the_teacher_wins_clearly_and_its_slope_goes_the_right_way():
    safe, gap = safe_rows(~AHEAD), distances((0, 1))
    clear = -10 * gap - 100 * ~safe
    assert float(_aid_loss(clear, gap, safe, 0.05, 1.0)) == 0.0
    values = torch.zeros(1, 81, requires_grad=True)
    _aid_loss(values, gap, safe, 0.05, 1.0).backward()
    label = int(_teacher_actions(gap, safe))
    assert values.grad[0, label] < 0
    assert (values.grad[0, torch.as_tensor(AHEAD)] > 0).all()


def test_other_wishes_are_any_and_only_a_share():
    sticks = np.tile(np.array([[0.1, 0.2]], np.float32), (400, 1))
    wishes = _draw_other_sticks(sticks, POINTS, 0.5, np.random.default_rng(0))
    assert wishes.dtype == np.float32
    changed = (wishes != sticks).any(axis=1)
    assert 0.4 < changed.mean() < 0.6
    assert np.hypot(*wishes.T).max() <= 1.0 + 1e-6
    assert len(np.unique(ACTIONS.nearest_many(wishes))) > 40
    assert np.array_equal(_draw_other_sticks(sticks, POINTS, 0.0, np.random.default_rng(0)), sticks)


# --- advice in the replay memory ---


def observed(number):
    image = np.full((1, 1, 24, 32), number % 251, np.uint8)
    stick = np.array([[0.0, number / 1000]], np.float32)
    return {"seg": image, "depth": image, "imu": np.zeros((1, 5), np.float32), "joystick": stick}


def mask(number):
    return (np.arange(81) * 7 + number) % 5 != 0


def memory(rows, advice=True, **settings):
    return make_replay(rows, SPACE, aid="oracle" if advice else "none", **settings)


def told(safe):
    truth = None if safe is None else SimpleNamespace(safe_actions=safe)
    return [{OBJECTS: InfoObjects(truth=truth)}]


def advised(replay, k, safe, done=False):
    """One more step, and what is safe after it."""
    replay.add(observed(k), observed(k + 1), np.array([0]), np.zeros(1), np.array([done]), told(safe))


def filled(steps, rows=1000, crash_every=7, unknown=()):
    """A memory in which the safe actions of observation k are mask(k)."""
    replay = memory(rows, n_step=3, seed=5)
    number = 0
    for k in range(steps):
        done = k % crash_every == crash_every - 1
        advised(replay, number, None if number + 1 in unknown else mask(number + 1), done)
        number += 2 if done else 1  # the observation after a crash is the episode's last; the next begins another
    return replay


def numbers(seen):
    return np.rint(seen["joystick"][:, 1].numpy() * 1000).astype(int)


@pytest.mark.parametrize("rows", [1000, 25])
def test_advice_belongs_to_its_observation(rows):
    replay = filled(60, rows, unknown=(50, 51))
    observations, safe = replay.sample_advice(300, 0.5)
    seen = numbers(observations)
    assert np.array_equal(safe.numpy(), np.stack([mask(k) for k in seen]))
    assert not set(seen) & ({8 * k for k in range(10)} | {50, 51})  # first observations and untold ones
    if rows == 25:
        assert seen.min() > 68 - 30


def test_a_look_ahead_ends_with_the_episode():
    replay = filled(40)
    seen, known = replay.sample_advice(200, 0.5, ahead=2)
    for number, safe in zip(numbers(seen), known.numpy(), strict=True):
        last = min(8 * (number // 8) + 6, number + 2, 39 + 39 // 7)
        assert np.array_equal(safe, np.all([mask(k) for k in range(number, last + 1)], axis=0))


def test_a_look_ahead_leaves_an_action():
    replay = memory(100)
    for k in range(20):
        advised(replay, k, AHEAD if (k + 1) % 2 else ~AHEAD)
    seen, known = replay.sample_advice(100, 0.5, ahead=3)
    for number, safe in zip(numbers(seen), known.numpy(), strict=True):
        assert np.array_equal(safe, AHEAD if number % 2 else ~AHEAD)


def test_tight_moments_get_their_share():
    replay = memory(1000)
    for k in range(200):
        advised(replay, k, np.ones(81, bool) if (k + 1) % 50 else ~AHEAD)
    tight = (~replay.sample_advice(400, 0.5)[1].all(dim=1)).float().mean()
    assert 0.45 < tight < 0.6


def test_advice_survives_a_checkpoint():
    replay = filled(60, 25)
    again = memory(25, n_step=3, seed=5)
    _restore_replay(again, _replay_arrays(replay))
    one, two = replay.sample_advice(50, 0.5, 3), again.sample_advice(50, 0.5, 3)
    assert torch.equal(one[1], two[1])
    assert np.array_equal(numbers(one[0]), numbers(two[0]))


def test_without_advice_there_is_none_to_draw():
    plain = memory(100, advice=False)
    with pytest.raises(ValueError, match="advice=True"):
        plain.sample_advice(4, 0.5)
    assert memory(100).sample_advice(4, 0.5) is None


# --- mirror ---


def random_batch():
    g, count = torch.Generator().manual_seed(0), 5

    def seen():
        images = {k: torch.randint(0, 34, (count, 1, 24, 32), generator=g, dtype=torch.uint8) for k in ("seg", "depth")}
        vectors = {k: torch.rand(count, n, generator=g) - 0.5 for k, n in (("imu", 5), ("joystick", 2))}
        return {**images, **vectors}

    column = torch.rand(count, 1, generator=g)
    return DictReplayBufferSamples(
        observations=seen(), actions=torch.arange(count)[:, None], next_observations=seen(), dones=column,
        rewards=column, discounts=column,
    )  # fmt: skip


def test_a_mirror_image_of_a_mirror_image_is_the_first_one():
    batch, swap = random_batch(), torch.as_tensor(ACTIONS.mirror)
    once = _mirror_batch(batch, swap)
    assert torch.equal(once.observations["seg"][..., 0], batch.observations["seg"][..., -1])
    assert torch.allclose(once.observations["joystick"], batch.observations["joystick"] * torch.tensor([-1.0, 1.0]))
    assert np.allclose(POINTS[once.actions[:, 0]], POINTS[batch.actions[:, 0]] * [-1, 1])
    assert torch.equal(once.rewards, batch.rewards)
    twice = _mirror_batch(once, swap)
    assert torch.equal(twice.actions, batch.actions)
    for part in ("observations", "next_observations"):
        for key, value in getattr(batch, part).items():
            assert torch.equal(getattr(twice, part)[key], value)


# --- the learner ---


def learner(**learn):
    settings = {"learning_starts": 20, "replay_frames": 1000, "batch_size": 16, "aid": "oracle", "mirror": True}
    return q_learner(q_config(CAMERA, **{**settings, **learn}))


def wall_or_way(wall):
    """A wall before the chair, or a free pavement; the user wants to go ahead in both."""
    seg = np.full((1, 1, 24, 32), ClassId.WALL if wall else ClassId.SIDEWALK, np.uint8)
    depth = np.full((1, 1, 24, 32), 60 if wall else 200, np.uint8)
    return {
        "seg": seg, "depth": depth, "imu": np.zeros((1, 5), np.float32), "joystick": np.array([[0, 0.9]], np.float32),
    }  # fmt: skip


def choice_before(model, wall):
    action, _ = model.policy.predict({key: value[0] for key, value in wall_or_way(wall).items()})
    return POINTS[int(action)]


@pytest.fixture
def alternating(monkeypatch):
    """Walls and ways take turns, so no action leads from a way to the wall after it."""
    monkeypatch.setattr(seqdqn, "AID_AHEAD", 0)


def taught():
    """A learner after 60 updates on walls and ways, with no reward and no crash that could have told it."""
    model = learner(phase1_steps=0, total_steps=100, aid_weight=5.0, learning_rate=1e-3)
    model.learn(1)
    buffer = model.replay_buffer
    buffer.reset()
    for k in range(60):
        stay, safe = np.array([ACTIONS.nearest((0.0, 0.9))]), ~AHEAD if (k + 1) % 2 else np.ones(81, bool)
        now, after = wall_or_way(k % 2 == 1), wall_or_way((k + 1) % 2 == 1)
        buffer.add(now, after, stay, np.zeros(1), np.array([False]), told(safe))
    model.train(60, 16)
    return model


def test_the_aid_teaches_to_stop_before_a_wall_and_to_go_on_where_the_way_is_free(alternating):
    model = taught()
    assert choice_before(model, wall=True)[1] <= 0.3
    assert choice_before(model, wall=False).tolist() == [0.0, 1.0]


def _wrong_sign(*arguments, **more):
    return -_aid_loss(*arguments, **more).clamp(max=1.0)


def _no_loss(values, *arguments, **more):
    return 0.0 * values.sum()


@pytest.mark.parametrize("fault", [_wrong_sign, _no_loss])
def test_an_aid_with_a_planted_fault_teaches_nothing(fault, monkeypatch, alternating):
    monkeypatch.setattr(seqdqn, "_aid_loss", fault)
    model = taught()
    assert choice_before(model, wall=True)[1] > 0.3


def test_advice_waits_for_the_second_phase_and_presets_say_who_uses_it():
    plan = learner(phase1_steps=30, total_steps=100, aid_weight=3.0).plan
    assert [plan.aid_weight(step) for step in (0, 29, 30, 99)] == [0, 0, 3, 3]
    assert resolve("paper").learn.aid == "none"
    assert resolve("dqn").learn.aid == "oracle"
    assert not learner(aid="none").replay_buffer.advised


def test_a_camera_off_the_middle_has_no_mirror_image():
    camera = CAMERA.model_copy(update={"p_BC_m": (0.0, 0.2, 1.0)})
    with pytest.raises(ConfigError, match=r"learn\.mirror=false"):
        q_learner(q_config(camera, mirror=True))


def test_a_fading_rate_ends_at_zero():
    model = learner(learning_rate=1e-3, learning_rate_fade=0.5)
    rates = [model.lr_schedule(left) for left in (1.0, 0.5, 0.25, 0.0, -0.01)]
    assert rates == pytest.approx([1e-3, 1e-3, 5e-4, 0.0, 0.0])
    assert learner(learning_rate=1e-3).lr_schedule(0.0) == 1e-3


def test_an_exploration_is_held_for_its_steps_and_keeps_its_share():
    model = learner(epsilon_hold=8, exploration="local")
    model.exploration_rate = 0.2
    runs = np.array([model._draw_explorers(1)[0] for _ in range(6000)])
    assert 0.15 < runs.mean() < 0.25
    edges = np.flatnonzero(np.diff(np.r_[0, runs.astype(int), 0]))
    lengths = edges[1::2] - edges[::2]
    assert (lengths[:-1] % 8 == 0).all()
