"""The exported form of a danger policy against the policy itself."""

import numpy as np
import pytest
import torch

from tests.support.samples import ACTIONS
from wcsim.agents.danger.dataset import to_tensors
from wcsim.agents.danger.network import DangerNet
from wcsim.agents.danger.policy import DangerPolicy, _choose, _mask_safe_actions, _next_recent
from wcsim.agents.danger.street_map import FeatureExtractor
from wcsim.agents.export.policy_graphs import DangerPolicyGraph, TorchDriveModel
from wcsim.config import CameraConfig, ChairConfig, RunConfig, resolve
from wcsim.config.run_file import DangerNetworkShape, DangerNetworkSpec, DangerRuleSettings, StickValue
from wcsim.core.joystick import advance_drive, drive_limits_from_chair, shape_joysticks
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import MAX_DISTANCE, action_set

CONFIG = resolve(RunConfig(cameras=(CameraConfig(width_px=48, height_px=36),)), "world.action_delay_ticks=2")


def network(**parts: object) -> DangerNet:
    torch.manual_seed(0)
    shape = DangerNetworkShape(**{"width": 20, "actions": "square81", **parts})
    net = DangerNet(DangerNetworkSpec(net=shape, camera=CONFIG.cameras[0], classes="cityscapes"))
    with torch.no_grad():
        for value in net.parameters():
            value.add_(0.3 * torch.randn_like(value) * value.abs().mean())
    return net.eval()


def ride(ticks: int = 30, config: RunConfig = CONFIG) -> list[dict[str, np.ndarray]]:
    """Observations of a chair that drives through a street of noise."""
    rng = np.random.default_rng(3)
    shapes = {prefix: (camera.height_px, camera.width_px) for prefix, camera in config.eyes.items()}
    base = {prefix: rng.integers(60, 200, shape) for prefix, shape in shapes.items()}
    found = []
    for tick in range(ticks):
        seen = {}
        for prefix, shape in shapes.items():
            depth = np.clip(base[prefix] + rng.integers(-3, 4, shape), 0, 255).astype(np.uint8)
            depth[rng.random(shape) < 0.02] = 0
            seen[f"{prefix}depth"] = depth[None]
            seen[f"{prefix}seg"] = rng.choice([7, 8, 11, 24, 26], (1, *shape)).astype(np.uint8)
        imu = rng.normal(0.0, 0.02, 8).astype(np.float32)
        found.append(
            {
                **seen,
                "imu": imu,
                "odometry": np.array([0.05 + 0.01 * tick, 0.02], np.float32),
                "joystick": np.array([0.9 * np.sin(tick / 2.0), np.cos(tick / 3.0)], np.float32),
            }
        )
    return found


def test_the_drives_law_is_that_of_the_chair():
    chair = ChairConfig()
    rng = np.random.default_rng(0)
    motion = rng.uniform(-1.5, 1.5, (200, 3))
    commands = shape_joysticks(rng.uniform(-1.0, 1.0, (200, 2)), chair)
    drive = TorchDriveModel(drive_limits_from_chair(chair), chair.deadband, chair.shape_exponent)
    told = torch.stack(
        drive.follow(torch.as_tensor(motion).unbind(1), drive.targets(torch.as_tensor(commands)), 0.1), 1
    )
    pairs = zip(motion.tolist(), commands, strict=True)
    true = [advance_drive(*row, *command, drive_limits_from_chair(chair), 0.1) for row, command in pairs]
    assert np.allclose(told, true, atol=1e-9)
    sticks = rng.uniform(-1.0, 1.0, (200, 2))
    assert np.allclose(drive.shaped(torch.as_tensor(sticks)).numpy(), shape_joysticks(sticks, chair), atol=1e-9)


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_the_graph_moves_as_the_policy_thinks_that_the_chair_does(delay):
    config = resolve(CONFIG, f"world.action_delay_ticks={delay}")
    eye, points = FeatureExtractor(config), action_set(config.env.actions)
    graph = DangerPolicyGraph(network(), config, DangerRuleSettings()).eval()
    state = [torch.zeros(shape) for shape in graph.shapes().values()]
    for seen in ride(12):
        eye.extract(seen)
        with torch.inference_mode():
            values, _, _, *state = graph(*(torch.as_tensor(seen[key])[None] for key in graph.inputs), *state)
        assert np.allclose(state[0][0, 5:8], eye.around.ego.motion, atol=1e-4)
        assert np.allclose(state[0][0, 2:5], eye.around.ego.pose_O, atol=1e-4)
        start, later_s = eye.around.start()
        places, now = (torch.stack(parts)[:, 0] for parts in graph._start(state[0], _before_sent(state[1])))
        assert np.allclose(torch.cat([places, now]), start, atol=1e-4)
        assert later_s == pytest.approx(delay * config.world.tick_s)
        action = int(values.argmax())
        assert np.allclose(state[2][0, 0], points.points[action])
        eye.command(action)


def _before_sent(waiting):
    """Commands as they waited before the newest was sent."""
    return torch.cat([waiting[:, :1], waiting[:, :-1]], 1)


@pytest.mark.parametrize("width, height, cameras", [(48, 36, "front"), (320, 240, "front"), (48, 36, "front,rear")])
def test_the_graph_sees_what_the_policy_sees_and_does_what_it_does(width, height, cameras):
    names = [f'"{name}"' for name in cameras.split(",")]
    size = (f"cameras.0.width_px={width}", f"cameras.0.height_px={height}")
    config = resolve(CONFIG, (*size, f"env.camera=[{','.join(names)}]"))
    net, rule = network(), DangerRuleSettings(threshold=0.4)
    net.spec = net.spec.model_copy(update={"more_cameras": tuple(config.eyes.values())[1:]})
    policy, eye = DangerPolicy("own", net, config, rule), FeatureExtractor(config)
    graph = DangerPolicyGraph(net, config, rule).eval()
    state = [torch.zeros(shape) for shape in graph.shapes().values()]
    policy.reset()
    actions, same = [], 0
    for seen in ride(15, config):
        sight = eye.extract(seen)
        with torch.inference_mode():
            values, warning, danger, *state = graph(*(torch.as_tensor(seen[key])[None] for key in graph.inputs), *state)
            wanted = torch.sigmoid(net(*to_tensors(eye, *sight.batch())))
        own = graph._read_cells(state[0], state[4])
        differ = (own - torch.as_tensor(sight.picture).float()).abs() > 2.0
        assert differ.float().mean() < 0.01, "cells at a border may go either way"
        assert (danger - wanted).abs().max() < 0.05
        action = policy.act(seen)
        eye.command(int(values.argmax()))
        actions.append(action)
        same += int(values.argmax()) == action
        level, on = state[5][0].tolist()
        assert abs(level - policy._alarm.level) < 0.05 and bool(warning) == bool(on)
        assert bool(on) == policy.warning or abs(level - rule.warn) < 0.05 or abs(level - 0.7 * rule.warn) < 0.05
    assert same == len(actions) and len(set(actions)) > 1


def test_a_rule_of_values_is_refused():
    with pytest.raises(PolicyError, match="by the values of sticks"):
        DangerPolicyGraph(network(), CONFIG, DangerRuleSettings(value=StickValue()))


def test_the_highest_value_is_that_of_the_action_which_the_rule_takes():
    rule = DangerRuleSettings(threshold=0.1, at_once=0.5)
    graph, rng = DangerPolicyGraph(network(), CONFIG, rule), np.random.default_rng(7)
    chosen, beyond, doubtful = [], 0, 0
    for number in range(1200):
        stick = np.clip(rng.uniform(-2.0, 2.0, 2), -1.0, 1.0).astype(np.float32)  # mostly at edges and in corners
        low, high = ((0.0, 1.0), (0.0, 0.1), (0.2, 0.22))[number % 3]  # few are safe, all of them, none is
        danger, last = rng.uniform(low, high, 81).astype(np.float32), int(rng.integers(-1, 81))
        danger[ACTIONS.distances(stick[None])[0] < rng.uniform(0.0, 2.8)] = 1.0  # and none near the stick
        own = ACTIONS.nearest(stick.astype(np.float64))
        danger[own] = rng.choice(np.array([0.03, 0.07, 0.3, 0.7, 1.0], np.float32))
        recent = int(rng.integers(0, 3))
        exact = danger.astype(np.float64)
        taken = own if recent > 1 and own != last else -1
        chosen.append(_choose(exact, stick.astype(np.float64), ACTIONS, rule, last, recent > 0, taken))
        told = torch.as_tensor(danger)[None], torch.as_tensor(stick)[None], torch.tensor([[last + 1.0]])
        values, later = graph._choose(*told, torch.tensor([[float(recent)]]))
        assert int(values.argmax()) == chosen[-1]
        unsafe = not _mask_safe_actions(exact, rule, last, taken, -1 if recent else own)[own]
        assert float(later[0, 0]) == _next_recent(recent, unsafe, float(exact[own]), rule)
        doubtful += chosen[-1] == own and 0.2 < danger[own] < 0.5 and last != own
        beyond += float(np.linalg.norm(ACTIONS.points[chosen[-1]] - stick)) > MAX_DISTANCE
    assert beyond > 20 and len(set(chosen)) > 40 and doubtful > 20
