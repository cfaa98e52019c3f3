import shutil
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import DQN
from torch import nn

from tests.agents.toy import WindowedStreet
from tests.support.samples import ACTIONS
from wcsim.agents.envs.episode_view import window_observation_space
from wcsim.agents.networks import registry
from wcsim.agents.networks.encoder import GROUPS, WCSIM_GROUPS, ObservationEncoder, _group_table
from wcsim.agents.networks.names import NETWORK_NAMES
from wcsim.agents.networks.q_network import QNet
from wcsim.config import CameraConfig, RewardConfig
from wcsim.config.run_file import FollowPrior, NetSpec
from wcsim.errors import PolicyError
from wcsim.supervisor.observation import make_observation_space
from wcsim.supervisor.rewards import _joystick_terms
from wcsim.types import ClassId

WINDOWED = ("conv3d", "convlstm", "fig6")
EACH_WINDOWED = pytest.mark.parametrize("network", WINDOWED)
EXAMPLE = Path(__file__).parents[3] / "examples" / "own_network.py"


def space(height, width, frames=1):
    return window_observation_space(make_observation_space("compact", width, height), frames)


def batch(height, width, joysticks, frames=1):
    g = np.random.default_rng(0)
    images = g.integers(0, 34, (2, len(joysticks), frames, height, width), dtype=np.uint8)
    return {
        "seg": torch.from_numpy(images[0]),
        "depth": torch.from_numpy(images[1]),
        "imu": torch.zeros(len(joysticks), 5),
        "joystick": torch.as_tensor(np.asarray(joysticks), dtype=torch.float32),
    }


def q_net(height=60, width=80, frames=1, **spec):
    torch.manual_seed(0)
    return QNet(space(height, width, frames), gym.spaces.Discrete(81), NetSpec(**spec))


@pytest.mark.parametrize(
    "network, size, frames",
    [
        *((network, size, 1) for network in NETWORK_NAMES for size in ((60, 80), (240, 320), (24, 32), (33, 47))),
        *((network, *window) for network in WINDOWED for window in (((60, 80), 4), ((24, 32), 16))),
    ],
)
def test_any_image_size_and_window_gives_a_value_for_each_action(network, size, frames):
    net = q_net(*size, frames, network=network)
    assert net(batch(*size, [(0, 0), (1, 0)], frames)).shape == (2, 81)


def test_a_network_of_one_camera_refuses_the_images_of_others():
    seen = make_observation_space("compact", 80, 60, others={"rear_": CameraConfig()})
    with pytest.raises(PolicyError, match=r"sees one camera, .* rear_depth, rear_seg; .* env\.camera"):
        QNet(seen, gym.spaces.Discrete(81), NetSpec())


@settings(max_examples=25)
@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=8))
def test_a_fresh_residual_network_follows_the_user(sticks):
    points = ACTIONS.points
    chosen = q_net(24, 32)(batch(24, 32, sticks)).argmax(dim=1).numpy()
    distance = np.linalg.norm(points[chosen] - np.asarray(sticks), axis=1)
    assert np.all(distance <= 0.1768 + 0.02)


def test_a_fresh_plain_network_does_not():
    sticks = [(x, y) for x in (-1, -0.5, 0, 0.5, 1) for y in (-1, 0, 1)]
    chosen = q_net(24, 32, head="plain")(batch(24, 32, sticks)).argmax(dim=1)
    assert len(set(chosen.tolist())) < len(sticks)


@settings(max_examples=25)
@given(st.floats(-1, 1), st.floats(-1, 1))
def test_the_known_part_is_the_rewards_joystick_part(x, y):
    net = q_net(24, 32, prior=FollowPrior(reward_scale=0.05))
    actions, config = ACTIONS, RewardConfig()
    stick = np.array([x, y], dtype=np.float32)
    expected = [0.05 * sum(_joystick_terms(actions.distance(a, stick), config)) for a in range(81)]
    got = net.follow_reward(torch.from_numpy(stick)[None])[0].numpy()
    on_the_edge = np.abs(actions.distances(stick[None])[0] - 0.1768) < 1e-4  # float32 may fall on either side of it
    assert np.allclose(got[~on_the_edge], np.asarray(expected)[~on_the_edge], atol=1e-6)


def test_each_class_is_in_one_group_and_the_planes_say_so():
    ids = [i for group in GROUPS for i in group]
    assert len(ids) == len(set(ids))
    assert set(ids) >= {int(c) for c in ClassId} - {int(ClassId.VOID)}
    assert _group_table("wcsim").shape == (len(GROUPS) + len(WCSIM_GROUPS), 256)
    encoder = ObservationEncoder(space(24, 32))
    one = batch(24, 32, [(0, 0)])
    one["seg"][:] = int(ClassId.PERSON)
    one["depth"][:] = 51
    planes = encoder.image(one)[0]
    lit = [k for k in range(len(planes) - 1) if bool((planes[k] == 1).all())]
    assert lit == [next(k for k, group in enumerate(GROUPS) if ClassId.PERSON in group)]
    assert torch.allclose(planes[-1], torch.tensor(0.2))


def test_the_networks_sees_its_vector_and_its_images():
    net, base = q_net(24, 32, head="plain"), batch(24, 32, [(0.2, 0.3)])
    before = net(base)
    for key in base:
        changed = {**base, key: base[key] + 1 if base[key].dtype == torch.uint8 else base[key] + 0.5}
        assert not torch.allclose(before, net(changed)), key


def test_other_observations_are_refused():
    floats = gym.spaces.Dict(
        picture=gym.spaces.Box(0, 1, (3, 24, 32), np.float32),
        depth=gym.spaces.Box(0, 1, (1, 24, 32), np.float32),
        imu=gym.spaces.Box(-1, 1, (5,), np.float32),
        joystick=gym.spaces.Box(-1, 1, (2,), np.float32),
    )
    with pytest.raises(PolicyError, match="seg, depth"):
        ObservationEncoder(floats)


# --- windows of images ---


@pytest.mark.parametrize("network, frames, most", [("patch", 1, 250_000), *((name, 4, 400_000) for name in WINDOWED)])
def test_networks_have_a_few_hundred_thousand_parameters(network, frames, most):
    assert 150_000 < sum(p.numel() for p in q_net(frames=frames, network=network).parameters()) < most


@EACH_WINDOWED
def test_every_image_of_the_window_counts_and_so_does_their_order(network):
    net, base = q_net(24, 32, 4, network=network, head="plain"), batch(24, 32, [(0.2, 0.3)], 4)
    before = net(base)
    for k in range(4):
        changed = {**base, "depth": base["depth"].clone()}
        changed["depth"][:, k] += 40
        assert not torch.allclose(before, net(changed), atol=1e-6), k
    order = [1, 0, 2, 3]
    assert not torch.allclose(before, net({**base, "seg": base["seg"][:, order], "depth": base["depth"][:, order]}))


def test_a_window_is_expanded_image_by_image():
    seen = batch(24, 32, [(0, 0), (1, 0)], 3)
    planes = ObservationEncoder(space(24, 32, 3), "fig6").image(seen)
    assert planes.shape == (2, 3, len(GROUPS) + 1, 24, 32)
    one = ObservationEncoder(space(24, 32), "patch")
    for k in range(3):
        single = {key: value[:, k : k + 1] if key in ("seg", "depth") else value for key, value in seen.items()}
        assert torch.equal(planes[:, k], one.image(single))


@EACH_WINDOWED
def test_motion_is_learnt_from_a_window(network):
    """Which way something moves is in the window and not in its newest image."""
    g = np.random.default_rng(1)

    def moving(count):
        way, place = g.integers(0, 2, count), g.integers(8, 24, count)
        seen = batch(16, 32, [(0, 0)] * count, 4)
        seen["seg"][:], seen["depth"][:] = 0, 255
        for n in range(count):
            for k in range(4):
                x = place[n] + 2 * (k - 3) * (1 if way[n] else -1)
                seen["seg"][n, k, 4:12, x - 2 : x + 2] = int(ClassId.PERSON)
        return seen, torch.from_numpy(way)

    torch.manual_seed(0)
    encoder = ObservationEncoder(space(16, 32, 4), network)
    net = nn.ModuleList([encoder, nn.Linear(encoder.features_dim, 2)])
    optimizer = torch.optim.Adam(net.parameters(), 1e-3)
    loss = 1.0
    for _ in range(120):
        seen, way = moving(32)
        optimizer.zero_grad()
        error = nn.functional.cross_entropy(net[1](encoder(seen)), way)
        error.backward()
        optimizer.step()
        loss += 0.2 * (float(error.detach()) - loss)
        if loss < 0.1:
            break
    seen, way = moving(200)
    with torch.no_grad():
        assert (net[1](encoder(seen)).argmax(dim=1) == way).float().mean() > 0.9
        for key in ("seg", "depth"):
            seen[key][:] = seen[key][:, -1:]
        assert (net[1](encoder(seen)).argmax(dim=1) == way).float().mean() < 0.7


def test_a_fresh_lstm_remembers():
    lstm = ObservationEncoder(space(24, 32, 4), "fig6").body.memory
    forget = slice(128, 256)
    assert torch.equal(lstm.bias_ih_l0[forget] + lstm.bias_hh_l0[forget], torch.ones(128))
    assert lstm.bias_ih_l0.sum() == 128
    for first in range(0, 512, 128):
        gate = lstm.weight_hh_l0[first : first + 128]
        assert torch.allclose(gate @ gate.T, torch.eye(128), atol=1e-5)


@EACH_WINDOWED
def test_sb3s_own_dqn_learns_with_windows(network, tmp_path):
    """Unchanged, from equal seeds to equal weights, and the same after save and load."""
    kwargs = {
        "features_extractor_class": ObservationEncoder,
        "features_extractor_kwargs": {"network": network},
        "normalize_images": False,
    }

    def learnt():
        return DQN(
            "MultiInputPolicy", WindowedStreet(4), policy_kwargs=kwargs, buffer_size=60, learning_starts=16,
            batch_size=8, seed=3, device="cpu",
        ).learn(40)  # fmt: skip

    one, other = learnt(), learnt()
    assert one._n_updates == 6
    one.save(tmp_path / "model")
    loaded = DQN.load(tmp_path / "model", device="cpu")
    state = one.q_net.state_dict()
    for key, value in state.items():
        assert torch.equal(value, other.q_net.state_dict()[key]), key
        assert torch.equal(value, loaded.q_net.state_dict()[key]), key
    observation, _ = WindowedStreet(4).reset(seed=1)
    assert loaded.predict(observation, deterministic=True)[0] == one.predict(observation, deterministic=True)[0]
    moved = [key for key, value in state.items() if not torch.equal(value, one.q_net_target.state_dict()[key])]
    assert any("body" in key for key in moved)


def test_the_features_hold_the_joystick_for_heads_that_see_nothing_else():
    for network in WINDOWED:
        torch.manual_seed(0)
        encoder, seen = ObservationEncoder(space(24, 32, 4), network), batch(24, 32, [(0.2, 0.3)], 4)
        assert not torch.equal(encoder(seen), encoder({**seen, "joystick": -seen["joystick"]})), network


def test_a_network_for_one_image_refuses_several():
    with pytest.raises(PolicyError, match=r"'patch' reads one image, the observation holds 4.*env\.window=1.*fig6"):
        q_net(24, 32, 4, network="patch")


class Pairs(nn.Module):
    windowed = True

    def __init__(self, image_shape, vector_size):
        super().__init__()
        self.frames, *_ = image_shape

    def forward(self, image, vector):
        return image.flatten(3).mean(3).flatten(1)[:, : 2 * self.frames]


def test_a_windowed_network_of_ones_own_is_built_with_the_window(monkeypatch):
    monkeypatch.setitem(registry.NETWORKS, "pairs", Pairs)
    assert ObservationEncoder(space(24, 32, 3), "pairs").features_dim == 6
    assert registry.preferred_window_size("pairs") == 1
    assert [registry.preferred_window_size(name) for name in (*WINDOWED, "patch")] == [4] * len(WINDOWED) + [1]


# --- the registry ---


def test_the_example_is_one_short_file_and_works(tmp_path, monkeypatch):
    assert len(EXAMPLE.read_text().splitlines()) <= 15
    shutil.copy(EXAMPLE, tmp_path / "my_net_a.py")
    monkeypatch.chdir(tmp_path)
    net = q_net(network="my_net_a:OwnNet")
    assert net(batch(60, 80, [(0, 0)])).shape == (1, 81)
    sys.modules.pop("my_net_a")


class Flat(nn.Module):
    def __init__(self, image_shape, vector_size):
        super().__init__()

    def forward(self, image, vector):
        return image.sum()


class NotFinite(Flat):
    def forward(self, image, vector):
        return torch.log(vector.abs())


class NoArguments(nn.Module):
    def __init__(self):
        super().__init__()


@pytest.mark.parametrize(
    "network, says",
    [
        (Flat, "expected a tensor"),
        (NoArguments, "could not be built"),
        (NotFinite, r"'wrong' returned numbers that are not finite.*logarithm of 0"),
    ],
)
def test_networks_that_break_the_contract_are_explained(network, says, monkeypatch):
    monkeypatch.setitem(registry.NETWORKS, "wrong", network)
    with pytest.raises(PolicyError, match=says):
        q_net(network="wrong")


def test_a_name_is_registered_once(monkeypatch):
    monkeypatch.setattr(registry, "NETWORKS", dict(registry.NETWORKS))
    registry.register("mine", Flat)
    registry.register("mine", Flat)
    with pytest.raises(PolicyError):
        registry.register("mine", NoArguments)
    with pytest.raises(PolicyError):
        registry.register("mine:Net", Flat)
