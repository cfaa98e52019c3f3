"""Recorded steps and settings for tests of danger networks: tiny pictures, streets of noise."""

from pathlib import Path

import numpy as np
import torch

from tests.support.samples import ACTIONS
from tests.support.worlds import dqn_config
from wcsim.agents.danger.dataset import Dataset
from wcsim.agents.runs.data_folder import SAFE, DrivingSegment, segment_to_bytes
from wcsim.config import RunConfig
from wcsim.core import files

HEIGHT_PX, WIDTH_PX = 24, 32
TWO = 'env.camera=["front","rear"]'
SMALL = ("danger.batch=16", "danger.width=8", "sensors.odometry=typical", "env.observe_gyro=true")


class Silent(torch.nn.Module):
    """A head that says nothing, so that another one has to do the work."""

    def forward(self, seen: torch.Tensor, *more: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(seen), 81)


def small_config(*overrides: str) -> RunConfig:
    return dqn_config(*SMALL, *overrides)


def a_segment(rows: int = 24, seed: int = 0, ends: tuple[int, ...] = (9,), cameras: int = 1) -> DrivingSegment:
    """Steps of one chair after the other through noise; what lies ahead is unsafe where the depth is small."""
    rng = np.random.default_rng(seed)
    near = rng.random(rows) < 0.5
    depth = np.where(near[:, None, None], 90, 200) + rng.integers(-20, 21, (rows, cameras * HEIGHT_PX, WIDTH_PX))
    codes = np.full((rows, 81), SAFE, np.uint8)
    codes[np.ix_(near, ACTIONS.points[:, 1] > 0.0)] = 3
    return DrivingSegment(
        depth=depth.astype(np.uint8),
        seg=rng.choice([7, 8, 11, 24, 26], depth.shape).astype(np.uint8),
        imu=(0.02 * rng.normal(size=(rows, 8))).astype(np.float32),
        odometry=np.tile(np.array([0.2, 0.03], np.float32), (rows, 1)),
        stick=np.tile(np.array([0.1, 0.9], np.float32), (rows, 1)),
        wish=np.tile(np.array([0.1, 0.9], np.float32), (rows, 1)),
        action=rng.integers(0, 81, rows).astype(np.uint8),
        driver=np.zeros(rows, np.uint8),
        visible=codes,
        truth=codes.copy(),
        reward=np.zeros(rows, np.float32),
        crashed=np.zeros(rows, np.bool_),
        own=np.zeros(rows, np.bool_),
        ended=np.isin(np.arange(rows), (*ends, rows - 1)),
        delay=np.full(rows, 1, np.uint8),
    )


def write_segment(path: Path, segment: DrivingSegment) -> str:
    """The SHA-256 of its file."""
    files.write_bytes(path, segment_to_bytes(segment))
    return files.sha256_from_file(path)


def lessons_of(config: RunConfig, segment: DrivingSegment, seed: int = 0) -> Dataset:
    """Data of a drive, to draw from."""
    found = Dataset(config)
    found.add(segment)
    found.begin(np.random.default_rng(seed))
    return found


def lectures(config: RunConfig, rows: int = 64, seed: int = 0) -> Dataset:
    """Data of a drive through noise."""
    return lessons_of(config, a_segment(rows, seed, cameras=len(config.eyes)), seed)


def all_of(lessons: Dataset) -> np.ndarray:
    """All steps that there are."""
    return np.arange(len(lessons))


def observation(config: RunConfig, tick: int = 0, seed: int = 0) -> dict[str, np.ndarray]:
    """What a chair of this configuration sees in a street of noise."""
    rng, images = np.random.default_rng((seed, tick)), {}
    for name, camera in config.eyes.items():
        shape = (1, camera.height_px, camera.width_px)
        images[f"{name}depth"] = rng.integers(60, 200, shape).astype(np.uint8)
        images[f"{name}seg"] = rng.choice([7, 8, 11, 24, 26], shape).astype(np.uint8)
    return {
        **images,
        "imu": (0.02 * rng.normal(size=8)).astype(np.float32),
        "odometry": np.array([0.05 + 0.01 * tick, 0.02], np.float32),
        "joystick": np.array([0.3 * np.sin(tick / 5.0), 0.8], np.float32),
    }
