"""Trains a danger network in rounds: drive, learn, drive with the trained network, learn from all.

While the network learns from round n, the worlds already drive round n + 1, with the network of
round n - 1. A segment depends on its key alone. So data and weights depend neither on the number of
worlds nor on failures on the way.
"""

import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import copytree
from typing import Final

import numpy as np
import torch

from wcsim.agents.danger.dataset import Dataset
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.policy import save_danger
from wcsim.agents.networks.device import temporary_torch_settings
from wcsim.agents.rounds.collect_data import SegmentWorkers
from wcsim.agents.rounds.drive_segment import (
    SegmentOrder,
    make_segment_orders,
    require_recordable,
)
from wcsim.agents.runs.checkpoint import (
    STATE,
    Arrays,
    Log,
    Restore,
    checkpoint_number_from_path,
    format_checkpoint_name,
    newest_checkpoint_number,
    restore_newest_checkpoint,
    write_checkpoint,
)
from wcsim.agents.runs.data_folder import (
    DATA,
    FOLLOW,
    NETWORK,
    SEGMENTS,
    DrivingSegment,
    Hashes,
    read_data_manifest,
    read_segment,
    require_same_data_settings,
    sort_segment_names,
    write_data_manifest,
)
from wcsim.agents.runs.metrics import append_round_metrics, require_tensorboard_installed
from wcsim.agents.runs.policy_file import parse_saved
from wcsim.agents.runs.run_folder import (
    METRICS,
    ResolvedRun,
    RunFolder,
    format_resume_command,
    open_or_create_run,
    resolve_data_folders,
)
from wcsim.agents.runs.weights import hash_network_weights
from wcsim.config import RunConfig, parse
from wcsim.config.env import FollowRewardConfig
from wcsim.config.run_file import (
    DangerRuleSettings,
    DangerTrainingCheckpoint,
    LearnedDataFile,
    StickValue,
)
from wcsim.core import files, reading, seeding
from wcsim.core.reading import JsonObject, escape, is_file, read_json
from wcsim.errors import ConfigError, InterruptedRunError, PolicyError, TownError
from wcsim.server.workers.machines import HERE, WorkerPoolSettings
from wcsim.server.workers.scheduler import WorkerStatus
from wcsim.towns.making.asked_town import Wishes, refuse_held_out_town, requested_town
from wcsim.towns.making.maker import make_town
from wcsim.towns.scenario.town import Town, find_town, open_town, streets_hash

LEARNED: Final = "learned_data.json"
_TOWNS: Final = "towns"


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundProgress:
    """Progress within a round."""

    round: int
    rounds: int
    segments: int  # that are finished
    of: int
    learned: int = 0  # updates of this round
    updates: int = 0  # of all rounds, when this one is done
    loss: float = float("nan")
    workers: tuple[WorkerStatus, ...] = ()


Progress = Callable[[RoundProgress], object]


def train_danger(
    run: ResolvedRun,
    town: Town,
    machines: WorkerPoolSettings = HERE,
    progress: Progress = lambda now: None,
    log: Log = lambda text: None,
) -> Path:
    """Do all rounds; the run folder, with data/, checkpoints/ and policies/final.

    Args:
        run: The run; with `resume` it continues after the last complete round.
        town: The first town that it is trained in; see `CollectConfig` for others.
        machines: Where the worlds are; they change nothing but the time.
        progress: Gets the progress.
        log: Gets a line before what takes long, and for each checkpoint that was skipped.

    Raises:
        InterruptedRunError: Ctrl-C; policies/final is that of the last complete round, and `resume`
            continues.
        PolicyError, TownError, ConfigError, WorkersError, DiskFullError: See `_train_rounds` and
            `open_or_create_run`.
    """
    config = run.config
    if config.collect.segments == 0 and not config.collect.data:
        raise ConfigError(
            "collect.segments=0 without collect.data: there is no data to learn from; expected "
            "--data FOLDER, or collect.segments of 1 or more"
        )
    require_recordable(config)
    if config.learn.tensorboard:
        require_tensorboard_installed()
    folder = open_or_create_run(run, resolve_data_folders)
    with files.lock_run_folder(folder.path), temporary_torch_settings(folder.config.learn):
        manifest = folder.manifest
        towns = _find_towns(
            town, manifest.more_towns, folder.config, folder.path, manifest.seed, log
        )
        # Refuse data that cannot be learned from before worlds load.
        read_data_hashes(folder)
        try:
            sha256 = _train_rounds(folder, towns, machines, progress, log)
        except KeyboardInterrupt:
            folder.with_status("interrupted", 0)
            # The newest policy of a complete round becomes that of the run.
            rounds = range(newest_checkpoint_number(folder.checkpoints) + 1)
            policies = [folder.policy(format_checkpoint_name("round", number)) for number in rounds]
            complete = [path for path in policies if path.is_dir()]
            saved = "the segments so far, no policy yet"
            if complete:
                with files.write_folder_atomically(folder.policy("final")) as target:
                    copytree(complete[-1], target, dirs_exist_ok=True)
                saved = "the policy of the complete rounds"
            raise InterruptedRunError(
                f"stopped; {folder.path} holds {saved}; continue it: "
                f"{format_resume_command(folder.path)}"
            ) from None
        folder.with_status("done", folder.config.collect.rounds * folder.config.danger.updates)
        folder.event("done", weights_sha256=sha256)
    return folder.path


def read_data_hashes(run: RunFolder) -> dict[str, Hashes]:
    """The segments of each data folder that a run started with; their SHA-256 by file name.

    Raises:
        PolicyError: A folder is no data folder or has other settings, or `learned_data.json` is
            damaged.
    """
    path = run.path / LEARNED
    if is_file(path):
        return parse_saved(LearnedDataFile, read_json(path, reading.LEARNED), escape(path)).folders
    found = {}
    for folder in resolve_data_folders(run.config)["collect"]["data"]:
        file = read_data_manifest(Path(folder))
        require_same_data_settings(Path(folder), file, run.config)
        found[folder] = file.segments
    return found


def _find_towns(
    first: Town,
    more: Collection[str],
    config: RunConfig,
    folder: Path,
    seed: int,
    log: Log = lambda text: None,
) -> tuple[str, ...]:
    """Folders or names of all towns; those to generate are made if they are missing.

    Args:
        first: The run's own town.
        more: Names of others on the command line.
        config: Of the run.
        folder: Of the run; generated towns lie in it, unless no segment is driven.
        seed: Of the run.
        log: Gets a line for each town that is generated.

    Raises:
        TownError: A town is missing, is meant for tests, or cannot be made.
        ConfigError: One is held out.
        SumoError: One of SUMO's tools failed.
    """
    listed = [find_town(name) for name in config.collect.towns]
    for town in listed:
        if town.split == "test":
            raise TownError(f"collect.towns: {town.name} is a test town; expected training towns")
    towns = [first, *map(requested_town, more), *listed]
    count = config.collect.made_towns if config.collect.segments else 0
    for number in range(count):
        town_seed = seeding.derive_seed(seed, "collect", "town", number)
        out = folder / _TOWNS / f"made-{town_seed}"
        if not out.is_dir():
            log(f"generating town {number + 1} of {count}")
            make_town(out, town_seed, Wishes())
        towns.append(open_town(out))
    for town in towns:
        refuse_held_out_town(town)
    return tuple(str(town.address) for town in towns)


def _train_rounds(
    folder: RunFolder,
    towns: tuple[str, ...],
    machines: WorkerPoolSettings,
    progress: Progress,
    log: Log,
) -> str:
    """Do the rounds that are left; the SHA-256 of the weights.

    Raises:
        TownError: A town is missing.
        ConfigError: The cluster cannot be used, or an input cannot be sent to it.
        WorkersError: Worlds died too often, or there is no machine left.
        PolicyError: A saved file does not fit, there is no data, or the loss is not finite.
        DiskFullError: There is no room.
    """
    config, data = folder.config, folder.path / DATA
    seed, rounds = folder.manifest.seed, config.collect.rounds
    with SegmentWorkers(config, data, machines, folder.path) as workers:
        # 1. In a new run, worlds load while the learner is made.
        if newest_checkpoint_number(folder.checkpoints) < 0:
            workers.submit(_orders(folder, towns, 0))

        # 2. Restore the learner and its data as they were after the last complete round.
        learner = DangerLearner(config, seed, config.danger.updates * rounds)
        restored = restore_newest_checkpoint(folder, _make_restore(learner), log)
        start, segments = 0, Hashes()
        if restored is not None:
            start = checkpoint_number_from_path(restored.path) + 1
            segments = dict(restored.value)
        dataset = Dataset(config)
        for segment in _iter_data_segments(folder):
            dataset.add(segment)
        for name in sort_segment_names(segments):
            dataset.add(read_segment(data / SEGMENTS / name, segments[name]))

        for number in range(start, rounds):
            _train_round(folder, towns, workers, number, learner, dataset, segments, progress)

    # 3. List the data, and save the final policy.
    hashes = {town.name: streets_hash(town) for town in map(find_town, towns)}
    write_data_manifest(data, config, hashes, segments)
    _save_policy(folder, learner, "final")
    return hash_network_weights(learner.net)


def _train_round(
    folder: RunFolder,
    towns: tuple[str, ...],
    workers: SegmentWorkers,
    number: int,
    learner: DangerLearner,
    dataset: Dataset,
    segments: Hashes,
    progress: Progress,
) -> None:
    """Do a round: drive, learn, save. Its segments are added to `dataset` and `segments`."""
    # 1. Wait for the segments of this round, and have those of the next one driven.
    config, data = folder.config, folder.path / DATA
    start_s = time.monotonic()
    orders, rounds = _orders(folder, towns, number), config.collect.rounds
    now = RoundProgress(round=number, rounds=rounds, segments=0, of=len(orders))
    hashes = workers.wait(
        orders,
        lambda count, status: progress(replace(now, segments=count, workers=status)),
    )
    if number + 1 < rounds:
        workers.submit(_orders(folder, towns, number + 1))
    wait_s = time.monotonic() - start_s

    # 2. Add them to the data, and count steps and crashes of the network and of users.
    steps, crashes, by_driver = len(dataset), 0, np.zeros((2, 2), np.int64)
    for name in sorted(hashes):
        segment = read_segment(data / SEGMENTS / name, hashes[name])
        dataset.add(segment)
        crashes += int(segment.crashed.sum())
        for row, driver in enumerate((NETWORK, FOLLOW)):
            driven = segment.driver == driver
            by_driver[row] += driven.sum(), segment.crashed[driven].sum()

    # 3. Learn. Some networks draw with torch as well, as by dropout.
    seed = folder.manifest.seed
    dataset.begin(seeding.make_rng(seed, "agent", "lectures", number))
    torch.manual_seed(seeding.derive_seed(seed, "agent", "learn", number))
    learning = replace(now, segments=now.of)
    loss = learner.learn(
        dataset,
        config.danger.updates,
        lambda done: progress(replace(learning, learned=done)),
    )

    # 4. Save. With its checkpoint a round counts as done, so that comes last.
    segments |= hashes
    _save_policy(folder, learner, format_checkpoint_name("round", number))
    learn_s = time.monotonic() - start_s - wait_s
    append_round_metrics(
        folder.path / METRICS,
        (
            *(number, len(dataset), len(dataset) - steps, dataset.tight_share, crashes),
            *by_driver.ravel().tolist(),
            *(learner.updates, loss, wait_s, learn_s),
        ),
        config.learn.tensorboard,
    )
    _save_round(folder.checkpoints, number, learner, segments)
    progress(replace(learning, updates=learner.updates, loss=loss))


def _orders(folder: RunFolder, towns: tuple[str, ...], number: int) -> list[SegmentOrder]:
    """The segments of a round; the network of the round before the last drives, if there is one."""
    policy = str(folder.policy(format_checkpoint_name("round", number - 2))) if number >= 2 else ""
    collect, seed = folder.config.collect, folder.manifest.seed
    return make_segment_orders(folder.config, towns, seed, number, collect.segments, policy)


def _make_restore(learner: DangerLearner) -> Restore[Hashes]:
    """Restores a learner from a checkpoint; returns the segments that it had learned from."""

    def restore(_: int, state: JsonObject, arrays: dict[str, Arrays]) -> Hashes:
        checkpoint = parse(DangerTrainingCheckpoint, state, STATE)
        sort_segment_names(checkpoint.segments)  # refuses other names
        learner.restore(arrays, checkpoint.updates, checkpoint.loss)
        return checkpoint.segments

    return restore


def _iter_data_segments(run: RunFolder) -> Iterator[DrivingSegment]:
    """The segments of a run's data folders; their hashes are saved before the first is read.

    Raises:
        PolicyError: As `read_data_hashes`; or there is nothing to learn from; or a segment is
            missing, damaged or replaced.
        DiskFullError: There is no room.
    """
    found, path = read_data_hashes(run), run.path / LEARNED
    if not any(found.values()) and run.config.collect.segments == 0:
        raise PolicyError(
            f"{', '.join(map(escape, found)) or 'collect.data'}: holds no data to learn from; "
            "expected segments of `wcsim collect`, or collect.segments of 1 or more"
        )
    if found and not is_file(path):
        files.write_json(path, {"schema_version": 1, "folders": found})
    for folder, segments in found.items():
        for name in sorted(segments):
            try:
                yield read_segment(Path(folder) / SEGMENTS / name, segments[name])
            except PolicyError as error:
                raise PolicyError(
                    f"{error}; {escape(path)} names it, as the run needs the data that it started "
                    "with: restore it, or start a new run"
                ) from None


def _save_policy(folder: RunFolder, learner: DangerLearner, stage: str) -> None:
    """Save the network and its rule as a policy; `stage` is its name."""
    danger = folder.config.danger
    follow = folder.config.reward.model_dump(include={*FollowRewardConfig.model_fields, "crash"})
    rule = DangerRuleSettings(
        threshold=danger.threshold,
        at_once=danger.at_once,
        warn=danger.warn,
        value=StickValue(**follow) if danger.teacher == "returns" else None,
    )
    save_danger(folder.policy(stage), learner.net, rule, folder.config, folder.manifest_sha256())


def _save_round(folder: Path, number: int, learner: DangerLearner, segments: Hashes) -> None:
    """Save the learner's checkpoint after a round; `segments` are all that it has learned from."""
    state = {"updates": learner.updates, "loss": learner.loss, "segments": segments}
    write_checkpoint(folder, format_checkpoint_name("round", number), state, learner.arrays())
