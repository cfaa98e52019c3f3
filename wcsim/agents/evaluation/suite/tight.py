"""Blind side and tight places: generated scenes as blocks of a list, one chair each."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from wcsim.agents.evaluation.suite.drive import BlockOrder
from wcsim.config.suite import BlockFile, EpisodeFile
from wcsim.core.constants import RECORDED
from wcsim.errors import TownError
from wcsim.towns.scenario.town import Town
from wcsim.towns.scene_folders.build import build_scene, scene_config, scene_digest, scene_of, seat_specs
from wcsim.towns.scene_folders.families import FAMILIES, write_scene

_SCENE, _TOWN = "scene", "town"
_TICK_S = 0.1


def tight_blocks(seeds: Sequence[int]) -> list[BlockFile]:
    """A block for each family of scenes and each seed."""
    return [_block(family, seed) for family in FAMILIES for seed in seeds]


def open_tight(block: BlockFile, work: Path) -> Town:
    """Write and build a block's scene in `work`. Raises TownError when it is another than the list's."""
    folder = write_scene(block.town, block.seed, work / _SCENE)
    got = scene_digest(folder)
    if got != block.scene_sha256:
        raise TownError(
            f"scene {block.town} {block.seed} has the hash {got[:12]}; expected {str(block.scene_sha256)[:12]}, as "
            "the list says: the list was made by another version of wcsim"
        )
    return build_scene(folder, work / _TOWN)[0]


def in_scene(order: BlockOrder, work: Path) -> BlockOrder:
    """The order with the settings, the seed and the recorded joystick of the scene that `open_tight` wrote."""
    folder = work / _SCENE
    scene = scene_of(folder)
    return replace(order, config=scene_config(scene, order.config), recordings=folder, world_seed=scene.seed)


def _block(family: str, seed: int) -> BlockFile:
    with tempfile.TemporaryDirectory(prefix="wcsim-scene-") as work:
        folder = write_scene(family, seed, Path(work) / _SCENE)
        town, scene = build_scene(folder, Path(work) / _TOWN)
        (spec,) = seat_specs(folder, scene, town.file.origin_m)
        start = spec.start
        if start is None:
            raise TownError(f"scene {family} {seed} has no start; expected one")
        user = spec.profile
        if user.startswith(RECORDED):
            user = f"{RECORDED}{Path(user.removeprefix(RECORDED)).name}"
        return BlockFile(
            part="tight",
            town=family,
            scene_sha256=scene_digest(folder),
            seed=seed,
            episodes=(
                EpisodeFile(
                    start_m=(round(start.p_W_m[0], 4), round(start.p_W_m[1], 4)),
                    heading_rad=round(start.yaw_rad, 6),
                    goal_m=(round(start.goal_W_m[0], 4), round(start.goal_W_m[1], 4)),
                    profile=user,
                    max_steps=round(scene.duration_s / _TICK_S),
                    route_m=0.0,  # what counts is to come through
                    reference_s=scene.duration_s,
                ),
            ),
        )
