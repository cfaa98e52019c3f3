"""A toy street: a corridor with posts and walkers, a user who looks at none of them, wcsim's compact observation.

The chair is a disc with a first-order lag. Images are ray cast exactly (cylinders, walls, ground) with a real camera
configuration, so that policies which only know pictures can be judged by the true geometry. Reward: Tables 1 and 2 of
the paper without accelerations.
"""

import errno
import importlib
import math
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import DummyVecEnv

from tests.support.samples import ACTIONS, stacked
from wcsim.agents.envs.episode_view import OBJECTS, WORLD_RESTARTED, FrameStacker, InfoObjects, window_observation_space
from wcsim.agents.learning.build import build_q_learner
from wcsim.agents.learning.checkpoint import make_checkpoint_restorer
from wcsim.agents.learning.replay.buffer import FrameReplay
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.learning.train import train_dqn
from wcsim.agents.runs.checkpoint import _restore_newest, _Restored
from wcsim.agents.runs.metrics import STEP_COLUMNS, MetricsFile
from wcsim.agents.runs.run_folder import ResolvedRun
from wcsim.config import CameraConfig, LearnConfig, RunConfig
from wcsim.config.run_file import QTrainingProgress
from wcsim.errors import ServerGoneError
from wcsim.server.launch.states import WAIT_NO_MORE
from wcsim.server.specs import RunInfo
from wcsim.supervisor.observation import make_observation_space
from wcsim.types import ClassId, Events, Joystick, RewardTerms, Truth

DT_S, V_MAX, W_MAX, LAG_S = 0.1, 1.6, 1.5, 0.25
CHAIR_M, HALF_WIDTH_M, WALL_M, BODY_M, TOP_M = 0.4, 2.5, 3.0, 0.3, 1.7
OBSTACLES, AHEAD_M = 8, 20.0


def toy_camera(height_px: int = 24, width_px: int = 32) -> CameraConfig:
    return CameraConfig(
        width_px=width_px, height_px=height_px, hfov_deg=110.0, range_m=10.0, p_BC_m=(0.0, 0.0, 1.0), pitch_deg=-15.0
    )


def a_run(config: RunConfig, out: Path, seed: int, *, resume: bool = False, **info: Any) -> ResolvedRun:
    """A run of these settings; what else its manifest says is left out unless it is given."""
    return ResolvedRun(config=config, out=out, info=RunInfo(seed=seed, **info), resume=resume)


def train_toy(
    config: RunConfig, out: Path, make: Callable[[], Any], *more: Any, seed: int = 5, resume: bool = False, **rest: Any
) -> Path:
    """Train in toy streets, and return the folder of the run; see `train_dqn` for what else may be given."""
    return train_dqn(a_run(config, out, seed, resume=resume), make, *more, **rest)


def logs_in(folder: Path) -> tuple[MetricsFile, MetricsFile]:
    """Fresh logs of a training."""
    return MetricsFile(folder / "metrics.csv"), MetricsFile(folder / "steps.csv", columns=STEP_COLUMNS)


def full_once(monkeypatch: Any, where: str, stage: str) -> None:
    """The disk is full when the function at `where` writes the policy of this stage for the first time."""
    module, _, name = where.rpartition(".")
    write, tries = getattr(importlib.import_module(module), name), []

    def first_fails(path: Path, *given: Any) -> Path:
        if path.name == stage and not tries:
            tries.append(path)
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, *given)

    monkeypatch.setattr(where, first_fails)


def same_from_here_on(wrote: SeqDQN, again: SeqDQN, updates: int = 5, batch: int = 8) -> bool:
    """Whether the learner that wrote a checkpoint and one that was restored from it learn and explore alike."""
    space = wrote.observation_space
    space.seed(0)
    seen = stacked([space.sample() for _ in range(16)])
    chosen = []
    for each in (wrote, again):
        each.set_logger(configure(None, []))
        each.train(updates, batch)
        each.exploration_rate = 0.5
        chosen.append(each.predict(seen)[0])
    pairs = zip(wrote.policy.parameters(), again.policy.parameters(), strict=True)
    return np.array_equal(*chosen) and all(torch.equal(one, other) for one, other in pairs)


def stopped_while_away(waits: list[bool]) -> None:
    """What a launcher that ends sends to a client whose world is away, and what comes of waiting then."""
    for number in (signal.SIGTERM, WAIT_NO_MORE):
        signal.raise_signal(number)
    assert waits, "nobody says that there is no use in waiting"
    raise ServerGoneError("nobody answers")


class ToyStreet(gym.Env[dict[str, Any], np.int64]):
    """One corridor; obstacle rows are x, y, vx, vy, radius."""

    metadata: ClassVar[dict[str, Any]] = {}

    def __init__(self, camera: CameraConfig | None = None, max_steps: int = 400, obstacles: int = OBSTACLES):
        self.camera = camera or toy_camera()
        self.max_steps, self.count = max_steps, obstacles
        self.actions = ACTIONS
        self.observation_space = make_observation_space("compact", self.camera.width_px, self.camera.height_px)
        self.action_space = gym.spaces.Discrete(len(self.actions))
        self.rays = camera_rays(self.camera)  # (H * W, 3) body frame, per metre of depth
        self.g = np.random.default_rng(0)
        self.episode = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        if seed is not None:
            self.g = np.random.default_rng(seed)
        self.x, self.y, self.yaw, self.v, self.w, self.accel = 0.0, self.g.uniform(-1, 1), 0.0, 0.0, 0.0, 0.0
        self.step_count, self.noise = 0, np.zeros(2)
        self.obstacles = np.stack([self._obstacle(3.0, AHEAD_M) for _ in range(self.count)]).reshape(-1, 5)
        self._new_goal()
        return self._observe(), {OBJECTS: InfoObjects(truth=self._truth())}

    def step(self, action):
        stick = self.joystick()
        point = self.actions.points[int(action)]
        distance = self.actions.distance(int(action), stick)
        blend, old_v = DT_S / LAG_S, self.v
        self.v += blend * (V_MAX * point[1] - self.v)
        self.w += blend * (-W_MAX * point[0] - self.w)
        self.yaw += DT_S * self.w
        self.x += DT_S * self.v * math.cos(self.yaw)
        self.y += DT_S * self.v * math.sin(self.yaw)
        self.accel = (self.v - old_v) / DT_S
        self._walk()
        self.noise += -0.1 * self.noise + 0.05 * self.g.normal(size=2)
        self.goal_s -= DT_S
        if self.goal_s < 0:
            self._new_goal()
        self.step_count += 1
        crashed = self.clearance() < 0
        truncated = self.step_count >= self.max_steps and not crashed
        follow = 1.0 if distance <= 0.1768 + 1e-6 else 0.0
        penalty = 0.0 if follow else -2.0 * min((distance - 0.1768) / (2.0 - 0.1768), 1.0)
        reward = RewardTerms(base=follow, joystick=penalty, accel=0.0, tilt=0.0, crash=-100.0 if crashed else 0.0)
        asked, given = Joystick(*map(float, stick)), Joystick(*map(float, point))
        info = self._info(distance, crashed, truncated)
        info[OBJECTS].asked, info[OBJECTS].given = asked, given
        return self._observe(), reward.total, crashed, truncated, info

    def _info(self, distance, crashed, truncated):
        events = Events(
            episode=self.episode,
            step=self.step_count,
            crashed=crashed,
            crash_reason="collision" if crashed else "",
            truncated=truncated,
            arrived=False,
            gave_up=False,
        )
        return {
            "joystick_distance": distance,
            OBJECTS: InfoObjects(truth=self._truth(), events=events),
            "progress_m": self.v * math.cos(self.yaw) * DT_S,
            "speed_mps": abs(self.v),
            "user_action": self.actions.nearest(self.joystick()),
        }

    def joystick(self):
        """The user steers to a lateral goal and sees no obstacle."""
        want = np.clip((self.goal_y - self.y) * 0.5, -0.7, 0.7)
        stick = np.array([np.clip(-1.2 * (want - self.yaw), -1, 1), self.goal_speed]) + self.noise
        return (stick / max(np.linalg.norm(stick), 1.0)).astype(np.float32)

    def clearance(self) -> float:
        walls = HALF_WIDTH_M - abs(self.y)
        gaps = np.hypot(self.obstacles[:, 0] - self.x, self.obstacles[:, 1] - self.y) - self.obstacles[:, 4]
        return float(min(walls, gaps.min(initial=99.0)) - CHAIR_M)

    def _truth(self) -> Truth:
        stick = self.joystick()
        return Truth(
            intent=Joystick(float(stick[0]), float(stick[1])),
            danger=self.clearance() < 1.0,
            progress_m=0.0,
            first_s=np.full(len(self.actions), np.inf),
            clearance_m=self.clearance(),
        )

    def _new_goal(self) -> None:
        self.goal_y, self.goal_speed = self.g.uniform(-1.7, 1.7), self.g.uniform(0.5, 1)
        self.goal_s = self.g.uniform(2, 6)

    def _obstacle(self, near_m: float, far_m: float):
        speed = self.g.uniform(0.3, 0.9) if self.g.random() < 0.5 else 0.0
        way = self.g.uniform(-math.pi, math.pi)
        x, y = self.x + self.g.uniform(near_m, far_m), self.g.uniform(-2.3, 2.3)
        return np.array([x, y, speed * math.cos(way), speed * math.sin(way), self.g.uniform(0.2, 0.4)])

    def _walk(self) -> None:
        o = self.obstacles
        to_chair = np.array([self.x, self.y]) - o[:, :2]
        stop = (np.hypot(*to_chair.T) < 1.2) & ((to_chair * o[:, 2:4]).sum(axis=1) > 0)
        o[:, :2] += DT_S * o[:, 2:4] * ~stop[:, None]
        o[:, 3] = np.where(np.abs(o[:, 1]) > 2.3, -np.sign(o[:, 1]) * np.abs(o[:, 3]), o[:, 3])
        for k in np.flatnonzero(o[:, 0] < self.x - 4):
            o[k] = self._obstacle(10.0, AHEAD_M)

    def _observe(self) -> dict[str, np.ndarray]:
        depth_m, ids = self._cast()
        shape, range_m = (1, self.camera.height_px, self.camera.width_px), self.camera.range_m
        value = 255.0 * np.log(np.clip(depth_m, 0.1, range_m) / 0.1) / math.log(range_m / 0.1)
        imu = np.array([self.accel / 20.0, self.v * self.w / 20.0, 9.81 / 20.0, 0.0, 0.0], dtype=np.float32)
        return {
            "seg": ids.reshape(shape).astype(np.uint8),
            "depth": np.rint(value).reshape(shape).astype(np.uint8),
            "imu": np.clip(imu, -1, 1),
            "joystick": self.joystick(),
        }

    def _cast(self):
        """Depth in metres and class of every pixel, (H * W,) each."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        ahead, left, ray_z = self.rays.T
        ray_x, ray_y = ahead * c - left * s, ahead * s + left * c
        depth, ids = np.full(len(ray_x), self.camera.range_m), np.full(len(ray_x), int(ClassId.SKY))

        def paint(t, low_m, high_m, cls):
            z = 1.0 + t * ray_z
            hit = (t > 0.05) & (t < depth) & (z >= low_m) & (z <= high_m)
            depth[hit], ids[hit] = t[hit], cls

        with np.errstate(divide="ignore", invalid="ignore"):
            paint(-1.0 / ray_z, -0.01, 0.01, ClassId.SIDEWALK)
            paint((np.where(ray_y > 0, HALF_WIDTH_M, -HALF_WIDTH_M) - self.y) / ray_y, 0.0, WALL_M, ClassId.WALL)
            a = ray_x**2 + ray_y**2
            for ox, oy, vx, vy, radius in self.obstacles:
                dx, dy = ox - self.x, oy - self.y
                if dx * dx + dy * dy > 200 or dx * c + dy * s < -1:
                    continue
                b = ray_x * dx + ray_y * dy
                root = b * b - a * (dx * dx + dy * dy - radius**2)
                t = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, -1.0)
                paint(t, 0.0, TOP_M, ClassId.PERSON if vx or vy else ClassId.POLE)
        return depth, ids


class CutStreet(ToyStreet):
    """A toy street whose world begins again at one step, which shows what was seen before it, as `Chair.cut` does."""

    def __init__(self, at: int, camera: CameraConfig, max_steps: int) -> None:
        super().__init__(camera, max_steps)
        self.at, self.steps = at, 0

    def step(self, action):
        self.steps += 1
        seen, *rest = super().step(action)
        if self.steps == self.at:
            self.shown = self.seen
            return self.shown, 0.0, False, True, {**rest[-1], WORLD_RESTARTED: True}
        self.seen = seen
        return seen, *rest


def camera_rays(camera: CameraConfig) -> np.ndarray:
    """Body-frame directions per metre of depth, (H * W, 3), row by row from the top left."""
    h, w = camera.height_px, camera.width_px
    focal = w / 2 / math.tan(math.radians(camera.hfov_deg) / 2)
    right, down = np.meshgrid((np.arange(w) + 0.5 - w / 2) / focal, (np.arange(h) + 0.5 - h / 2) / focal)
    pitch = math.radians(camera.pitch_deg)
    forward = math.cos(pitch) + down * math.sin(pitch)
    up = math.sin(pitch) - down * math.cos(pitch)
    return np.stack([forward, -right, up], axis=-1).reshape(-1, 3)


class WindowedStreet(gym.Wrapper):
    """The toy street with a window of images, as the real environment has it."""

    def __init__(self, frames: int, camera: CameraConfig | None = None, max_steps: int = 400) -> None:
        super().__init__(ToyStreet(camera, max_steps))
        self.window = FrameStacker(frames)
        self.observation_space = window_observation_space(self.env.observation_space, frames)

    def reset(self, **options):
        observation, info = self.env.reset(**options)
        self.window.reset()
        return self.window.add(observation), info

    def step(self, action):
        observation, *rest = self.env.step(action)
        return self.window.add(observation), *rest


def load_checkpoint(
    folder: Path, model: SeqDQN, alive: Callable[[], object] = lambda: None
) -> _Restored[QTrainingProgress]:
    """Bring a learner to the newest sound checkpoint."""
    return _restore_newest(folder, make_checkpoint_restorer(model, alive))


def explores(start: float, end: float, **learn: Any) -> LearnConfig:
    """Q-learning alone: no first phase, no imitation, unscaled rewards, any action explored."""
    plain = {"phase1_steps": 0, "margin": 0.0, "reward_scale": 1.0, "exploration": "uniform"}
    return LearnConfig(**{**plain, "epsilon_start": start, "epsilon_end": end, **learn})


def q_config(camera: CameraConfig, **learn: Any) -> RunConfig:
    """A configuration of Q-learning with this camera."""
    return RunConfig(cameras=(camera,), learn=LearnConfig(**learn))


def q_learner(config: RunConfig, seed: int = 0, envs: int = 1, max_steps: int = 400) -> SeqDQN:
    """A fresh learner of the toy street, in so many seats."""
    return build_q_learner(config, DummyVecEnv([lambda: ToyStreet(config.eye, max_steps)] * envs), seed)


def make_replay(size: int, space: gym.spaces.Dict, seats: int = 1, **chosen: Any) -> FrameReplay:
    """A replay memory of 81 actions for so many seats; see `memory_of`."""
    return FrameReplay(size, space, gym.spaces.Discrete(81), device="cpu", n_envs=seats, **memory_of(**chosen))


def memory_of(seed: int = 0, **learn: Any) -> dict[str, Any]:
    """How a replay memory is made: of single steps and their own rewards, unless it is said otherwise."""
    plain = {"n_step": 1, "gamma": 0.99, "precrash_share": 0.0}
    return {"settings": LearnConfig(**{**plain, **learn}), "seed": seed}
