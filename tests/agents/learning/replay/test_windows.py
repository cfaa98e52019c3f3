"""Windows of images, from the environment through replay, training and policies on disk to a test of several."""

import json
import shutil
import signal

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.vec_env import DummyVecEnv

import wcsim
from tests.agents.driven import driven
from tests.agents.learning.replay.test_buffer import H, W
from tests.agents.learning.replay.test_buffer import observation as frame
from tests.agents.learning.test_train import weights
from tests.agents.policies.test_baselines import box, ground, looking_at
from tests.agents.toy import (
    ToyStreet,
    WindowedStreet,
    load_checkpoint,
    make_replay,
    same_from_here_on,
    toy_camera,
    train_toy,
)
from tests.support.samples import ACTIONS, stacked
from tests.support.worlds import QUICK
from wcsim.agents.envs.episode_view import FrameStacker, trim_frame_window, window_observation_space
from wcsim.agents.learning.build import build_q_learner, default_settings_for_network
from wcsim.agents.learning.checkpoint import _check_fit, _replay_arrays, _restore_replay, save_checkpoint
from wcsim.agents.learning.replay.frame_store import WindowStore
from wcsim.agents.learning.saved_policy import load_policy
from wcsim.agents.learning.seqdqn import _mirror_batch
from wcsim.agents.opening.named_policy import list_policy_overrides, open_named_policy, resolve_policy_config
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.agents.runs.policy_file import POLICY_JSON
from wcsim.agents.runs.run_folder import open_run, policy_folder_from_name
from wcsim.config import CameraConfig, EnvConfig, LearnConfig, RunConfig, resolve
from wcsim.errors import ConfigError, InterruptedRunError, PolicyError
from wcsim.supervisor.observation import make_observation_space

KEYS = ("seg", "depth")
CAMERA = toy_camera(16, 20)
CONFIG = RunConfig(cameras=(CAMERA,), env=EnvConfig(window=3))
IMAGES = make_observation_space("compact", W, H)
WINDOWS = window_observation_space(IMAGES, 3)


def numbers(observation):
    return observation["seg"][:, 0, 0].tolist()


# --- the window ---


def test_a_window_begins_with_its_first_image_and_ends_with_the_newest():
    window = FrameStacker(3)
    assert [numbers(window.add(frame(n))) for n in (5, 6, 7, 8)] == [[5, 5, 5], [5, 5, 6], [5, 6, 7], [6, 7, 8]]
    window.reset()
    seen = window.add(frame(9))
    assert numbers(seen) == [9, 9, 9]
    assert WINDOWS.contains(seen)
    assert numbers(trim_frame_window(seen, 2)) == [9, 9]
    with pytest.raises(PolicyError, match=r"holds 3 images.*trained on 4.*env\.window=4"):
        trim_frame_window(seen, 4)


def test_what_is_done_to_an_observation_does_not_change_the_next():
    window = FrameStacker(2)
    window.add(frame(1))["seg"][:] = 99
    assert numbers(window.add(frame(2))) == [1, 2]


def test_a_window_of_one_changes_nothing():
    window, seen = FrameStacker(1), frame(4)
    assert window.add(seen) is seen
    assert window_observation_space(IMAGES, 1) is IMAGES


def test_the_environment_gives_the_images_that_it_gives_one_by_one(corner):
    """The terminal observation has the old window, and the first of an episode is full of its own image."""

    def drive(*overrides):
        env = gym.make(wcsim.ENV_ID, town=str(corner), overrides=(*QUICK, "env.max_steps=8", *overrides))
        try:
            seen, turn = [env.reset(seed=3)[0]], ACTIONS.nearest((1.0, 0.0))
            for _ in range(2):
                for _ in range(8):
                    observation, *_ = env.step(turn)
                    seen.append(observation)
                seen.append(env.reset()[0])
            assert all(env.observation_space.contains(observation) for observation in seen)
            return seen
        finally:
            env.close()

    singles, one, windows = drive(), drive("env.window=1"), drive("env.window=3")
    for single, same, window in zip(singles, one, windows, strict=True):
        assert all(single[key].tobytes() == same[key].tobytes() for key in single)
        assert all(np.array_equal(single[key], window[key]) for key in ("imu", "joystick"))
    assert len({single["seg"].tobytes() for single in singles}) > 8
    for k, window in enumerate(windows):
        first = 9 * (k // 9)  # of its episode
        for key in KEYS:
            wanted = [singles[max(i, first)][key][0] for i in (k - 2, k - 1, k)]
            assert np.array_equal(window[key], np.stack(wanted)), (k, key)


# --- the configuration ---


def test_a_network_says_how_many_images_it_wants_and_the_user_may_say_otherwise():
    assert default_settings_for_network(resolve("dqn")) == ("env.window=1",)
    fig6 = resolve("dqn", "learn.network=fig6")
    assert (fig6.env.window, fig6.env.frames) == (None, 1)
    resolved = resolve(fig6, default_settings_for_network(fig6))
    assert resolved == fig6.model_copy(update={"env": fig6.env.model_copy(update={"window": 4})})
    assert default_settings_for_network(resolved) == ()
    assert default_settings_for_network(resolve("dqn", ("learn.network=fig6", "env.window=2"))) == ()


@pytest.mark.parametrize("window", [0, 17, 1.5])
def test_windows_have_bounds(window):
    with pytest.raises(ConfigError, match="window"):
        resolve("dqn", f"env.window={window}")


def test_the_papers_floats_have_windows_and_a_state_has_none():
    floats = resolve("dqn", ("env.observation=table3", "learn.network=fig6"))
    assert resolve(floats, default_settings_for_network(floats)).env.frames == 4
    with pytest.raises(ConfigError, match=r"window 2 with observation 'state'.*expected env\.window=1"):
        resolve("dqn", ("env.observation=state", "env.window=2"))


# --- replay ---


class Street:
    """Drives one seat of a replay; `record` holds every observation as it was added, by absolute index."""

    def __init__(self):
        self.count, self.window, self.record, self.after = 0, FrameStacker(3), [], []
        self.now = self.see()

    def see(self):
        self.count += 1
        return self.window.add(frame(self.count))

    def step(self, end):
        """One step that ends as `end` says: (observation, observation after it)."""
        now, after = self.now, self.see()
        self.record.append(now)
        self.after.append(after)
        if end == "odd":  # a wrapper that changes what it shows the second time
            self.now = {**after, "seg": after["seg"][::-1].copy()}
        elif end == "go":
            self.now = after
        else:
            self.window.reset()
            self.now = self.see()
        return now, after


def add(buffer, streets, ends):
    pairs = [street.step(end) for street, end in zip(streets, ends, strict=True)]
    now, after = map(stacked, zip(*pairs, strict=True))
    done = np.array([end in ("crash", "limit") for end in ends])
    infos = [{"TimeLimit.truncated": end == "limit"} for end in ends]
    buffer.add(now, after, np.zeros(len(ends), int), np.zeros(len(ends)), done, infos)


def replay(size=400, seats=1, space=WINDOWS):
    return make_replay(size, space, seats, seed=1)


def check(buffer, streets):
    """Every step that is kept comes back as it was added, and so does what came after it."""
    first = buffer.total - buffer.size()
    for seat, street in enumerate(streets):
        # The newest row has no known successor unless its episode ended.
        index = np.arange(first, buffer.total - 1)
        batch = buffer.gather(index, np.full(len(index), seat))
        for k, step in enumerate(index):
            for key in WINDOWS.spaces:
                assert np.array_equal(batch.observations[key][k].numpy(), street.record[step][key]), (step, key)
                assert np.array_equal(batch.next_observations[key][k].numpy(), street.after[step][key]), (step, key)


@settings(max_examples=60)
@given(st.data())
def test_what_is_drawn_is_what_was_added(data):
    seats, size = data.draw(st.integers(1, 3)), data.draw(st.integers(4, 30))
    kinds = st.sampled_from(("go", "go", "go", "go", "crash", "limit", "reset", "odd"))
    plan = data.draw(st.lists(st.lists(kinds, min_size=seats, max_size=seats), min_size=2, max_size=50))
    buffer, streets = replay(size * seats, seats), [Street() for _ in range(seats)]
    for ends in plan:
        add(buffer, streets, ends)
    check(buffer, streets)
    twin = replay(size * seats, seats)
    add(twin, [Street() for _ in range(seats)], ["go"] * seats)  # to be forgotten
    _restore_replay(twin, _replay_arrays(buffer))
    check(twin, streets)
    for ends in [["go"] * seats] * 5:
        for each in (buffer, twin):
            marks = [(street.count, street.now, list(street.window._observations)) for street in streets]
            add(each, streets, ends)
            if each is buffer:  # the twin sees the same step again
                for street, (count, now, kept) in zip(streets, marks, strict=True):
                    street.count, street.now = count, now
                    street.window._observations.extend(kept)
                    street.record.pop()
                    street.after.pop()
        check(buffer, streets)
        check(twin, streets)
    assert all(index >= buffer.total - buffer.size() for index, _ in buffer.windows.whole_windows)


def test_a_window_costs_no_more_than_its_newest_image():
    buffer, streets = replay(400), [Street()]
    for step in range(450):
        add(buffer, streets, ["limit" if step % 40 == 39 else "go"])
    assert buffer.windows.frames._frames.nbytes == (400 + 2) * 2 * H * W
    assert not buffer.windows.whole_windows
    one = replay(400, space=IMAGES)
    assert one.windows.frames._frames.nbytes == 400 * 2 * H * W


def test_a_memory_that_holds_nothing_yet_can_be_kept():
    twin = replay(400, seats=2)
    add(twin, [Street(), Street()], ["go", "go"])  # to be forgotten
    arrays = _replay_arrays(replay(400, seats=2))
    _check_fit(twin, arrays)
    _restore_replay(twin, arrays)
    assert (twin.total, twin.size()) == (0, 0)
    streets = [Street(), Street()]
    for _ in range(5):
        add(twin, streets, ["go", "go"])
    check(twin, streets)


def test_a_window_with_a_forgotten_past_is_kept_whole():
    store, a, b = WindowStore(8, 1, 2, 3), [1, 1, 1], [2, 2, 2]
    store.write(4, np.array([a + a], np.uint8), np.array([True]))
    store.reset()
    store.write(9, np.array([a + b], np.uint8), np.array([False]))
    assert store.read(np.array([9]), np.array([0])).tolist() == [a + b]


def test_a_checkpoint_of_other_windows_is_refused():
    buffer, streets = replay(400), [Street()]
    for _ in range(5):
        add(buffer, streets, ["go"])
    with pytest.raises(ValueError, match=r"end_images is uint8 \(0, 36\); expected uint8 \(0, 12\)"):
        _check_fit(replay(400, space=IMAGES), _replay_arrays(buffer))


def test_every_image_of_a_window_is_mirrored():
    buffer, streets = replay(400), [Street()]
    for _ in range(6):
        add(buffer, streets, ["go"])
    batch = buffer.gather(np.array([3]), np.array([0]))
    batch.observations["seg"] = torch.arange(3 * H * W, dtype=torch.uint8).reshape(1, 3, H, W)
    out = _mirror_batch(batch, torch.arange(81))
    assert torch.equal(out.observations["seg"], batch.observations["seg"].flip(3))
    assert torch.equal(_mirror_batch(out, torch.arange(81)).observations["seg"], batch.observations["seg"])


# --- training, policies, tests ---


def config(window=3, **learn):
    small = {
        "total_steps": 80, "phase1_steps": 24, "learning_starts": 20, "replay_frames": 100, "batch_size": 8,
        "checkpoint_every": 20, "network": "fig6", "mirror": True,
    }  # fmt: skip
    return RunConfig(cameras=(CAMERA,), learn=LearnConfig(**{**small, **learn}), env=EnvConfig(window=window))


def street(window=3):
    return WindowedStreet(window, CAMERA, max_steps=25)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return train_toy(config(), tmp_path_factory.mktemp("a") / "run", street)


def test_equal_seeds_give_equal_runs(run, tmp_path):
    again = train_toy(config(), tmp_path / "two", street)
    assert weights(run) == weights(again) != weights(run, "phase1")


def goes_on(run):
    train_toy(config(), run, street, resume=True)
    assert open_run(run).manifest.status == "done"


def test_a_run_that_is_stopped_while_its_town_loads_goes_on(tmp_path):
    class StopsAtOnce(gym.Wrapper):
        def reset(self, **options):
            signal.raise_signal(signal.SIGINT)
            return super().reset(**options)

    with pytest.raises(InterruptedRunError, match="stopped after 0 of 80"):
        train_toy(config(), tmp_path / "run", lambda: StopsAtOnce(street()))
    goes_on(tmp_path / "run")


def test_a_checkpoint_restores_windows_and_weights(tmp_path):
    wrote, again = (build_q_learner(config(), DummyVecEnv([street]), seed) for seed in (1, 2))
    wrote.learn(130)  # the oldest windows reach back to images that are forgotten
    save_checkpoint(tmp_path, wrote, {})
    load_checkpoint(tmp_path, again)
    assert same_from_here_on(wrote, again, updates=20)


def test_a_policy_says_what_it_must_see(run, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(policy_folder_from_name(str(run)), folder)
    assert json.loads((folder / POLICY_JSON).read_text())["window"] == 3
    assert resolve_policy_config(str(folder), "dqn").env.window == 3
    assert resolve_policy_config(str(run), "dqn").env.window == 3
    policy, (observation, _) = load_policy(folder), street().reset(seed=1)
    batch = {key: torch.as_tensor(value)[None] for key, value in observation.items()}
    with torch.inference_mode():
        assert np.array_equal(policy.values(observation), policy.net(batch)[0].numpy())
    with pytest.raises(PolicyError, match="trained on 3"):
        policy.act(ToyStreet(CAMERA).reset(seed=1)[0])


ONE_IMAGE = config(window=1, network="patch", total_steps=48)


def test_a_policy_from_before_there_were_windows_sees_one_image(tmp_path):
    path = train_toy(ONE_IMAGE, tmp_path / "run", lambda: street(1))
    file = policy_folder_from_name(str(path)) / POLICY_JSON
    data = json.loads(file.read_text())
    assert data.pop("window") == 1
    file.write_text(json.dumps(data))
    assert load_policy(file.parent).file.window == 1
    kept = json.loads((path / "config.json").read_text())
    del kept["env"]["window"]
    (path / "config.json").write_text(json.dumps(kept))
    train_toy(ONE_IMAGE, path, lambda: street(1), resume=True)


def test_policies_with_different_windows_are_tested_in_one_environment(run, tmp_path):
    """Each drives as it does in an environment of its own."""
    single = train_toy(ONE_IMAGE, tmp_path / "run", lambda: street(1))
    policies = [open_named_policy(str(path), CONFIG, 0) for path in (run, single)] + [
        make_baseline_policy("stop", CONFIG)
    ]
    assert [list_policy_overrides(RunConfig(), policy)[0] for policy in policies] == [
        f"env.window={n}" for n in (3, 1, 1)
    ]
    for policy, own in zip(policies, (3, 1, 1), strict=True):
        rows = [driven(policy, WindowedStreet(n, CAMERA, 20), 2, 20, seed=4) for n in (own, 3, 5)]
        assert rows[0] == rows[1] == rows[2]


@pytest.mark.parametrize("name", ["stop", "dwa"])
def test_baselines_look_at_the_newest_image(name):
    """They stop for a wall in the newest image, and not for one in an older."""
    camera = CameraConfig(width_px=40, height_px=30)
    free, wall = looking_at(ground, camera=camera), looking_at(box(1.6, 3.0, -3, 3, 0, 3), camera=camera)

    def chosen(*images):
        seen = {**free, **{key: np.concatenate([image[key] for image in images]) for key in KEYS}}
        seen["joystick"] = np.array([0.0, 1.0], np.float32)
        policy = make_baseline_policy(name, RunConfig(cameras=(camera,)))
        return [policy.act(seen) for _ in range(12)]

    assert chosen(wall, wall, free) == chosen(free, free, free) == chosen(free)
    assert chosen(free, free, wall) == chosen(wall) != chosen(free)


def test_groups_are_for_networks_that_carry_a_state():
    found = {}
    for network in ("fig6", "convlstm", "conv3d"):
        config = RunConfig(learn=LearnConfig(network=network, memory="groups"))
        config = resolve(config, default_settings_for_network(config))
        found[network] = config.learn.memory, config.env.frames
    assert found == {"fig6": ("groups", 1), "convlstm": ("groups", 1), "conv3d": ("windows", 4)}
