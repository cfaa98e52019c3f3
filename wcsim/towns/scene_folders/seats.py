"""The wheelchairs of a scene as a world takes them, and the settings of its world."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wcsim.config import RunConfig
from wcsim.config.scene import SceneFile, SceneSeat
from wcsim.core import frames
from wcsim.core.constants import RECORDED
from wcsim.towns.scenario.border import require_file
from wcsim.types import SeatSpec, StartSpec

XY = tuple[float, float]


def seat_specs(folder: Path, scene: SceneFile, origin_m: XY) -> tuple[SeatSpec, ...]:
    """The seats of the scene in `folder`, whose town has its origin at `origin_m` of the net.

    Raises:
        TownError: A recording is not there.
    """
    return tuple(_spec(folder, seat, origin_m) for seat in scene.seats)


def scene_config(scene: SceneFile, base: RunConfig) -> RunConfig:
    """The same configuration with the scene's own settings of the world; who looks is not drawn, as it is the scene."""
    own = {"warmup_s": scene.warmup_s, "attention_share": scene.attention_share}
    vary = base.vary.model_copy(update={"attention": {}, "reaction": {}})
    return base.model_copy(update={"world": base.world.model_copy(update=own), "vary": vary})


def _spec(folder: Path, wanted: SceneSeat, origin_m: XY) -> SeatSpec:
    start = frames.world_from_net(np.array(wanted.start_m), origin_m)
    goal = frames.world_from_net(np.array(wanted.goal_m or wanted.start_m), origin_m)
    profile = wanted.profile
    if wanted.recording is not None:
        file = folder / wanted.recording
        require_file(file, folder, folder / "scene.toml")
        profile = f"{RECORDED}{file}"
    return SeatSpec(
        profile=profile,
        start=StartSpec(
            p_W_m=(float(start[0]), float(start[1])),
            yaw_rad=frames.yaw_from_sumo(wanted.heading_deg),
            goal_W_m=(float(goal[0]), float(goal[1])),
        ),
    )
