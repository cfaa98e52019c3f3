"""Run a short hand-written street scene with a fixed seed, record its trace, and report what happened; or film it.

`python -m wcsim.scenes.run FOLDER TRACE` runs one scene and writes its facts as a line of JSON.
"""

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np

from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import RolloutStep, rollout
from wcsim.config import CameraConfig, RunConfig
from wcsim.config.scene import SceneFile, SceneSeat
from wcsim.core.own_folder import WORK_PREFIX, create_temporary_folder
from wcsim.core.processes import run_command
from wcsim.errors import TownError, WcsimError
from wcsim.log.fingerprint import make_engine_fingerprint
from wcsim.log.records import Header, with_fields, world_state_from_snapshot
from wcsim.log.writer import LogWriter
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.scenes.meter import Facts, SceneMeter
from wcsim.towns.scene_folders.build import build_scene, scene_config, seat_specs
from wcsim.types import ClassId, ClientSnapshot, Joystick, Snapshot
from wcsim.types.chair import AT_REST
from wcsim.users.recordings.recorded_user import find_user
from wcsim.view.map import street_video
from wcsim.view.pictures import captioned

_PINNED_LIBM = "glibc.cpu.hwcaps=-AVX2,-AVX2_Usable,-FMA,-FMA_Usable,-FMA4,-AVX512F,-AVX512VL,-AVX"
"""Keeps the C library to the code that every x86-64 CPU runs, because PyBullet's results depend on its sin and cos."""

_RUN_TIMEOUT_S = 240
_BAD_SCENE = 2
"""Exit code of a scene's process that has printed what is wrong with the scene."""
TRACE_EVERY = 10
"""Ticks from one record of a golden trace to the next.

Its last tick has one, and a hash covers all ticks up to it.
"""

_SMALL_CAMERAS = (CameraConfig(width_px=16, height_px=12),)
_FILM_CAMERA = CameraConfig(width_px=480, height_px=360, rgb=True)
_FILM_SPAN_M = 40.0


def _run_scene(folder: Path, trace: Path) -> Facts:
    """Build and run the scene in `folder`, write its trace, and return what happened.

    Raises TownError when the scene cannot be built or run.
    """
    with _open_scene(folder) as (world, scene), LogWriter(trace, _header(world, scene)) as writer:
        meter = SceneMeter(
            world.snapshot, scene, world.street, plant_spec(world.config.chair).outline
        )
        digest = hashlib.blake2b(digest_size=8)
        last = _ticks(world, scene)
        for step in play(world, scene):
            snapshot = step.after
            meter.add(snapshot, world.config.world.tick_s)
            digest.update(snapshot.state_hash.encode())
            if snapshot.tick % TRACE_EVERY == 0 or snapshot.tick == last:
                writer.append(
                    with_fields(
                        world_state_from_snapshot(snapshot, step.commands),
                        state_hash=digest.hexdigest(),
                    )
                )
        return meter.facts()


@contextmanager
def _open_scene(
    folder: Path, cameras: tuple[CameraConfig, ...] = _SMALL_CAMERAS
) -> Iterator[tuple[World, SceneFile]]:
    """The world of a scene before its first tick; tiny cameras, because a scene is about motion.

    Raises TownError when the scene cannot be built, or a seat starts where there is no street.
    """
    with create_temporary_folder() as work:
        try:
            town, scene = build_scene(folder, work)
            specs = seat_specs(folder, scene, town.file.origin_m)
            world = World(
                town,
                scene_config(scene, RunConfig(cameras=cameras)),
                specs,
                scene.seed,
                find_user=find_user,
            )
        except WcsimError as error:
            raise TownError(_without_work(str(error), folder)) from None
        with world:
            _check_starts(world, scene, folder)
            yield world, scene


def play(world: World, scene: SceneFile) -> Iterator[RolloutStep]:
    """Every tick of a scene.

    Who has arrived stays there, and who has crashed is not driven any more.
    """
    done = set(_done(world.snapshot, scene))

    def drive(now: ClientSnapshot) -> Joystick:
        at_s = now.tick * world.config.world.tick_s
        return AT_REST if now.seat in done else _joystick(now, scene.seats[now.seat], at_s)

    drivers = dict.fromkeys(range(len(scene.seats)), drive)
    for step in islice(rollout(world, drivers), _ticks(world, scene)):
        done.update(_done(step.after, scene))
        yield step


def run_in_child(folder: Path, trace: Path) -> Facts:
    """The same as `_run_scene` in a process of its own, with the C library pinned, so that hashes are comparable."""
    command = [sys.executable, "-m", "wcsim.scenes.run", str(folder), str(trace)]
    try:
        done = run_command(
            command, _RUN_TIMEOUT_S, env={**os.environ, "GLIBC_TUNABLES": _PINNED_LIBM}
        )
    except subprocess.TimeoutExpired:
        raise TownError(
            f"scene {folder.name} did not end within {_RUN_TIMEOUT_S} s; shorten it"
        ) from None
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1][:800]
        known = done.returncode == _BAD_SCENE
        raise TownError(
            reason
            if known
            else f"{folder}: its process ended with exit code {done.returncode}: {reason}"
        )
    facts: Facts = json.loads(done.stdout.strip().splitlines()[-1])
    return facts


def _ticks(world: World, scene: SceneFile) -> int:
    return round(scene.duration_s / world.config.world.tick_s)


def _without_work(text: str, folder: Path) -> str:
    """A message about copies in a working folder that is gone by now, as one about the scene's own files."""
    text = text.partition("; see what it says")[0]
    text = re.sub(rf"\S*/{WORK_PREFIX}[\w-]+/\w[\w-]*\.", f"{folder}/*.", text)
    return text if text.startswith(f"{folder}") else f"{folder}: {text}"


def _header(world: World, scene: SceneFile) -> Header:
    return Header(
        town=scene.name,
        seed=scene.seed,
        tick_s=world.config.world.tick_s,
        seats=len(scene.seats),
        fingerprint=make_engine_fingerprint(),
    )


def _check_starts(world: World, scene: SceneFile, folder: Path) -> None:
    """Refuse a chair that would start beside the street or inside something. Raises TownError."""
    grid = world.street.grid
    starts = [seat.spec.start for seat in world.seats if seat.spec.start is not None]
    for i, (start, wanted) in enumerate(zip(starts, scene.seats, strict=True)):
        here_W_m = np.array(start.p_W_m)
        inside = float(grid.clearance_at(here_W_m)) <= 0.0
        if inside or int(grid.class_at(here_W_m)) == ClassId.VOID:
            where = "inside something solid" if inside else "on no ground"
            raise TownError(
                f"{folder / 'scene.toml'}: seat {i} starts at {list(wanted.start_m)}, which is {where}; "
                "correct start_m (net coordinates)"
            )


def _done(snapshot: Snapshot, scene: SceneFile) -> Iterator[int]:
    """The seats that have reached their goal, or crashed, with this tick."""
    for client, wanted in zip(snapshot.clients, scene.seats, strict=True):
        if client.events.crashed or (client.events.arrived and wanted.goal_m is not None):
            yield client.seat


def _joystick(now: ClientSnapshot, wanted: SceneSeat, at_s: float) -> Joystick:
    if wanted.joystick is not None:
        return Joystick(*wanted.joystick)
    if wanted.script:
        begun = [step for step in wanted.script if step[0] <= at_s + 1e-9]
        return Joystick(*begun[-1][1:]) if begun else AT_REST
    return now.user


def film_scene(folder: Path, path: Path) -> None:
    """Run a scene and write it as a video (.webm).

    Raises TownError or ConfigError as the parts do.
    """
    with (
        _open_scene(folder, (_FILM_CAMERA,)) as (world, scene),
        street_video(path, world, _FILM_SPAN_M) as add,
    ):
        for snapshot in (step.after for step in play(world, scene)):
            frame = snapshot.clients[0].sensors.cameras[0]
            if frame.rgb is not None:
                add(captioned(frame.rgb, f"{scene.name} {snapshot.time_s:.1f} s"))


def _main() -> int:
    """Run the scene that the command line names."""
    try:
        facts = _run_scene(Path(sys.argv[1]), Path(sys.argv[2]))
    except WcsimError as error:
        sys.stderr.write(f"{error}\n")
        return _BAD_SCENE
    sys.stdout.write(json.dumps(facts) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(_main())
