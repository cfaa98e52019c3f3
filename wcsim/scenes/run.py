"""Runs a short street scene with a fixed seed, records its trace and what happened; or films it.

`python -m wcsim.scenes.run FOLDER TRACE` runs one scene and writes its facts as a line of JSON.
"""

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import islice
from pathlib import Path

import numpy as np

from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import RolloutStep, rollout
from wcsim.config import CameraConfig, RunConfig
from wcsim.config.scene import SceneFile
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
"""Holds the C library to the code that every x86-64 CPU runs.

PyBullet's results depend on its sin and cos.
"""

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


def play(world: World, scene: SceneFile) -> Iterator[RolloutStep]:
    """Every tick of a scene; who has arrived or crashed is not driven any more."""
    done = set(_done(world.snapshot, scene))

    def drive(now: ClientSnapshot) -> Joystick:
        seat, at_s = scene.seats[now.seat], now.tick * world.config.world.tick_s
        if now.seat in done:
            return AT_REST
        if seat.joystick is not None:
            return Joystick(*seat.joystick)
        if seat.script:
            past = [step for step in seat.script if step[0] <= at_s + 1e-9]
            return Joystick(*past[-1][1:]) if past else AT_REST
        return now.user

    drivers = dict.fromkeys(range(len(scene.seats)), drive)
    for step in islice(rollout(world, drivers), _ticks(world, scene)):
        done.update(_done(step.after, scene))
        yield step


def run_in_child(folder: Path, trace: Path) -> Facts:
    """As `_run_scene`, in a process with the C library pinned, so that hashes are comparable."""
    command = [sys.executable, "-m", "wcsim.scenes.run", str(folder), str(trace)]
    env = {**os.environ, "GLIBC_TUNABLES": _PINNED_LIBM}
    try:
        done = run_command(command, _RUN_TIMEOUT_S, env=env)
    except subprocess.TimeoutExpired:
        raise TownError(
            f"scene {folder.name} did not end within {_RUN_TIMEOUT_S} s; shorten it"
        ) from None
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1][:800]
        if done.returncode != _BAD_SCENE:
            code = done.returncode
            reason = f"{folder}: its process ended with exit code {code}: {reason}"
        raise TownError(reason)
    facts: Facts = json.loads(done.stdout.strip().splitlines()[-1])
    return facts


def film_scene(folder: Path, path: Path) -> None:
    """Run a scene and write it as a video (.webm); TownError or ConfigError as the parts do."""
    with (
        _open_scene(folder, (_FILM_CAMERA,)) as (world, scene),
        street_video(path, world, _FILM_SPAN_M) as add,
    ):
        for snapshot in (step.after for step in play(world, scene)):
            frame = snapshot.clients[0].sensors.cameras[0]
            if frame.rgb is not None:
                add(captioned(frame.rgb, f"{scene.name} {snapshot.time_s:.1f} s"))


def _run_scene(folder: Path, trace: Path) -> Facts:
    """Build and run the scene in `folder`, write its trace, and return what happened.

    Raises:
        TownError: The scene cannot be built or run.
    """
    with ExitStack() as held:
        world, scene = held.enter_context(_open_scene(folder))
        header = Header(
            town=scene.name,
            seed=scene.seed,
            tick_s=world.config.world.tick_s,
            seats=len(scene.seats),
            fingerprint=make_engine_fingerprint(),
        )
        writer = held.enter_context(LogWriter(trace, header))
        outline = plant_spec(world.config.chair).outline
        meter = SceneMeter(world.snapshot, scene, world.street, outline)
        digest = hashlib.blake2b(digest_size=8)
        last = _ticks(world, scene)
        for step in play(world, scene):
            snapshot = step.after
            meter.add(snapshot, world.config.world.tick_s)
            digest.update(snapshot.state_hash.encode())
            if snapshot.tick % TRACE_EVERY == 0 or snapshot.tick == last:
                state = world_state_from_snapshot(snapshot, step.commands)
                writer.append(with_fields(state, state_hash=digest.hexdigest()))
        return meter.facts()


@contextmanager
def _open_scene(
    folder: Path, cameras: tuple[CameraConfig, ...] = _SMALL_CAMERAS
) -> Iterator[tuple[World, SceneFile]]:
    """The world of a scene before its first tick; tiny cameras, because a scene is about motion.

    Raises:
        TownError: The scene cannot be built, or a chair would start beside the street or inside
            something.
    """
    with create_temporary_folder() as work:
        try:
            town, scene = build_scene(folder, work)
            specs = seat_specs(folder, scene, town.file.origin_m)
            config = scene_config(scene, RunConfig(cameras=cameras))
            world = World(town, config, specs, scene.seed, find_user=find_user)
        except WcsimError as error:
            # The message is on copies in the working folder, which is removed by then.
            text = str(error).partition("; see what it says")[0]
            text = re.sub(rf"\S*/{WORK_PREFIX}[\w-]+/\w[\w-]*\.", f"{folder}/*.", text)
            text = text if text.startswith(f"{folder}") else f"{folder}: {text}"
            raise TownError(text) from None
        with world:
            grid = world.street.grid
            starts = [seat.spec.start for seat in world.seats if seat.spec.start is not None]
            for i, (start, seat) in enumerate(zip(starts, scene.seats, strict=True)):
                here_W_m = np.array(start.p_W_m)
                inside = float(grid.clearance_at(here_W_m)) <= 0.0
                if inside or int(grid.class_at(here_W_m)) == ClassId.VOID:
                    where = "inside something solid" if inside else "on no ground"
                    raise TownError(
                        f"{folder / 'scene.toml'}: seat {i} starts at {list(seat.start_m)}, "
                        f"which is {where}; correct start_m (net coordinates)"
                    )
            yield world, scene


def _ticks(world: World, scene: SceneFile) -> int:
    return round(scene.duration_s / world.config.world.tick_s)


def _done(snapshot: Snapshot, scene: SceneFile) -> Iterator[int]:
    """The seats that have reached their goal, or crashed, with this tick."""
    for client, seat in zip(snapshot.clients, scene.seats, strict=True):
        if client.events.crashed or (client.events.arrived and seat.goal_m is not None):
            yield client.seat


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
