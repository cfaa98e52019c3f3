"""`wcsim train`: train a danger network, in rounds; `wcsim train-q`: train one by Q-learning.

What a training needs is loaded once its options are read: the help has to appear at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from wcsim.cli.shared.common import Cluster, Repeated, Worlds, parse_options, workers_from_options
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.cli.shared.training_options import NewQTrainingOptions, TrainingOptions

if TYPE_CHECKING:
    from wcsim.config import RunConfig
    from wcsim.server.specs import RunInfo
    from wcsim.server.workers.machines import WorkerPoolSettings


@dataclass(kw_only=True)
class _RoundsOptions(TrainingOptions):
    """Train a danger network: users and an oracle drive in rounds, and it learns which positions end badly.

    `wcsim train-q` learns by Q-learning instead.
    """  # noqa: E501 - help text

    preset: str = "quick"
    """Preset to start from: quick, laptop, best or reward. Without a name: a table of all."""
    data: Repeated = ()
    """Data folder of `wcsim collect` that the network also learns from, as collect.data."""
    worlds: Worlds = None
    """Worker processes that drive data. Results do not depend on their number. None: one per core, at most 4."""  # noqa: E501 - help text
    cluster: Cluster = ""
    """HOST:PORT of a Ray cluster that drives data, or `local`. Data and weights stay the same (docs/cluster.md)."""  # noqa: E501 - help text


@dataclass(kw_only=True)
class _QLearningOptions(NewQTrainingOptions):
    """Train a network by Q-learning, from the reward of every step, as in the paper."""

    network: Annotated[str, arg(metavar="NAME")] = ""
    """Name of a network, or your own as module:Class; same as --set learn.network=..."""


def run(words: list[str]) -> int:
    """Train a danger network, and leave a run folder."""
    options = parse_options(_RoundsOptions, words, "train")
    from wcsim.agents.opening.learner_registry import DANGER_ROUNDS
    from wcsim.cli.shared.run_config import refuse_held_out_users, require_matching_learner
    from wcsim.config import resolve
    from wcsim.server.specs import RunInfo

    machines = workers_from_options(options.cluster, options.worlds, "--worlds")
    data = {"collect": {"data": list(options.data)}} if options.data else None
    board = {"learn": {"tensorboard": True}} if options.tensorboard else None
    config = resolve(options.preset, options.config, options.set, data, board)
    require_matching_learner(config, DANGER_ROUNDS)
    refuse_held_out_users(config, (options.set, options.config))
    info = RunInfo(seed=options.seed, command=("wcsim", "train", *words))
    return _train(options, info, config, machines)


def run_train_q(words: list[str]) -> int:
    """Train by Q-learning, and leave a run folder."""
    options = parse_options(_QLearningOptions, words, "train-q")
    from wcsim.cli.shared.training import make_q_config_layers
    from wcsim.config import resolve

    board = {"learn": {"tensorboard": True}} if options.tensorboard else None
    config = resolve(options.preset, *make_q_config_layers(options, options.network, board))
    return _train(options, options.info(("wcsim", "train-q", *words)), config)


def _train(
    options: TrainingOptions,
    info: RunInfo,
    config: RunConfig,
    machines: WorkerPoolSettings | None = None,
) -> int:
    """Train one network with settings that were checked; returns the exit code.

    Raises:
        WcsimError: See `choose_towns_and_folder`, `resolve_run_settings` and
            `train_single_network`.
    """
    from wcsim.agents.opening.learner_registry import learner_from_config
    from wcsim.cli.shared.run_config import resolve_run_settings
    from wcsim.cli.shared.training import (
        choose_towns_and_folder,
        print_finished_run,
        train_single_network,
    )

    # 1. Find the towns and choose the run folder. Refusals so far load no PyTorch.
    town, info, out = choose_towns_and_folder(options, info, config)

    # 2. Fill in what the network and the town fix: its window, the options of SUMO.
    run = resolve_run_settings(config, info, town, out)

    # 3. Train, and leave a run folder.
    note = learner_from_config(config).describe(config)
    train_single_network(run, town, note=note, verbose=options.verbose, machines=machines)

    # 4. Report where it is, and how to test it.
    print_finished_run(options, run)
    return ExitCode.DONE
