"""Trains a danger network in rounds: drive, learn, drive again with what was learned, learn from all of it.

While the network learns from round n, the worlds already drive round n + 1 with the network that had learned from the
rounds before n. What a segment is depends on its key alone, so data and weights do not depend on the number of worlds,
nor on what died on the way.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from shutil import copytree

import torch

from wcsim.agents.collecting.data_folder import DATA, SEGMENTS, read_segment, write_manifest
from wcsim.agents.collecting.segment import SegmentKey
from wcsim.agents.collecting.segment_places import SegmentOrder, orders_of
from wcsim.agents.danger.dataset import Dataset, labelled_steps
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.rule import configured_rule
from wcsim.agents.danger.saved import save_danger
from wcsim.agents.rounds.learned_data import learned_segments
from wcsim.agents.rounds.round_checkpoint import digest_of, in_order, load_round, newest_round, save_round
from wcsim.agents.rounds.round_log import note_round
from wcsim.agents.rounds.workers import SegmentDrivers
from wcsim.agents.runs.run_folder import METRICS, RunFolder
from wcsim.config import RunConfig
from wcsim.core import files, seeding
from wcsim.server.workers.crew import WorkerNow
from wcsim.server.workers.machines import HERE, Machines
from wcsim.towns.scenario.town import find_town, streets_hash


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
    workers: tuple[WorkerNow, ...] = ()  # who drives what


Progress = Callable[[RoundProgress], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rounds:
    """What to train with."""

    folder: RunFolder
    towns: tuple[str, ...]  # folders or names
    machines: Machines = HERE

    @property
    def config(self) -> RunConfig:
        """Of the run."""
        return self.folder.config


def train_rounds(rounds: Rounds, progress: Progress = lambda now: None) -> str:
    """Do all rounds that are left; the SHA-256 of the weights.

    Raises:
        TownError: A town is missing.
        ConfigError: The cluster cannot be used, or what the run needs does not travel to it.
        WorkersError: Worlds died too often, or there is no machine left.
        PolicyError: Something that is kept does not fit, there is nothing to learn from, or the loss left the finite
            numbers.
        DiskFullError: There is no room.
    """
    config, folder = rounds.config, rounds.folder
    seed, total = folder.manifest.seed, config.collect.rounds
    learner = DangerLearner(config, seed, config.danger.updates * total)
    first = newest_round(folder.checkpoints) + 1
    segments = load_round(folder.checkpoints, first - 1, learner) if first else {}
    dataset = Dataset(config)
    for segment in learned_segments(folder):
        dataset.add(labelled_steps(segment, config))
    for name in in_order(segments):
        dataset.add(labelled_steps(read_segment(folder.path / DATA / SEGMENTS / name, segments[name]), config))
    with _drivers(rounds).open() as workers:
        for number in range(first, total):
            began_s = time.monotonic()
            now = _orders(rounds, number)
            told = RoundTeller(progress, RoundProgress(round=number, rounds=total, segments=0, of=len(now)))
            came = workers.take(now, told.back, told.watch)
            if number + 1 < total:
                workers.ask(_orders(rounds, number + 1))
            waited_s = time.monotonic() - began_s
            before, crashes = len(dataset), 0
            for name in sorted(came):
                segment = read_segment(folder.path / DATA / SEGMENTS / name, came[name])
                dataset.add(labelled_steps(segment, config))
                crashes += int(segment.crashed.sum())
            dataset.begin(seeding.generator(seed, "agent", "lectures", number))
            torch.manual_seed(seeding.derive(seed, "agent", "learn", number))  # of networks that draw, as by dropout
            loss = learner.learn(dataset, config.danger.updates, told.learned)
            segments |= came
            _save(rounds, learner, f"round-{number:03d}")
            row = (number, len(dataset), len(dataset) - before, dataset.tight_share, crashes, learner.updates, loss)
            note_round(folder.path / METRICS, (*row, waited_s, time.monotonic() - began_s - waited_s))
            save_round(folder.checkpoints, number, learner, segments)  # the last: with it the round counts as done
            many = len(now)
            progress(
                RoundProgress(round=number, rounds=total, segments=many, of=many, updates=learner.updates, loss=loss)
            )
    towns = {town.name: streets_hash(town) for town in map(find_town, rounds.towns)}
    write_manifest(folder.path / DATA, config, towns, segments)
    _save(rounds, learner, "final")
    return digest_of(learner.net)


def keep_newest(folder: RunFolder) -> bool:
    """Let the policy of the last round that is done be the run's. Whether there is one. Raises DiskFullError."""
    done = [folder.policy(f"round-{number:03d}") for number in range(newest_round(folder.checkpoints) + 1)]
    done = [path for path in done if path.is_dir()]

    if done:
        with files.whole_folder(folder.policy("final")) as target:
            copytree(done[-1], target, dirs_exist_ok=True)
    return bool(done)


def _orders(rounds: Rounds, number: int) -> list[SegmentOrder]:
    """The segments of a round, driven by the network of the round before the last, where there is one."""
    config, driver = rounds.config, number - 2
    policy = str(rounds.folder.policy(f"round-{driver:03d}")) if driver >= 0 else ""
    first = SegmentKey(run=rounds.folder.manifest.seed, round=number, index=0)
    return orders_of(config, rounds.towns, first, config.collect.segments, policy)


def _drivers(rounds: Rounds) -> SegmentDrivers:
    path = rounds.folder.path
    return SegmentDrivers(machines=rounds.machines, data=path / DATA, logs=path, config=rounds.config)


class RoundTeller:
    """How far a round has come, for whoever looks on.

    What a run that goes on finds of its first round is told as one: it took no time now, and the rest will.
    """

    def __init__(self, progress: Progress, now: RoundProgress) -> None:
        self._progress, self._now, self._begun = progress, now, False

    def back(self, key: SegmentKey) -> None:
        """A segment is there."""
        self._now = replace(self._now, segments=self._now.segments + 1)
        if self._begun:
            self._progress(self._now)

    def learned(self, updates: int) -> None:
        """So many updates of this round are done, and all of its segments came back."""
        self._progress(replace(self._now, segments=self._now.of, learned=updates, workers=()))

    def watch(self, workers: tuple[WorkerNow, ...]) -> None:
        """Who is at what."""
        self._now = replace(self._now, workers=workers)
        if not self._begun or self._now.segments < self._now.of:
            self._begun = True
            self._progress(self._now)


def _save(rounds: Rounds, learner: DangerLearner, stage: str) -> None:
    rule, sha256 = configured_rule(rounds.config.danger), rounds.folder.manifest_sha256()
    save_danger(rounds.folder.policy(stage), learner.net, rule, rounds.config, sha256)
