"""Small trainings in rounds, and what came of them: for tests that do the same one in different ways."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.agents.danger.sights import a_segment, write_segment
from tests.support.worlds import dqn_config
from wcsim.agents.rounds.drive_segment import SegmentOrder
from wcsim.agents.rounds.train_rounds import DATA, train_danger
from wcsim.agents.runs.data_folder import read_data_manifest, segment_path_from_name
from wcsim.agents.runs.run_folder import ResolvedRun
from wcsim.config import RunConfig
from wcsim.core import files
from wcsim.server.specs import RunInfo
from wcsim.server.workers.machines import WorkerPoolSettings
from wcsim.towns.scenario.town import find_town, streets_hash

SMALL = (
    *("learn.head=danger", "collect.rounds=3", "collect.segments=2", "collect.ticks=12", "collect.chairs=2"),
    *("collect.scene_share=0", "danger.updates=4", "danger.batch=8", "collect.network_share=1.0"),
    *("sensors.odometry=typical", "env.observe_gyro=true"),
)


class NoiseWorkers:
    """Whoever asks gets streets of noise, which follow from the key; a network has to be where an order says."""

    def __init__(self, config: RunConfig, data: Path, machines: WorkerPoolSettings, logs: Path) -> None:
        self._folder = data

    def __enter__(self) -> NoiseWorkers:
        return self

    def __exit__(self, *exception: object) -> None:
        """Nobody works."""

    def submit(self, orders: Sequence[SegmentOrder]) -> None:
        assert all(not order.policy or Path(order.policy, "policy.json").is_file() for order in orders)

    def wait(self, orders: Sequence[SegmentOrder], told: object) -> dict[str, str]:
        self.submit(orders)
        paths = {segment_path_from_name(self._folder, order.key.name): order.key for order in orders}
        return {path.name: write_segment(path, a_segment(seed=key.round + key.index)) for path, key in paths.items()}


def run_in(corner: Path, out: Path, *overrides: str, resume: bool = False) -> ResolvedRun:
    town = find_town(str(corner))
    info = RunInfo(seed=3, town=town.name, town_sha256=streets_hash(town))
    return ResolvedRun(config=dqn_config(*SMALL, *overrides), out=out, info=info, resume=resume)


def train_in(corner: Path, out: Path, *overrides: str, resume: bool = False, **more: Any) -> None:
    """Train the small run in `out`; see `train_danger`."""
    train_danger(run_in(corner, out, *overrides, resume=resume), find_town(str(corner)), **more)


def outcome(out: Path) -> tuple[str, str]:
    """SHA-256 of the data and of the weights."""
    return read_data_manifest(out / DATA).data_sha256, weights_of(out)


def weights_of(out: Path) -> str:
    """SHA-256 of the weights alone."""
    return files.sha256_from_file(out / "policies" / "final" / "weights.safetensors")


def rows_of(out: Path) -> list[dict]:
    """The pieces of work that a cluster did."""
    return [json.loads(line) for line in (out / "cluster" / "pieces.jsonl").read_text().splitlines()]
