"""A run on disk.

- manifest.json: versions, seed, town, hashes, git revision, command, status (running, done,
  interrupted)
- config.json: the resolved configuration
- plant.toml: the wheelchair, when it is the user's own
- metrics.csv: one row an episode; columns *_s_wall hold wall-clock time and differ between equal
  runs
- steps.csv: KPI 1 of the agent's own choice, one row for each 100 steps
- events.jsonl: what happened besides (phase switch, checkpoints, resumes, the end)
- checkpoints/: step-00005000/ ..., or round-000/ ..., see agents/runs/checkpoint.py
- learned_data.json: the segments of other data folders that are learned from, in rounds
- policies/: phase1/, final/
"""

import contextlib
import json
import platform
import shlex
import subprocess
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Final, Literal, Self

from wcsim.agents.policy_api import BASELINES, UPPER_BOUNDS
from wcsim.agents.runs.data_folder import DATA, SEGMENTS
from wcsim.agents.runs.policy_file import (
    POLICY_JSON,
    SHIPPED,
    STAGES,
    find_shipped_policy,
    parse_policy_name,
)
from wcsim.agents.runs.transfer import custom_class_names, sign_custom_classes
from wcsim.config import RunConfig, parse, resolve
from wcsim.config.load import Layer
from wcsim.config.plant import read_own_plant_bytes
from wcsim.config.run_file import RunManifestFile
from wcsim.core.files import sha256_from_text, write_bytes, write_json
from wcsim.core.processes import run_command
from wcsim.core.reading import METRIC_LINES, RUN, JsonObject, escape, is_file, is_folder, read_lines
from wcsim.core.reading import read_json as read_bounded_json
from wcsim.core.sources import read_package_version
from wcsim.errors import ConfigError, PolicyError, meant
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.overrides import Override

MANIFEST: Final = "manifest.json"
CONFIG: Final = "config.json"
EVENTS: Final = "events.jsonl"
METRICS: Final = "metrics.csv"
STEPS: Final = "steps.csv"
PLANT: Final = "plant.toml"
_CHECKPOINTS: Final = "checkpoints"
_POLICIES: Final = "policies"

# Packages whose versions a manifest names.
PACKAGES: Final = (
    "wcsim",
    "torch",
    "stable-baselines3",
    "gymnasium",
    "numpy",
    "libsumo",
    "pybullet",
)

# In a manifest only while a longer run is written.
_TRANSIENT: Final = frozenset({"config_was_sha256", "files_to_come_sha256"})
# In a manifest of several clients only, or for a moment.
_NOT_OF_ONE_NETWORK: Final = frozenset({"clients", "files_sha256", "seal"}) | _TRANSIENT

# Equal in a run that is resumed and the run that resumes it.
_SAME_WHEN_RESUMED: Final = ("seed", "town_sha256", "more_towns", "rewards")

Status = Literal["running", "done", "interrupted"]
Complete = Callable[[RunConfig], Layer]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunManifest(RunInfo):
    """What a run was made with."""

    config_sha256: str
    versions: dict[str, str]
    git_revision: str
    status: Status = "running"
    steps: int = 0
    own_code: str = ""  # mark of the user's own classes, see agents/runs/transfer.py

    @property
    def info(self) -> RunInfo:
        """The part of it that a resumed run keeps."""
        return RunInfo(**{each.name: getattr(self, each.name) for each in fields(RunInfo)})


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedRun:
    """A run as it is going to be: every setting is decided."""

    config: RunConfig
    out: Path  # the run folder, new or empty; with `resume` that of an interrupted run
    info: RunInfo

    # Continue from the newest sound checkpoint, in a new episode; without one start again.
    resume: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFolder:
    """An existing run; `manifest` is as it was read or written last."""

    path: Path
    config: RunConfig
    manifest: RunManifest

    @property
    def checkpoints(self) -> Path:
        """Where checkpoints are."""
        return self.path / _CHECKPOINTS

    def policy(self, stage: str) -> Path:
        """Where the policy of a stage ("phase1" or "final") is, whether it exists or not."""
        return self.path / _POLICIES / stage

    def manifest_sha256(self) -> str:
        """Digest of what the run was made with, the same before and after it ends."""
        manifest = replace(self.manifest, status="running", steps=0)
        return sha256_from_text(json.dumps(asdict(manifest), sort_keys=True))

    def with_status(self, status: Status, steps: int) -> Self:
        """Write a new status into the manifest."""
        manifest = replace(self.manifest, status=status, steps=steps)
        write_json(self.path / MANIFEST, asdict(manifest))
        return replace(self, manifest=manifest)

    def event(self, kind: str, **values: str | int | float) -> None:
        """Add a line to events.jsonl; on a full disk it is left out."""
        line = json.dumps({"event": kind, **values}, allow_nan=False) + "\n"
        with contextlib.suppress(OSError), (self.path / EVENTS).open("a", encoding="utf-8") as file:
            file.write(line)


def has_results(run: Path) -> bool:
    """Whether an episode, a segment, a checkpoint or a policy was saved in a run folder."""
    metrics = run / METRICS
    lines = sum(1 for _ in read_lines(metrics, METRIC_LINES)) if metrics.is_file() else 0
    folders = (_CHECKPOINTS, _POLICIES, f"{DATA}/{SEGMENTS}")
    # The first line names the columns.
    return lines > 1 or any(any(run.glob(f"{each}/*")) for each in folders)


def make_run_manifest(
    config: RunConfig, info: RunInfo, networks: Collection[str] = ()
) -> RunManifest:
    """A manifest for a run that starts now.

    Args:
        config: The run's configuration.
        info: Seed, town, command and the user's own classes.
        networks: The networks of all clients; by default the configuration's.
    """
    versions = {name: read_package_version(name) for name in PACKAGES}
    versions["python"] = platform.python_version()
    classes = custom_class_names(info.hook, info.rewards, networks or (config.learn.network,))
    return RunManifest(
        **{each.name: getattr(info, each.name) for each in fields(info)},
        config_sha256=config.digest(),
        versions=versions,
        git_revision=_git_revision(),
        own_code=sign_custom_classes(classes),
    )


def format_resume_command(path: Path) -> str:
    """The command that resumes a run, as it can be typed.

    >>> format_resume_command(Path("runs/a b"))
    "wcsim resume 'runs/a b'"
    """
    return shlex.join(["wcsim", "resume", str(path)])


def require_empty_folder(path: Path) -> None:
    """Raise PolicyError when a folder exists and is not empty."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise PolicyError(
            f"{path} exists and is not empty; choose another --out, or continue that run: "
            f"{format_resume_command(path)}"
        )


def create_run_folder(path: Path, config: RunConfig, manifest: RunManifest) -> RunFolder:
    """Make a new run folder.

    Raises:
        PolicyError: The folder exists and is not empty.
        ConfigError: The user's own plant file cannot be read.
    """
    require_empty_folder(path)
    plant = read_own_plant_bytes(config.chair.plant)
    (path / _CHECKPOINTS).mkdir(parents=True)
    (path / _POLICIES).mkdir()
    if plant:
        write_bytes(path / PLANT, plant)
    write_bytes(path / CONFIG, config.model_dump_json(indent=2).encode())
    write_json(path / MANIFEST, asdict(manifest))
    # Without a plant of its own the folder fixes nothing more.
    saved = resolve(config, _saved_plant(path)) if plant else config
    return RunFolder(path=path, config=saved, manifest=manifest)


def open_run(path: Path) -> RunFolder:
    """Open an existing run.

    Raises:
        PolicyError: The folder is not a run, or a file in it is damaged.
    """
    data = read_run_json(path, MANIFEST)
    config = read_run_json(path, CONFIG)
    if "clients" in data:
        names = ", ".join(str(path / name) for name in data["clients"])
        raise PolicyError(f"{path} is a run of several clients; name one of them: {names}")
    manifest = run_manifest_from_json(data, path)
    try:
        resolved = parse(RunConfig, config, str(path / CONFIG))
        if is_file(path / PLANT):
            resolved = resolve(resolved, _saved_plant(path))
    except ConfigError as error:
        raise PolicyError(str(error)) from None
    return RunFolder(path=path, config=resolved, manifest=manifest)


def run_manifest_from_json(data: JsonObject, path: Path) -> RunManifest:
    """The manifest in the data of a run's file. Raises PolicyError when it is none."""
    checked = _checked_manifest(data, path / MANIFEST).model_dump(exclude=set(_NOT_OF_ONE_NETWORK))
    checked["overrides"] = tuple(Override(**row) for row in checked["overrides"])
    return RunManifest(**checked)


def _checked_manifest(data: JsonObject, file: Path) -> RunManifestFile:
    try:
        return parse(RunManifestFile, data, escape(file))
    except ConfigError as error:
        raise PolicyError(f"{error}: not a manifest of this version; train again") from None


def _saved_plant(path: Path) -> Layer:
    """The plant in a run folder: later changes of the user's file do not reach the run."""
    return {"chair": {"plant": str(path / PLANT)}} if is_file(path / PLANT) else None


def resolve_data_folders(config: RunConfig) -> dict[str, dict[str, list[str]]]:
    """The absolute paths of a configuration's data folders: a run may be resumed elsewhere."""
    return {"collect": {"data": [str(Path(folder).absolute()) for folder in config.collect.data]}}


def policy_folder_from_name(name: str) -> Path:
    """The policy folder that `name` means, whatever the level of assistance behind it (`RUN@0.2`).

    A name is `shipped`, a policy folder, a run (its final policy), or `RUN:phase1`.

    Raises:
        PolicyError: There is no such policy.
    """
    named = parse_policy_name(name)
    if named.kind == "shipped":
        return find_shipped_policy()
    if not named.stage and is_file(named.folder / POLICY_JSON):
        return named.folder
    stage = named.stage or STAGES[-1]
    if stage not in STAGES:
        known = " or RUN:".join(STAGES)
        raise PolicyError(
            f"policy {escape(named.place)!r}: unknown stage {escape(stage)!r}; expected RUN, "
            f"RUN:{known}, or module:Class of your own"
        )
    if not is_folder(named.folder):
        names = (*BASELINES, *UPPER_BOUNDS)
        raise PolicyError(
            f"{escape(named.folder)} is not a run: no such folder; expected one that `wcsim "
            f"train` made, {SHIPPED}, module:Class of your own, or a baseline: "
            f"{', '.join(names)}{meant(str(named.folder), (SHIPPED, *names))}"
        )
    run = open_run(named.folder)
    policy = run.policy(stage)
    if not is_file(policy / POLICY_JSON):
        stages = [each for each in STAGES if is_file(run.policy(each) / POLICY_JSON)]
        raise PolicyError(
            f"run {escape(named.folder)} has no policy {stage!r} (it has: "
            f"{', '.join(stages) or 'none'}; status: {run.manifest.status}); "
            f"continue it: {format_resume_command(named.folder)}"
        )
    return policy


def run_from_policy_name(name: str) -> RunFolder | None:
    """The run of a policy; None for a policy folder that was copied out of its run.

    Raises:
        PolicyError: There is no such policy.
    """
    folder = policy_folder_from_name(name).resolve().parent.parent
    return open_run(folder) if is_file(folder / MANIFEST) else None


def read_run_json(path: Path, name: str) -> JsonObject:
    """A JSON object among a run's files; a manifest's entries have their types and bounds.

    Raises:
        PolicyError: There is no such file, or it is none.
    """
    file = path / name
    if not is_file(file):
        raise PolicyError(
            f"{escape(path)} is not a run: it has no {name}; expected a folder that `wcsim train` "
            "made"
        )
    data = read_bounded_json(file, RUN)
    if name == MANIFEST:
        return _checked_manifest(data, file).model_dump(mode="json", exclude_unset=True)
    return data


def open_or_create_run(run: ResolvedRun, complete: Complete) -> RunFolder:
    """A new run folder, or that of a run to resume with equal settings, seed, town and rewards.

    Args:
        run: The run.
        complete: Settings that a configuration leaves to the network. They are laid over both
            configurations before these are compared.

    Raises:
        PolicyError: The folder is not empty, no run, or one of another run.
        ConfigError: The user's own plant file cannot be read.
    """
    if not run.resume:
        return create_run_folder(run.out, run.config, make_run_manifest(run.config, run.info))
    folder = open_run(run.out)
    other = [
        key for key in _SAME_WHEN_RESUMED if getattr(folder.manifest, key) != getattr(run.info, key)
    ]
    if read_own_plant_bytes(run.config.chair.plant) != read_own_plant_bytes(
        folder.config.chair.plant
    ):
        other.append("plant")
    requested = resolve(run.config, _saved_plant(run.out))
    was = resolve(folder.config, complete(folder.config))
    if was != resolve(requested, complete(requested)) or other:
        raise PolicyError(
            f"{run.out} was made with another {', '.join(other) or 'configuration'}; resume with "
            "its own"
        )
    return folder


def extend_run_steps(run: Path, steps: int, fade: float | None = None) -> None:
    """Write another number of steps in all into a run's configuration, and leave all else.

    Killed between two files, it leaves a run that can be resumed, and that can be extended again.

    Args:
        run: The run folder.
        steps: Steps in all.
        fade: Another `learn.learning_rate_fade`; None leaves it.

    Raises:
        PolicyError: It is no run, or cannot have so many.
        DiskFullError: There is no room.
    """
    data = read_run_json(run, CONFIG)
    manifest = read_run_json(run, MANIFEST)
    try:
        was_sha256 = parse(RunConfig, data, str(run / CONFIG)).digest()
        data["learn"]["total_steps"] = steps
        if fade is not None:
            data["learn"]["learning_rate_fade"] = fade
        config = parse(RunConfig, data, str(run / CONFIG))
    except (ConfigError, TypeError, KeyError) as error:
        raise PolicyError(f"{run / CONFIG}: {error}") from None
    # The manifest knows both hashes while the configuration is replaced.
    manifest = {**manifest, "config_sha256": config.digest()}
    write_json(run / MANIFEST, {**manifest, "config_was_sha256": was_sha256})
    write_json(run / CONFIG, data)
    manifest.pop("config_was_sha256", None)
    write_json(run / MANIFEST, manifest)


def _git_revision() -> str:
    """The revision of wcsim's checkout, with a + when it was changed; "" outside of one."""
    # The checkout is named: git would take any repository around an installed wcsim for it.
    checkout = Path(__file__).resolve().parents[3]
    git = ["git", f"--git-dir={checkout / '.git'}", f"--work-tree={checkout}"]
    describe = ["describe", "--always", "--dirty=+", "--abbrev=40", "--exclude=*"]
    try:
        done = run_command([*git, *describe], 10.0)
    except (OSError, subprocess.TimeoutExpired):  # also a disk that has no room for its answer
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
