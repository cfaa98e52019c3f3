"""Learning from each form of observation: the arrays of Table 3, and colours beside the classes."""

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from tests.agents.toy import ToyStreet, a_run, toy_camera
from tests.support.samples import stacked
from wcsim.agents.envs.episode_view import FrameStacker, trim_frame_window, window_observation_space
from wcsim.agents.learning.replay.buffer import _layout_of
from wcsim.agents.learning.saved_policy import load_policy
from wcsim.agents.learning.train import train_dqn
from wcsim.agents.opening.named_policy import open_named_policy, resolve_policy_config
from wcsim.config import RunConfig, resolve
from wcsim.errors import InterruptedRunError, PolicyError
from wcsim.supervisor.observation import make_observation_space
from wcsim.supervisor.palette import make_class_palette

CAMERA = toy_camera(16, 20).model_copy(update={"rgb": True})
SMALL = (
    *("learn.total_steps=48", "learn.phase1_steps=24", "learn.learning_starts=16", "learn.replay_frames=100"),
    *("learn.batch_size=8", "learn.checkpoint_every=12", "learn.head=plain", "learn.group_steps=4", "learn.burn_in=2"),
)
STATEFUL = ("learn.network=fig6", "learn.memory=groups")
WINDOWS = ("learn.network=conv3d", "learn.memory=windows", "env.window=4")
FORMS = [
    *(("table3", words) for words in (STATEFUL, (), WINDOWS)),
    *(("compact_rgb", words) for words in (STATEFUL, ("learn.mirror=true",))),
]


class Formed(gym.Wrapper[Any, Any, Any, Any]):
    """The toy street as another form shows it; it may be asked to stop at a step."""

    def __init__(self, form: str, stop_at: int = -1, frames: int = 1) -> None:
        super().__init__(ToyStreet(CAMERA, max_steps=30))
        self.form, self.stop_at, self.steps = form, stop_at, 0
        space = make_observation_space(form, 20, 16)  # type: ignore[arg-type]
        self.observation_space, self.window = window_observation_space(space, frames), FrameStacker(frames)

    def reset(self, **given: Any) -> Any:
        seen, info = self.env.reset(**given)
        self.window.reset()
        return self._formed(seen), info

    def step(self, action: Any) -> Any:
        self.steps += 1
        if self.steps == self.stop_at:
            signal.raise_signal(signal.SIGTERM)
        seen, *rest = self.env.step(action)
        return self._formed(seen), *rest

    def _formed(self, seen: dict[str, Any]) -> dict[str, Any]:
        colours = np.moveaxis(make_class_palette()[seen["seg"][0]], -1, 0)
        if self.form == "compact_rgb":
            return self.window.add({**seen, "rgb": colours.astype(np.uint8)})
        rows = {key: seen[key] for key in ("imu", "joystick")}
        planes = {"segmentation": colours.astype(np.float32) / 255.0, "depth": seen["depth"].astype(np.float32) / 255.0}
        return self.window.add({**rows, **planes})


def config(form: str, *words: str) -> RunConfig:
    return resolve(RunConfig(cameras=(CAMERA,)), (*SMALL, f"env.observation={form}", *words))


@pytest.mark.parametrize("form, words", FORMS)
def test_a_network_learns_from_it_goes_on_and_is_loaded(tmp_path: Path, form: str, words: tuple[str, ...]) -> None:
    asked = a_run(config(form, *words), tmp_path / "whole", 1)
    frames = asked.config.env.frames
    whole = train_dqn(asked, lambda: Formed(form, frames=frames))
    again = replace(asked, out=tmp_path / "parts")
    with pytest.raises(InterruptedRunError):
        train_dqn(again, lambda: Formed(form, stop_at=30, frames=frames))
    assert train_dqn(replace(again, resume=True), lambda: Formed(form, frames=frames)) == again.out
    policy = load_policy(whole / "policies" / "final")
    assert policy.file.observation == form
    env = Formed(form, frames=frames)
    seen, _ = env.reset(seed=3)
    assert env.observation_space.contains(seen)
    values = policy.values(seen)
    assert values.shape == (81,) and np.ptp(values) > 0.0
    other = {**seen, "depth": np.zeros_like(seen["depth"])}
    assert not np.array_equal(values, policy.values(other)), "it looks at the picture"
    settings = resolve_policy_config(str(whole), "quick")
    assert open_named_policy(str(whole), settings, 0).name == str(whole)
    plain = settings.model_copy(update={"env": settings.env.model_copy(update={"observation": "compact"})})
    with pytest.raises(PolicyError, match=f"sees env.observation={form}, this test has compact"):
        open_named_policy(str(whole), plain, 0)


@pytest.mark.parametrize("form", ["table3", "compact_rgb"])
def test_replay_gives_back_what_was_stored_to_the_bit(form: str) -> None:
    env = Formed(form)
    layout = _layout_of(env.observation_space)
    seen = [env.reset(seed=n)[0] for n in range(3)]
    batch = stacked(seen)
    rows = layout.image_rows(batch)
    assert rows.dtype == np.uint8 and rows.shape == (3, layout.image_bytes)
    back = layout.split(rows, layout.vector_rows(batch))
    assert all(np.array_equal(back[key], batch[key]) and back[key].dtype == batch[key].dtype for key in batch)


@pytest.mark.parametrize(
    "form, keys", [("compact_rgb", ("seg", "depth", "rgb")), ("table3", ("segmentation", "depth"))]
)
def test_images_have_a_window_oldest_first(form: str, keys: tuple[str, ...]) -> None:
    space = window_observation_space(make_observation_space(form, 20, 16), 3)  # type: ignore[arg-type]
    shapes = {"rgb": (9, 16, 20), "segmentation": (3, 3, 16, 20)}
    depth = {"compact_rgb": (3, 16, 20), "table3": (3, 1, 16, 20)}[form]  # one dimension more in front
    assert all(space[key].shape == shapes.get(key, depth) for key in keys)
    layout = _layout_of(space)
    assert layout.window == 3
    env, window = Formed(form), FrameStacker(3)
    frames = [env.reset(seed=n)[0] for n in range(3)]
    seen = [window.add(frame) for frame in frames][-1]
    assert space.contains({**seen, "joystick": seen["joystick"]})
    two, one = (trim_frame_window(seen, number) for number in (2, 1))
    row = layout.image_rows({key: value[None] for key, value in seen.items()})
    back = layout.split(row, np.zeros((1, layout.vector_size), np.float32))
    for key in keys:
        images = np.stack([frame[key] for frame in frames])
        assert np.array_equal(seen[key].reshape(images.shape), images)
        assert np.array_equal(two[key], seen[key][len(seen[key]) // 3 :]) and np.array_equal(one[key], images[2])
        assert np.array_equal(back[key][0], seen[key])
