"""`wcsim resume RUN`: a training continues from its newest checkpoint, as its run folder states."""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from wcsim.agents.clients.group_run import ResolvedClient, ResolvedGroupRun, open_group_run_folder
from wcsim.agents.opening.learner_registry import learner_from_config
from wcsim.agents.runs.run_folder import (
    CONFIG,
    MANIFEST,
    ResolvedRun,
    RunManifest,
    extend_run_steps,
    open_run,
    read_run_json,
)
from wcsim.agents.runs.transfer import custom_class_names, require_trusted_classes
from wcsim.cli.shared.common import (
    Cluster,
    Repeated,
    Steps,
    Worlds,
    parse_options,
    require_writable_folder,
    split_nonempty_list,
    workers_from_options,
)
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.cli.shared.run_config import add_town_to_run_info, resolve_run_settings
from wcsim.cli.shared.training import print_finished_run, train_single_network
from wcsim.cli.shared.training_options import OutputOptions
from wcsim.cli.training.clients import LEASE_S, ClientProcessOptions
from wcsim.cli.training.phases_apart import train_clients_in_phases
from wcsim.config import RunConfig, resolve
from wcsim.config import parse as parse_config
from wcsim.core.files import lock_run_folder
from wcsim.errors import ConfigError, PolicyError, TownError
from wcsim.towns.making.asked_town import requested_town
from wcsim.towns.scenario.town import Town, streets_hash


@dataclass(kw_only=True)
class _Options(OutputOptions):
    """Continue a training from its newest checkpoint, with its own settings."""

    run: Annotated[Path, Positional, arg(metavar="RUN")]
    """Run folder of a training, of one network or of several clients."""
    steps: Steps = None
    """Total steps of a longer training by Q-learning."""
    worlds: Worlds = None
    """Worker processes, where data is driven or clients are compared. None: one per core, at most 4."""  # noqa: E501 - help text
    cluster: Cluster = ""
    """HOST:PORT of a Ray cluster that drives data for a danger network, or `local`."""
    town: str = ""
    """Where its towns are by now, if they were moved: folders or .sumocfg files, separated by commas."""  # noqa: E501 - help text
    trust: Annotated[Repeated, arg(metavar="CLASS")] = ()
    """Your own module:Class that a run names which was made elsewhere: resuming runs its code."""


def run(words: list[str]) -> int:
    """Go on, by what the run's folder says."""
    options = parse_options(_Options, words, "resume")
    require_writable_folder("RUN", options.run)
    was = None if "clients" in read_run_json(options.run, MANIFEST) else open_run(options.run)
    learner = None if was is None else learner_from_config(was.config)
    if options.cluster and (learner is None or not learner.own_worlds):
        raise ConfigError(
            f"--cluster: {options.run} learns from every step, on this machine; leave it out"
        )
    if was is None or learner is None:
        return _resume_group(options)
    if options.steps is not None and not learner.extends:
        raise ConfigError(
            f"--steps: {options.run} learns in {learner.length(was.config)}, not steps; leave it "
            "out"
        )
    machines = workers_from_options(options.cluster, options.worlds, "--worlds")
    again, town = _resumed(options)
    if (
        was.manifest.status == "done"
        and again.config.learn.total_steps == was.config.learn.total_steps
    ):
        done = f"all of its {learner.length(was.config)} are done"
        extend_it = "; extend it with --steps N" if learner.extends else ""
        print(f"note: {options.run} is finished: {done}{extend_it}", file=sys.stderr)
    train_single_network(again, town, verbose=options.verbose, machines=machines)
    print_finished_run(options, again)
    return ExitCode.DONE


def _resumed(options: _Options) -> tuple[ResolvedRun, Town]:
    """What a run of one network goes on with.

    Raises:
        PolicyError: It is no such run, is damaged, or names own code of somebody else.
        TownError: Its town is not there.
        ConfigError: An option cannot be used.
    """
    path = options.run
    run = open_run(path)
    manifest, was = run.manifest, read_run_json(path, MANIFEST).get("config_was_sha256")
    digest = parse_config(RunConfig, read_run_json(path, CONFIG), str(path / CONFIG)).digest()
    # Another version of wcsim may know more settings, and so have another hash of the same file.
    same_version = manifest.versions.get("wcsim") == metadata.version("wcsim")
    if same_version and digest not in (manifest.config_sha256, was):
        raise PolicyError(f"{path / CONFIG} does not match the run: changed or damaged; restore it")
    town = _town_of(options, manifest, (run.config.learn.network,))
    steps = _steps_of(options, run.config)
    if (
        was is not None or steps != run.config.learn.total_steps
    ):  # a process may have ended between two files
        with lock_run_folder(path):  # by nobody else at work: a run in use keeps its steps
            extend_run_steps(path, steps)
        run = open_run(path)
    return resolve_run_settings(run.config, run.manifest.info, town, path, resume=True), town


def _resume_group(options: _Options) -> int:
    """Go on with a run of several clients. Raises as `_resumed` does."""
    path = options.run
    folder = open_group_run_folder(path)
    configs = {name: folder.client_config(name) for name in folder.clients}
    town = _town_of(options, folder.manifest, [config.learn.network for config in configs.values()])
    clients = []
    for seat, (name, config) in enumerate(configs.items()):
        longer = resolve(config, {"learn": {"total_steps": _steps_of(options, config)}})
        clients.append(ResolvedClient(name=name, seat=seat, config=longer))
    info = add_town_to_run_info(folder.manifest.info, town, clients[0].config)
    try:
        lease_s = float(_value_of(info.command, "lease") or LEASE_S)
    except ValueError:
        lease_s = LEASE_S
    again = ClientProcessOptions(
        lease=lease_s if 1.0 <= lease_s <= 86_400.0 else LEASE_S,
        worlds=options.worlds,
        verbose=options.verbose,
        json=options.json,
    )
    run = ResolvedGroupRun(clients=tuple(clients), out=path, info=info, resume=True)
    return train_clients_in_phases(again, run, town)


def _value_of(command: Sequence[str], option: str) -> str | None:
    """The last value of an option in a command that was typed once; None where it was left out.

    >>> _value_of(["wcsim", "train", "--town", "a", "--town=b"], "town")
    'b'
    """
    found = None
    for number, word in enumerate(command):
        name, equals, value = word.partition("=")
        if name == f"--{option}":
            found = (
                value if equals else (command[number + 1] if number + 1 < len(command) else None)
            )
    return found


def _town_of(options: _Options, manifest: RunManifest, networks: Sequence[str]) -> Town:
    """The town that a run of these networks was made in, of several the first one.

    Raises:
        PolicyError: The run was made elsewhere with code that is not named here, its town has other
            streets by now, or it is a run of `wcsim join`.
        TownError: One is not found under the name that it had.
    """
    path, command = options.run, manifest.command
    require_trusted_classes(
        path,
        custom_class_names(manifest.hook, manifest.rewards, networks),
        manifest.own_code,
        options.trust,
    )
    if command[1:2] == ("join",):
        raise PolicyError(
            f"{path} learns in a world that somebody serves; join again: {shlex.join(command)} "
            "--resume"
        )
    words = options.town or _value_of(command, "town") or manifest.town
    try:
        towns = [requested_town(word) for word in split_nonempty_list("--town", words)]
        others = [requested_town(word) for word in manifest.more_towns]
    except TownError as error:
        if options.town:
            raise
        raise TownError(
            f"{path} was made in the town {words!r}: {error}; give its location: --town FOLDER"
        ) from None
    of_run = [manifest.town_sha256, *manifest.more_towns.values()]
    for found in (towns, [towns[0], *others]):
        if [streets_hash(town) for town in found] != of_run:
            own = ", ".join((manifest.town, *manifest.more_towns))
            raise PolicyError(
                f"--town {words}: {path} was made with another town or other streets ({own}); "
                "restore them"
            )
    return towns[0]


def _steps_of(options: _Options, config: RunConfig) -> int:
    """Steps in all: those of the run, or more. Raises PolicyError for fewer."""
    total = config.learn.total_steps
    if options.steps is not None and options.steps < total:
        raise PolicyError(
            f"--steps {options.steps}: {options.run} was made for {total}; expected at least as "
            "many"
        )
    return options.steps or total
