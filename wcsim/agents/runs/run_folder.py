"""A run on disk, and what of it travels with a piece of work to machines that have no disk in common with this one.

- manifest.json: versions, seed, town, hashes, git revision, command, status (running, done, interrupted)
- config.json: the resolved configuration
- plant.toml: the wheelchair, when it is the user's own
- metrics.csv: one row an episode, steps.csv: KPI 1 of the agent's own choice, one row for each 100 steps; columns
  *_s_wall hold wall-clock time and differ between equal runs
- events.jsonl: what happened besides (phase switch, checkpoints, resumes, the end)
- checkpoints/: step-00005000/ ..., or round-000/ ..., see agents/runs/checkpoint.py
- learned_data.json: the segments of other data folders that are learned from, in rounds
- policies/: phase1/, final/
"""

from __future__ import annotations

import contextlib
import json
import platform
import shlex
import subprocess
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from wcsim.agents.policy_api import BASELINES, UPPER_BOUNDS
from wcsim.agents.runs.own_code import mark_of, own_classes
from wcsim.agents.runs.policy_file import POLICY_JSON, SHIPPED, STAGES, policy_name, shipped_folder
from wcsim.config import RunConfig, parse, resolve
from wcsim.config.load import Layer
from wcsim.config.plant import plant_text
from wcsim.config.run_file import ManifestFile
from wcsim.core import files
from wcsim.core.constants import RECORDED
from wcsim.core.processes import run_command
from wcsim.core.reading import RUN, escaped, is_file, is_folder
from wcsim.core.reading import read_json as read_bounded_json
from wcsim.core.sources import version_of
from wcsim.errors import ConfigError, PolicyError, TownError, meant
from wcsim.server.specs import RunInfo
from wcsim.server.workers.machines import Parcel
from wcsim.towns.scenario.overrides import Override
from wcsim.towns.scenario.stage import files_of
from wcsim.towns.scenario.town import find_town
from wcsim.users.profiles import is_of_file

MANIFEST, CONFIG, EVENTS = "manifest.json", "config.json", "events.jsonl"
METRICS, STEPS = "metrics.csv", "steps.csv"
PLANT = "plant.toml"
_CHECKPOINTS, _POLICIES = "checkpoints", "policies"
PACKAGES = ("wcsim", "torch", "stable-baselines3", "gymnasium", "numpy", "libsumo", "pybullet")
Status = Literal["running", "done", "interrupted"]
_OF_A_MOMENT = {"config_was_sha256", "files_to_come_sha256"}
_NOT_OF_ONE = {"clients", "files_sha256", "seal", *_OF_A_MOMENT}


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest(RunInfo):
    """What a run was made with."""

    config_sha256: str
    versions: dict[str, str]
    git_revision: str
    status: Status = "running"
    steps: int = 0
    own_code: str = ""  # mark of the user's own classes, see agents/runs/own_code.py

    @property
    def info(self) -> RunInfo:
        """The part of it that a run which goes on keeps."""
        return RunInfo(**{each.name: getattr(self, each.name) for each in fields(RunInfo)})


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedRun:
    """A run as it is going to be: nothing about it is left to be looked up or filled in."""

    config: RunConfig
    out: Path  # the run folder, new or empty; with `resume` that of an interrupted run
    info: RunInfo
    resume: bool = False  # go on from the newest sound checkpoint, in a new episode; without one the run begins again


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFolder:
    """An existing run; `manifest` is as it was read or written last."""

    path: Path
    config: RunConfig
    manifest: Manifest

    @property
    def checkpoints(self) -> Path:
        """Where checkpoints are."""
        return self.path / _CHECKPOINTS

    def policy(self, stage: str) -> Path:
        """Where the policy of a stage ("phase1" or "final") is, whether it exists or not."""
        return self.path / _POLICIES / stage

    def manifest_sha256(self) -> str:
        """Digest of what the run was made with, the same before and after it ends."""
        return files.sha256_text(
            json.dumps(asdict(replace(self.manifest, status="running", steps=0)), sort_keys=True)
        )

    def with_status(self, status: Status, steps: int) -> RunFolder:
        """Write a new status into the manifest."""
        manifest = replace(self.manifest, status=status, steps=steps)
        files.write_json(self.path / MANIFEST, asdict(manifest))
        return replace(self, manifest=manifest)

    def event(self, kind: str, **values: str | int | float) -> None:
        """Add a line to events.jsonl; on a full disk it is left out."""
        with contextlib.suppress(OSError), (self.path / EVENTS).open("a", encoding="utf-8") as file:
            file.write(json.dumps({"event": kind, **values}, allow_nan=False) + "\n")


def make_manifest(config: RunConfig, info: RunInfo, networks: Collection[str] = ()) -> Manifest:
    """A manifest for a run that starts now; `networks` are those of all clients, by default the configuration's."""
    return Manifest(
        **{each.name: getattr(info, each.name) for each in fields(info)},
        config_sha256=config.digest(),
        versions={
            **{name: version_of(name) for name in PACKAGES},
            "python": platform.python_version(),
        },
        git_revision=_git_revision(),
        own_code=mark_of(own_classes(info.hook, info.rewards, networks or (config.learn.network,))),
    )


def how_to_resume(path: Path) -> str:
    """The command that goes on with a run, as it can be typed.

    >>> how_to_resume(Path("runs/a b"))
    "wcsim resume 'runs/a b'"
    """
    return shlex.join(["wcsim", "resume", str(path)])


def require_new(path: Path) -> None:
    """Raise PolicyError when a folder exists and is not empty."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        told = f"choose another --out, or continue that run: {how_to_resume(path)}"
        raise PolicyError(f"{path} exists and is not empty; {told}")


def create_run(path: Path, config: RunConfig, manifest: Manifest) -> RunFolder:
    """Make a new run folder.

    Raises:
        PolicyError: The folder exists and is not empty.
        ConfigError: The user's own plant file cannot be read.
    """
    require_new(path)
    plant = plant_text(config.chair.plant)
    (path / _CHECKPOINTS).mkdir(parents=True)
    (path / _POLICIES).mkdir()
    if plant:
        files.write_bytes(path / PLANT, plant)
    files.write_bytes(path / CONFIG, config.model_dump_json(indent=2).encode())
    files.write_json(path / MANIFEST, asdict(manifest))
    # Without a plant of its own the folder fixes nothing more.
    saved = resolve(config, _saved_plant(path)) if plant else config
    return RunFolder(path=path, config=saved, manifest=manifest)


def open_run(path: Path) -> RunFolder:
    """Open an existing run. Raises PolicyError when the folder is not a run or a file in it is damaged."""
    data, config = read_json(path, MANIFEST), read_json(path, CONFIG)
    if "clients" in data:
        names = ", ".join(str(path / name) for name in data["clients"])
        raise PolicyError(f"{path} is a run of several clients; name one of them: {names}")
    manifest = manifest_of(data, path)
    try:
        resolved = parse(RunConfig, config, str(path / CONFIG))
        if is_file(path / PLANT):
            resolved = resolve(resolved, _saved_plant(path))
    except ConfigError as error:
        raise PolicyError(str(error)) from None
    return RunFolder(path=path, config=resolved, manifest=manifest)


def manifest_of(data: dict[str, Any], path: Path) -> Manifest:
    """The manifest that a run's file holds. Raises PolicyError when it is none."""
    said = _checked_manifest(data, path / MANIFEST).model_dump(exclude=_NOT_OF_ONE)
    said["overrides"] = tuple(Override(**row) for row in said["overrides"])
    return Manifest(**said)


def _checked_manifest(data: dict[str, Any], file: Path) -> ManifestFile:
    try:
        return parse(ManifestFile, data, escaped(file))
    except ConfigError as error:
        raise PolicyError(f"{error}: not a manifest of this version; train again") from None


def _saved_plant(path: Path) -> Layer:
    """The plant that a run folder keeps: what the user's file says later is not that run's."""
    return {"chair": {"plant": str(path / PLANT)}} if is_file(path / PLANT) else None


def whole_data(config: RunConfig) -> dict[str, dict[str, list[str]]]:
    """The whole paths of a configuration's data folders: a run may go on from another place."""
    return {"collect": {"data": [str(Path(folder).absolute()) for folder in config.collect.data]}}


def policy_path(name: str) -> Path:
    """The policy folder that `name` means: `shipped`, a policy folder, a run (its final policy), or `RUN:phase1`.

    A level of assistance behind it (`RUN@0.2`) is left out. Raises PolicyError when there is no such policy.
    """
    named = policy_name(name)
    if named.kind == "shipped":
        return shipped_folder()
    if not named.stage and is_file(named.folder / POLICY_JSON):
        return named.folder
    head, stage = str(named.folder), named.stage or STAGES[-1]
    if stage not in STAGES:
        known = " or RUN:".join(STAGES)
        raise PolicyError(
            f"policy {escaped(named.place)!r}: unknown stage {escaped(stage)!r}; expected RUN, RUN:{known}, or "
            "module:Class of your own"
        )
    if not is_folder(Path(head)):
        names = (*BASELINES, *UPPER_BOUNDS)
        raise PolicyError(
            f"{escaped(head)} is not a run: no such folder; expected one that `wcsim train` made, {SHIPPED}, "
            f"module:Class of your own, or a baseline: {', '.join(names)}{meant(head, (SHIPPED, *names))}"
        )
    run = open_run(Path(head))
    found = run.policy(stage)
    if not is_file(found / POLICY_JSON):
        have = ", ".join(s for s in STAGES if is_file(run.policy(s) / POLICY_JSON)) or "none"
        raise PolicyError(
            f"run {escaped(head)} has no policy {stage!r} (it has: {have}; status: {run.manifest.status}); "
            f"continue it: {how_to_resume(Path(head))}"
        )
    return found


def run_of(name: str) -> RunFolder | None:
    """The run that a policy comes from; None for a policy folder that was copied out of its run.

    Raises PolicyError when there is no such policy.
    """
    folder = policy_path(name).resolve().parent.parent
    return open_run(folder) if is_file(folder / MANIFEST) else None


def _git_revision() -> str:
    """The revision of the checkout that wcsim runs from, with a + when it was changed; "" outside of one.

    The checkout is named: git would take any repository around an installed wcsim for it.
    """
    checkout = Path(__file__).resolve().parents[3]
    of_checkout = ["git", f"--git-dir={checkout / '.git'}", f"--work-tree={checkout}"]
    try:
        done = run_command(
            [*of_checkout, "describe", "--always", "--dirty=+", "--abbrev=40", "--exclude=*"], 10.0
        )
    except (OSError, subprocess.TimeoutExpired):  # also a disk that has no room for its answer
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def read_json(path: Path, name: str) -> dict[str, Any]:
    """A JSON object among a run's files; a manifest's entries are of the right types and within their bounds.

    Raises:
        PolicyError: There is no such file, or it is none.
    """
    file = path / name
    if not is_file(file):
        raise PolicyError(
            f"{escaped(path)} is not a run: it has no {name}; expected a folder that `wcsim train` made"
        )
    data = read_bounded_json(file, RUN)
    if name == MANIFEST:
        return _checked_manifest(data, file).model_dump(mode="json", exclude_unset=True)
    return data


Complete = Callable[[RunConfig], Layer]


def folder_of(run: ResolvedRun, complete: Complete = lambda _: None) -> RunFolder:
    """A new run folder, or the one to go on with when it was made with the same settings, seed, town and rewards.

    Args:
        run: The run.
        complete: Settings that a configuration leaves to the network, laid over two before they are compared.

    Raises:
        PolicyError: The folder is not empty, no run, or one of another run.
        ConfigError: The user's own plant file cannot be read.
    """
    if not run.resume:
        return create_run(run.out, run.config, make_manifest(run.config, run.info))
    folder, kept = open_run(run.out), ("seed", "town_sha256", "more_towns", "rewards")
    other = [key for key in kept if getattr(folder.manifest, key) != getattr(run.info, key)]
    if plant_text(run.config.chair.plant) != plant_text(folder.config.chair.plant):
        other.append("plant")
    wanted = resolve(run.config, _saved_plant(run.out))
    was, now = (resolve(config, complete(config)) for config in (folder.config, wanted))
    if was != now or other:
        raise PolicyError(
            f"{run.out} was made with another {', '.join(other) or 'configuration'}; resume with its own"
        )
    return folder


def extend(run: Path, steps: int, fade: float | None = None) -> None:
    """Write another number of steps in all into a run's configuration; all else in it stays as it was.

    Killed between two files, it leaves a run that goes on as it was, and that can be extended again.

    Args:
        run: Its folder.
        steps: In all.
        fade: Another `learn.learning_rate_fade`; None leaves it.

    Raises:
        PolicyError: It is no run, or cannot have so many.
        DiskFullError: There is no room.
    """
    data, manifest = read_json(run, CONFIG), read_json(run, MANIFEST)
    try:
        was = parse(RunConfig, data, str(run / CONFIG)).digest()
        data["learn"]["total_steps"] = steps
        if fade is not None:
            data["learn"]["learning_rate_fade"] = fade
        config = parse(RunConfig, data, str(run / CONFIG))
    except (ConfigError, TypeError, KeyError) as error:
        raise PolicyError(f"{run / CONFIG}: {error}") from None
    manifest = {**manifest, "config_sha256": config.digest()}
    files.write_json(run / MANIFEST, {**manifest, "config_was_sha256": was})
    files.write_json(run / CONFIG, data)
    files.write_json(
        run / MANIFEST,
        {key: value for key, value in manifest.items() if key != "config_was_sha256"},
    )


@lru_cache(maxsize=256)
def town_parcel(address: str) -> Parcel:
    """A town, as its SUMO files and its town.toml. Raises TownError."""
    town = find_town(address)
    folder, files = town.folder.absolute(), files_of(town, RunConfig())
    outside = [path for path in files if not path.is_relative_to(folder)]
    if outside:
        raise TownError(
            f"town {town.name} has a file outside of its folder, {escaped(outside[0])}; expected all in "
            f"{escaped(folder)}, as the folder is sent to other machines"
        )
    names = tuple(sorted(path.relative_to(folder).as_posix() for path in files))
    inner = "" if Path(town.address).is_dir() else town.sumocfg.name
    return Parcel(address=address, folder=folder, names=names, inner=inner)


def folder_parcel(folder: Path, address: str = "") -> Parcel:
    """The files of a folder, without those in folders of it."""
    names = tuple(path.name for path in sorted(folder.iterdir()) if path.is_file())
    return Parcel(address=address or str(folder), folder=folder.absolute(), names=names)


def require_travels(
    config: RunConfig,
    settings: Collection[str] = (),
    own_code: Collection[str] = (),
    users: Collection[str] = (),
) -> None:
    """Refuse what other machines cannot have: code of the user's own, and files that settings name.

    Args:
        config: Of the run.
        settings: What else is set, as section.key=value.
        own_code: Classes that are named.
        users: Profiles beside those of the configuration.

    Raises:
        ConfigError: It says what, and how to go on without a cluster.
    """
    users = (config.env.profile, *config.collect.profiles, *users)
    words = " ".join((*settings, *config.collect.variants)).split()
    found = [f"class {escaped(name, 80)}" for name in own_code if ":" in name]
    found += [f"user {escaped(user, 80)}" for user in users if is_of_file(user)]
    found += [escaped(word, 80) for word in words if ".toml" in word or RECORDED in word]
    if found:
        raise ConfigError(
            f"--cluster: {', '.join(found)} exists on this machine only and cannot be sent; expected parts of wcsim "
            "alone: leave it out, or drive without --cluster"
        )
