"""Run a short hand-written street scene with a fixed seed, record its trace, and say what happened in it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from wcsim import frames
from wcsim.bridge.fingerprint import fingerprint
from wcsim.bridge.scene_facts import SceneFacts, SceneMeter, facts_from_line
from wcsim.bridge.trace import TraceHeader, TraceWriter, record_of
from wcsim.bridge.world import World
from wcsim.config import CameraConfig, RunConfig, SceneFile, SceneSeat
from wcsim.errors import TownError
from wcsim.towns.scenes import build_scene
from wcsim.types import ClientSnapshot, Command, Joystick, SeatSpec, StartSpec

GOLDEN = "golden.trace"
PINNED_LIBM = "glibc.cpu.hwcaps=-AVX2,-AVX2_Usable,-FMA,-FMA_Usable,-FMA4,-AVX512F,-AVX512VL,-AVX"
"""Keeps the C library to the code that every x86-64 CPU runs, because PyBullet's results depend on its sin and cos."""

RUN_TIMEOUT_S = 240


def run_scene(folder: Path, trace: Path) -> SceneFacts:
    """Build and run the scene in `folder`, write its trace, and return what happened.

    Raises TownError when the scene cannot be built or run.
    """
    with tempfile.TemporaryDirectory(prefix="wcsim-scene-") as work:
        town, scene = build_scene(folder, Path(work))
        config = _config(scene)
        specs = tuple(_spec(seat, town.file.origin_m) for seat in scene.seats)
        with World(town, config, specs, scene.seed) as world:
            header = TraceHeader(
                name=scene.name,
                seed=scene.seed,
                tick_s=config.world.tick_s,
                seats=len(specs),
                fingerprint=fingerprint(),
            )
            with TraceWriter(trace, header) as writer:
                return _run(world, scene, writer)


def run_in_child(folder: Path, trace: Path) -> SceneFacts:
    """The same in a process of its own, with the C library pinned, so that the trace's hashes are comparable."""
    command = [sys.executable, "-m", "wcsim.bridge.scene_process", str(folder), str(trace)]
    try:
        done = subprocess.run(
            command,
            env={**os.environ, "GLIBC_TUNABLES": PINNED_LIBM},
            capture_output=True,
            text=True,
            timeout=RUN_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise TownError(f"scene {folder.name} did not end within {RUN_TIMEOUT_S} s; shorten it") from None
    if done.returncode != 0:
        raise TownError(f"scene {folder.name} failed: {done.stderr.strip().splitlines()[-1][:300]}")
    return facts_from_line(done.stdout)


def _config(scene: SceneFile) -> RunConfig:
    """The default world with tiny cameras: a scene is about motion, and stays quick."""
    base = RunConfig(cameras=(CameraConfig(width_px=16, height_px=12),))
    world = base.world.model_copy(update={"warmup_s": scene.warmup_s, "attention_share": scene.attention_share})
    return base.model_copy(update={"world": world})


def _spec(wanted: SceneSeat, origin_m: tuple[float, float]) -> SeatSpec:
    start = frames.world_from_net(np.array(wanted.start_m), origin_m)
    goal = frames.world_from_net(np.array(wanted.goal_m or wanted.start_m), origin_m)
    return SeatSpec(
        profile=wanted.profile,
        start=StartSpec(
            p_W_m=(float(start[0]), float(start[1])),
            yaw_rad=frames.yaw_from_sumo(wanted.heading_deg),
            goal_W_m=(float(goal[0]), float(goal[1])),
        ),
    )


def _run(world: World, scene: SceneFile, writer: TraceWriter) -> SceneFacts:
    meter = SceneMeter(world.snapshot)
    for _ in range(round(scene.duration_s / world.config.world.tick_s)):
        before = world.snapshot
        commands = tuple(
            Command(seat=client.seat, tick=before.tick, joystick=_joystick(client, wanted))
            for client, wanted in zip(before.clients, scene.seats, strict=True)
        )
        after = world.tick(commands)
        writer.append(record_of(after, commands))
        meter.add(after, world.config.world.tick_s)
    return meter.facts()


def _joystick(client: ClientSnapshot, wanted: SceneSeat) -> Joystick:
    return Joystick(*wanted.joystick) if wanted.joystick is not None else (client.first or client).user
