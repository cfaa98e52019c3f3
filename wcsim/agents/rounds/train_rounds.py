"""Trains a danger network in rounds: drive, learn, drive again with what was learned, learn from all of it.

While the network learns from round n, the worlds already drive round n + 1 with the network that had learned from the
rounds before n. What a segment is depends on its key alone, so data and weights do not depend on the number of worlds,
nor on what died on the way.
"""

import time
from collections.abc import Callable, Collection, Iterator, Sequence
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
from wcsim.agents.rounds.collect_data import SegmentCrew
from wcsim.agents.rounds.drive_segment import SegmentOrder, orders_of, require_recordable
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
    DrivingSegmentKey,
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
from wcsim.config.run_file import DangerRuleSettings, DangerTrainingCheckpoint, LearnedDataFile, StickValue
from wcsim.core import files, reading, seeding
from wcsim.core.reading import JsonObject, escape, is_file, read_json
from wcsim.errors import ConfigError, InterruptedRunError, PolicyError, TownError
from wcsim.server.workers.machines import HERE, WorkerPoolSettings
from wcsim.server.workers.scheduler import WorkerStatus
from wcsim.towns.making.asked_town import Wishes, refuse_held_out_town, requested_town
from wcsim.towns.making.maker import make_town
from wcsim.towns.scenario.town import Town, find_town, open_town, streets_hash

LEARNED: Final = "learned_data.json"


def data_of(run: RunFolder) -> dict[str, Hashes]:
    """The segments of each data folder that a run learns from, SHA-256 by file name: those that it began with.

    Raises:
        PolicyError: A folder is none or was driven with other settings, or what the run has noted is damaged.
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


def _learned_segments(run: RunFolder) -> Iterator[DrivingSegment]:
    """What a run learns from beside its own driving, always the same; it is noted before the first of it is read.

    Raises:
        PolicyError: As `data_of`; there is nothing at all to learn from; or a segment is gone, damaged or exchanged.
        DiskFullError: There is no room.
    """
    found, path = data_of(run), run.path / LEARNED
    if not any(found.values()) and run.config.collect.segments == 0:
        raise PolicyError(
            f"{', '.join(map(escape, found)) or 'collect.data'}: holds no data to learn from; expected segments of "
            "`wcsim collect`, or collect.segments of 1 or more"
        )
    if found and not is_file(path):
        files.write_json(path, {"schema_version": 1, "folders": found})
    for folder, segments in found.items():
        for name in sorted(segments):
            try:
                yield read_segment(Path(folder) / SEGMENTS / name, segments[name])
            except PolicyError as error:
                told = "the run needs the data that it started with: restore it, or start a new run"
                raise PolicyError(f"{error}; {escape(path)} names it, as {told}") from None


TOWNS: Final = "towns"


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundProgress:
    """What is known while a round goes on."""

    round: int
    rounds: int
    segments: int  # that have come back
    of: int
    learned: int = 0  # updates of this round
    updates: int = 0  # of all rounds, when this one is done
    loss: float = float("nan")
    workers: tuple[WorkerStatus, ...] = ()  # who drives what


Progress = Callable[[RoundProgress], object]


def _train_rounds(
    folder: RunFolder,
    towns: tuple[str, ...],
    machines: WorkerPoolSettings,
    progress: Progress,
    log: Log,
) -> str:
    """Do all rounds that are left; the SHA-256 of the weights.

    Args:
        folder: Of the run.
        towns: Folders or names.
        machines: Who drives.
        progress: Told what comes of it.
        log: Told of checkpoints that could not be used.

    Raises:
        TownError: A town is missing.
        ConfigError: The cluster cannot be used, or what the run needs does not travel to it.
        WorkersError: Worlds died too often, or there is no machine left.
        PolicyError: Something that is kept does not fit, there is nothing to learn from, or the loss left the finite
            numbers.
        DiskFullError: There is no room.
    """
    config = folder.config
    seed, total = folder.manifest.seed, config.collect.rounds
    with SegmentCrew(config, folder.path / DATA, machines, folder.path) as workers:
        if newest_checkpoint_number(folder.checkpoints) < 0:
            workers.ask(_orders(folder, towns, 0))  # worlds load while the learner is made
        learner = DangerLearner(config, seed, config.danger.updates * total)
        found = restore_newest_checkpoint(folder, _restoring(learner), log)
        first, segments = (0, {}) if found is None else (checkpoint_number_from_path(found.path) + 1, dict(found.value))
        dataset = Dataset(config)
        for segment in _learned_segments(folder):
            dataset.add(segment)
        for name in sort_segment_names(segments):
            dataset.add(read_segment(folder.path / DATA / SEGMENTS / name, segments[name]))
        for number in range(first, total):
            began_s = time.monotonic()
            orders = _orders(folder, towns, number)
            now = RoundProgress(round=number, rounds=total, segments=0, of=len(orders))
            came = _drive(workers, orders, now, progress)
            if number + 1 < total:
                workers.ask(_orders(folder, towns, number + 1))
            waited_s = time.monotonic() - began_s
            before, crashes, driven = len(dataset), 0, np.zeros(4, np.int64)
            for name in sorted(came):
                segment = read_segment(folder.path / DATA / SEGMENTS / name, came[name])
                dataset.add(segment)
                crashes += int(segment.crashed.sum())
                for place, driver in ((0, NETWORK), (2, FOLLOW)):
                    mine = segment.driver == driver
                    driven[place : place + 2] += int(mine.sum()), int(segment.crashed[mine].sum())
            dataset.begin(seeding.make_rng(seed, "agent", "lectures", number))
            torch.manual_seed(
                seeding.derive_seed(seed, "agent", "learn", number)
            )  # of networks that draw, as by dropout
            now = replace(now, segments=now.of)
            loss = _learn(learner, dataset, config.danger.updates, now, progress)
            segments |= came
            _save(folder, learner, format_checkpoint_name("round", number))
            row = (number, len(dataset), len(dataset) - before, dataset.tight_share, crashes, *driven.tolist())
            spent = (waited_s, time.monotonic() - began_s - waited_s)
            append_round_metrics(folder.path / METRICS, (*row, learner.updates, loss, *spent), config.learn.tensorboard)
            _save_round(folder.checkpoints, number, learner, segments)  # the last: with it the round counts as done
            progress(replace(now, updates=learner.updates, loss=loss))
    hashes = {town.name: streets_hash(town) for town in map(find_town, towns)}
    write_data_manifest(folder.path / DATA, config, hashes, segments)
    _save(folder, learner, "final")
    return hash_network_weights(learner.net)


def _drive(workers: SegmentCrew, orders: Sequence[SegmentOrder], now: RoundProgress, progress: Progress) -> Hashes:
    return workers.take(orders, lambda segments, drive: progress(replace(now, segments=segments, workers=drive)))


def _learn(learner: DangerLearner, dataset: Dataset, updates: int, now: RoundProgress, progress: Progress) -> float:
    return learner.learn(dataset, updates, lambda done: progress(replace(now, learned=done)))


def _save_round(folder: Path, number: int, learner: DangerLearner, segments: Hashes) -> None:
    """Save a learner after a round by `write_checkpoint`; `segments` are those that it has learned from."""
    state = {"updates": learner.updates, "loss": learner.loss, "segments": segments}
    write_checkpoint(folder, format_checkpoint_name("round", number), state, learner.arrays())


def _restoring(learner: DangerLearner) -> Restore[Hashes]:
    """Brings a learner to where it was after a round, and tells the segments that it had learned from."""

    def restore(_: int, state: JsonObject, arrays: dict[str, Arrays]) -> Hashes:
        said = parse(DangerTrainingCheckpoint, state, STATE)
        sort_segment_names(said.segments)
        learner.restore(arrays, said.updates, said.loss)
        return said.segments

    return restore


def _keep_newest(folder: RunFolder) -> bool:
    """Let the policy of the last round that is done be the run's. Whether there is one. Raises DiskFullError."""
    done = [
        folder.policy(format_checkpoint_name("round", number))
        for number in range(newest_checkpoint_number(folder.checkpoints) + 1)
    ]
    done = [path for path in done if path.is_dir()]

    if done:
        with files.write_folder_atomically(folder.policy("final")) as target:
            copytree(done[-1], target, dirs_exist_ok=True)
    return bool(done)


def _orders(folder: RunFolder, towns: tuple[str, ...], number: int) -> list[SegmentOrder]:
    """The segments of a round, driven by the network of the round before the last, where there is one."""
    driver = number - 2
    policy = str(folder.policy(format_checkpoint_name("round", driver))) if driver >= 0 else ""
    first = DrivingSegmentKey(run=folder.manifest.seed, round=number, index=0)
    return orders_of(folder.config, towns, first, folder.config.collect.segments, policy)


def _save(folder: RunFolder, learner: DangerLearner, stage: str) -> None:
    danger = folder.config.danger
    follow = folder.config.reward.model_dump(include=set(FollowRewardConfig.model_fields) | {"crash"})
    rule = DangerRuleSettings(
        threshold=danger.threshold,
        at_once=danger.at_once,
        warn=danger.warn,
        value=StickValue(**follow) if danger.teacher == "returns" else None,
    )
    save_danger(folder.policy(stage), learner.net, rule, folder.config, folder.manifest_sha256())


def towns_of(
    own: Town,
    more: Collection[str],
    config: RunConfig,
    folder: Path,
    seed: int,
    stage: Log = lambda told: None,
) -> tuple[str, ...]:
    """Folders or names of all towns, the run's own first.

    Args:
        own: The run's.
        more: Words for those that take turns with it.
        config: Of the run.
        folder: Of the run; towns that are drawn lie in it, and are made once, where anybody is going to drive in them.
        seed: Of the run.
        stage: Told what is made.

    Raises:
        TownError: A town is missing, is meant for tests, or cannot be made.
        ConfigError: One is held out.
        SumoError: One of SUMO's tools failed.
    """
    listed = [find_town(name) for name in config.collect.towns]
    for town in listed:
        if town.split == "test":
            raise TownError(f"collect.towns: {town.name} is a test town; expected training towns")
    others = [*map(requested_town, more), *listed]
    made = config.collect.made_towns if config.collect.segments else 0
    for number in range(made):
        drawn = seeding.derive_seed(seed, "collect", "town", number)
        out = folder / TOWNS / f"made-{drawn}"
        if not out.is_dir():
            stage(f"generating town {number + 1} of {made}")
            make_town(out, drawn, Wishes())
        others.append(open_town(out))
    towns = (own, *others)
    for town in towns:
        refuse_held_out_town(town)
    return tuple(str(town.address) for town in towns)


def train_danger(
    run: ResolvedRun,
    town: Town,
    machines: WorkerPoolSettings = HERE,
    progress: Progress = lambda now: None,
    stage: Log = lambda told: None,
) -> Path:
    """Do all rounds and leave a run folder with data/, checkpoints/ and policies/final.

    Args:
        run: The run; with `resume` it goes on after the last whole round.
        town: The one that it is trained in; others may be beside it, see `CollectConfig`.
        machines: Who drives beside the process that learns; how many and where changes nothing but the time.
        progress: Told what comes of it.
        stage: Told what takes long before the first round, and of checkpoints that could not be used.

    Raises:
        InterruptedRunError: Ctrl-C; policies/final is that of the last whole round, and `resume` goes on.
        PolicyError, TownError, ConfigError, WorkersError, DiskFullError: See `_train_rounds` and `open_or_create_run`.
    """
    if run.config.collect.segments == 0 and not run.config.collect.data:
        raise ConfigError(
            "collect.segments=0 without collect.data: there is no data to learn from; expected --data FOLDER, or "
            "collect.segments of 1 or more"
        )
    require_recordable(run.config)
    if run.config.learn.tensorboard:
        require_tensorboard_installed()
    folder = open_or_create_run(run, resolve_data_folders)
    with files.lock_run_folder(folder.path), temporary_torch_settings(folder.config.learn):
        towns = towns_of(town, folder.manifest.more_towns, folder.config, folder.path, folder.manifest.seed, stage)
        data_of(folder)  # what cannot be learned from is refused before worlds load
        try:
            sha256 = _train_rounds(folder, towns, machines, progress, stage)
        except KeyboardInterrupt:
            folder.with_status("interrupted", 0)
            kept = "the policy of the complete rounds" if _keep_newest(folder) else "the segments so far, no policy yet"
            raise InterruptedRunError(
                f"stopped; {folder.path} holds {kept}; continue it: {format_resume_command(folder.path)}"
            ) from None
        folder.with_status("done", folder.config.collect.rounds * folder.config.danger.updates)
        folder.event("done", weights_sha256=sha256)
    return folder.path
