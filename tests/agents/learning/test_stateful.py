"""Networks that carry a state: driven, stored, learned from groups of steps in a row, saved."""

import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import DummyVecEnv
from torch.nn import functional

from tests.agents.learning.test_seqdqn import perturb
from tests.agents.toy import CutStreet, ToyStreet, WindowedStreet, q_config, q_learner, toy_camera
from wcsim.agents.learning.build import build_q_learner, default_settings_for_network
from wcsim.agents.learning.saved_policy import load_policy, save_policy
from wcsim.agents.learning.seqdqn import _burned_in, _group_targets, _group_values, _sequence_loss
from wcsim.config import resolve
from wcsim.errors import ConfigError, PolicyError

CAMERA = toy_camera(16, 20)
SMALL = {"learning_starts": 40, "replay_frames": 200, "batch_size": 16, "group_steps": 4, "memory": "groups"}
CARRYING = ("fig6", "convlstm")


def config(window=None, **learn):
    given = q_config(CAMERA, **{"network": "fig6", **SMALL, **learn})
    return (
        given if window is None else given.model_copy(update={"env": given.env.model_copy(update={"window": window})})
    )


def model(seed=0, envs=1, **learn):
    return q_learner(config(**learn), seed, envs, max_steps=23)


def trained(steps=120, **learn):
    learner = model(**learn)
    learner.learn(steps)
    return learner


def whole_groups(learner):
    buffer = learner.replay_buffer
    return buffer.groups.gather(buffer, *buffer.groups.complete(buffer).T)


# --- the two contracts share their weights ---


@pytest.mark.parametrize("network", CARRYING)
def test_step_by_step_is_the_same_as_in_one_go(network):
    net = model(network=network).q_net
    g = torch.Generator().manual_seed(0)
    images = {k: torch.randint(0, 34, (2, 5, 1, 16, 20), dtype=torch.uint8, generator=g) for k in ("seg", "depth")}
    seen = {**images, "imu": torch.zeros(2, 5, 5), "joystick": torch.rand(2, 5, 2, generator=g)}
    with torch.no_grad():
        values, after = net.unroll(seen, net.begin(2))
        state = net.begin(2)
        for tick in range(5):
            now, state = net.step({key: value[:, tick] for key, value in seen.items()}, state)
            assert torch.allclose(now, values[:, tick], atol=1e-5)
        assert torch.allclose(state, after, atol=1e-5)
        assert torch.allclose(net({k: v[:, 0] for k, v in seen.items()}), values[:, 0], atol=1e-5)
        other, _ = net.unroll(
            {**seen, "seg": torch.cat([seen["seg"][:, :1].flip(0), seen["seg"][:, 1:]], 1)}, net.begin(2)
        )
    assert not torch.allclose(other[:, -1], values[:, -1], atol=1e-6), "the first image is remembered"


def test_a_carried_state_replaces_the_window():
    assert default_settings_for_network(config()) == ("env.window=1",)
    assert default_settings_for_network(config(memory="steps")) == ("env.window=4",)
    assert "env.window=4" in default_settings_for_network(config(network="conv3d"))
    assert model().q_net.spec.stateful
    assert not model(network="patch").q_net.spec.stateful
    with pytest.raises(PolicyError, match=r"sees 3 images at a time.*env\.window=1"):
        build_q_learner(config(), DummyVecEnv([lambda: WindowedStreet(3, CAMERA)]), 0)


@pytest.mark.parametrize(
    "learn, told",
    [
        ({"mirror": True}, r"learn\.mirror=true with learn\.memory=groups"),
        ({"aid": "oracle"}, r"learn\.aid=oracle with learn\.memory=groups"),
        ({"memory": "windows"}, r"learn\.memory=windows with one image.*env\.window=4"),
    ],
)
def test_what_does_not_go_together_is_refused(learn, told):
    with pytest.raises(ConfigError, match=told):
        model(**learn)


@pytest.mark.parametrize("key, value", [("group_steps", 0), ("group_steps", 1001), ("burn_in", -1), ("memory", "x")])
def test_settings_have_bounds(key, value):
    with pytest.raises(ConfigError, match=key):
        resolve("dqn", f"learn.{key}={value}")


@pytest.mark.parametrize("memory", ["steps", "groups", "windows"])
@pytest.mark.parametrize("network, window", [("patch", 1), ("conv3d", 3)])
def test_a_network_without_a_state_learns_from_all_three(memory, network, window):
    given = config(window=window, network=network, memory=memory)
    learner = build_q_learner(given, DummyVecEnv([lambda: WindowedStreet(window, CAMERA, 23)]), 0)
    learner.learn(80)
    assert np.isfinite(learner.last_loss)
    assert learner._n_updates > 0


# --- driving ---


def unrolled(net, batch):
    """The state of a network after an episode's steps."""
    with torch.no_grad():
        return net.unroll({key: value[None] for key, value in batch.items()}, net.begin(1))[1]


@pytest.mark.parametrize("envs", [1, 3])
def test_the_stored_state_is_what_the_same_weights_make_of_the_episode(envs):
    """Nothing is learned while driving, so the state that was stored is the one that is computed anew."""
    learner = model(envs=envs, learning_starts=10_000, phase1_steps=60, burn_in=0, epsilon_start=0.5)
    learner.learn(150 * envs)
    buffer, net = learner.replay_buffer, learner.q_net
    assert len(buffer.groups.states) > 10 * envs
    for (index, seat), state in list(buffer.groups.states.items())[::5]:
        steps = np.arange(index - buffer.episode_step[index % buffer.buffer_size, seat], index)
        if steps[0] < buffer.total - buffer.size():
            continue
        batch = buffer.gather(steps, np.full(len(steps), seat)).observations
        after = unrolled(net, batch)
        assert np.allclose(after[0].numpy(), state, atol=1e-5)
        assert np.abs(state).max() > 1e-3


def test_burn_in_moves_a_stale_state_towards_the_true_one():
    learner = model(learning_starts=10_000, phase1_steps=0, burn_in=8)
    learner.learn(200)
    torch.manual_seed(3)
    with torch.no_grad():
        for p in learner.q_net.parameters():
            p += 0.1 * p.abs().mean() * torch.randn_like(p)
    buffer, net, gaps = learner.replay_buffer, learner.q_net, {}
    old = model(learning_starts=10_000, phase1_steps=0).q_net
    places = [k for k in buffer.groups.complete(buffer) if buffer.episode_step[k[0] % buffer.buffer_size, 0] >= 12]
    for burn_in in (8, 0):
        gaps[burn_in] = []
        for index, seat in places:
            begun = index - buffer.episode_step[index % buffer.buffer_size, seat]
            before = buffer.gather(np.arange(begun, index), np.full(index - begun, seat)).observations
            true = unrolled(net, before)
            batch = buffer.groups.gather(buffer, np.array([index]), np.array([seat]))
            # Without burn-in it is the state at the group's start as the old weights made it.
            here = unrolled(old, before) if burn_in == 0 else _burned_in(net, batch)
            gaps[burn_in].append(float((here - true).abs().mean()))
    assert len(places) > 5
    assert np.mean(gaps[8]) < 0.5 * np.mean(gaps[0])


def test_an_episodes_end_forgets_the_state_of_its_seat_alone():
    learner = model(envs=2, learning_starts=10_000, phase1_steps=0)
    learner._carried = learner._next = (np.ones((2, 256), np.float32),)
    learner._setup_learn(1, None)
    assert learner._carried is None
    learner._next = (np.ones((2, 256), np.float32),)
    new = learner.env.reset()
    learner._store_transition(
        learner.replay_buffer, np.zeros(2, int), new, np.zeros(2), np.array([True, False]), [{}, {}]
    )
    assert learner._carried[0].sum(axis=1).tolist() == [0.0, 256.0]


@pytest.mark.parametrize("learn", [{}, {"network": "patch", "memory": "steps"}])
def test_a_step_that_was_never_driven_as_the_world_began_again_is_not_learned_from(learn):
    street = CutStreet(30, CAMERA, max_steps=23)
    learner = build_q_learner(config(**learn), DummyVecEnv([lambda: street]), 0)
    learner.learn(60)
    buffer = learner.replay_buffer
    assert (learner.num_timesteps, buffer.total) == (60, 59)
    assert buffer.ended[28, 0] and not buffer.terminated[28, 0] and buffer.episode_step[29, 0] == 0
    last = buffer.gather(np.array([28]), np.array([0]))
    assert (float(last.dones), float(last.discounts)) == (0.0, pytest.approx(learner.gamma))
    assert all(np.array_equal(last.next_observations[key][0].numpy(), street.shown[key]) for key in street.shown)
    assert np.isfinite(learner.last_loss)


# --- learning ---


def test_targets_by_hand():
    """Each step's return plus the value of what comes after it, with the states of both networks burned in."""
    learner = trained(burn_in=3, n_step=3)
    perturb(learner)
    batch = whole_groups(learner)
    with torch.no_grad():
        online, target = _group_values(learner.q_net, batch), _group_values(learner.q_net_target, batch)
    for double_q in (True, False):
        found = _group_targets(online if double_q else target, target, batch, 0.05)
        for k, t in batch.live.nonzero().tolist()[::7]:
            after = int(batch.after[k, t])
            pick = int((online if double_q else target)[k, after].argmax())
            wanted = 0.05 * float(batch.returns[k, t])
            wanted += (1 - float(batch.terminated[k, t])) * float(batch.discounts[k, t]) * float(target[k, after, pick])
            assert float(found[k, t]) == pytest.approx(wanted, abs=1e-5)
    state = _burned_in(learner.q_net_target, batch)
    assert not torch.allclose(state, _burned_in(learner.q_net, batch))


def test_what_is_not_in_a_group_does_not_count():
    learner = trained()
    batch = whole_groups(learner)
    short = int((batch.live.sum(dim=1) < 4).nonzero()[0])
    nets = (learner.q_net, learner.q_net_target)

    def loss(batch):
        return float(_sequence_loss(nets, batch, 0.05, True, None)[0].detach())

    before = loss(batch)
    for change in ("returns", "terminated", "discounts"):
        value = getattr(batch, change)
        kept = value[short].clone()
        value[short, batch.live[short].sum() :] += 50.0
        assert loss(batch) == before
        value[short, 0] += 50.0
        assert loss(batch) != before
        value[short] = kept


@pytest.mark.parametrize("phase1", ["supervised", "margin"])
def test_groups_are_learned_from_in_the_way_that_the_first_phase_is_set_to(phase1, monkeypatch):
    learner = trained(phase1=phase1, reward_scale=0.1)
    batch = whole_groups(learner)
    monkeypatch.setattr(learner.replay_buffer, "sample_groups", lambda size: batch)
    with torch.no_grad():
        plain, whole = (float(learner._draw_batch_loss(16, weight)) for weight in (0.0, 2.0))
        length = batch.live.shape[1]
        values = _group_values(learner.q_net, batch)[:, :length][batch.live]
        sticks = batch.observations["joystick"][:, :length][batch.live]
    gaps = np.linalg.norm(sticks.numpy()[:, None] - learner.action_points.points, axis=2)
    labels = torch.as_tensor(gaps.argmin(axis=1))
    if phase1 == "supervised":
        wanted = float(functional.cross_entropy(values / 0.1, labels))
    else:
        wanted = float(learner.margin_loss(values, {"joystick": sticks}))
    assert whole - plain == pytest.approx(2.0 * wanted, rel=1e-4)


# --- saved ---


@pytest.mark.parametrize("network", CARRYING)
def test_a_saved_policy_carries_its_state_and_begins_anew_with_an_episode(network, tmp_path):
    learner = trained(60, network=network)
    policy = load_policy(save_policy(tmp_path / "p", learner, CAMERA))
    assert (policy.file.window, policy.file.net.stateful) == (1, True)
    street = ToyStreet(CAMERA)
    seen = [street.reset(seed=3)[0]] + [street.step(40)[0] for _ in range(6)]

    def driven():
        out = []
        for one in seen:
            out.append(policy.values(one))
            policy.act(one)
        return np.array(out)

    first = driven()
    state, wanted = learner.q_net.begin(1), []
    for one in seen:
        with torch.no_grad():
            values, state = learner.q_net.step({k: torch.as_tensor(v)[None] for k, v in one.items()}, state)
        wanted.append(values[0].numpy())
    assert np.allclose(first, wanted, atol=1e-5)
    assert not np.allclose(driven(), first), "nothing was reset"
    policy.reset()
    assert np.array_equal(driven(), first)
    policy.begin()
    assert np.array_equal(driven(), first)


def test_predict_takes_and_gives_states_as_sb3_has_it():
    learner = trained(60, envs=2)
    seen = learner.env.reset()
    _, state = learner.predict(seen, deterministic=True)
    _, after = learner.predict(seen, state, episode_start=np.array([True, False]), deterministic=True)
    assert np.allclose(after[0][0], state[0][0], atol=1e-6)
    assert not np.allclose(after[0][1], state[0][1], atol=1e-4)
    one = {key: value[0] for key, value in seen.items()}
    action, alone = learner.predict(one, deterministic=True)
    assert np.ndim(action) == 0
    assert np.allclose(alone[0][0], state[0][0], atol=1e-6)
    learner.set_logger(configure(None, []))
    learner.train(2, 16)
