"""`wcsim train`: learn to assist, in a town."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from wcsim.agents.runs.run_folder import ResolvedRun, open_run
from wcsim.cli.shared.common import OutFile, OutFolder, Repeated, check_folder, parse, some_words, write_json
from wcsim.cli.shared.exit_codes import Exit
from wcsim.cli.shared.machine_options import machines_of, require_no_cluster
from wcsim.cli.shared.overrides import Verbose, beside, print_overrides
from wcsim.cli.shared.run_config import (
    how_it_learns,
    how_to_test,
    in_town,
    learns_in_rounds,
    preset_of,
    require_drawn_users,
    require_heard,
    require_rounds,
    resolve_config,
    resolve_run,
)
from wcsim.cli.training.bar import TrainBar, gone_if_nothing_came_of_it
from wcsim.cli.training.resume import Typed, given, is_of_clients, resumed
from wcsim.config import RunConfig
from wcsim.errors import ConfigError, TownError
from wcsim.server.specs import RunInfo
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.scenario.town import Town, by_name, streets_hash

_OF_CLIENTS = ("config_for", "lease", "recovery")  # options that one network would not hear of


@dataclass
class Options:
    """Train a network to assist a user: a danger network, or by Q-learning."""

    town: str = "helsinki"
    """Training towns, separated by commas: a town's name, its folder, or a .sumocfg file; made:SEED is generated. The
    world changes town after world.epoch_ticks. Test towns need --allow-test-town."""
    preset: str = ""
    """Preset to start from: quick, laptop or best (danger networks), dqn or paper (Q-learning). Empty: quick, or
    dqn with --network, --clients, --steps, --reward, --hook or a setting of [learn]."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """TOML file with settings that override the preset."""
    set: Repeated = ()
    """Setting as section.key=value; overrides preset and file."""
    network: str = ""
    """Name of a network, or your own as module:Class; same as --set learn.network=..."""
    reward: Repeated = ()
    """Your own reward term as module:Class, added to the paper's terms."""
    hook: str = ""
    """Your own step hook as module:Class, called around every step of SUMO with the libsumo module."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Total steps, as --set learn.total_steps=N. A preset's first phase of more than half of them shrinks."""
    clients: Annotated[str | None, tyro.conf.arg(metavar="A,B,...")] = None
    """Networks that learn at once in one shared world, each in its own process; names or module:Class."""
    config_for: Annotated[Repeated, tyro.conf.arg(metavar="NAME=FILE")] = ()
    """TOML file with settings for one client; overrides all others."""
    select_by: Annotated[str | None, tyro.conf.arg(metavar="HOW")] = None
    """Which client learns the second phase: kpi1 (the lowest KPI 1 in the first phase), the name of a client, or a
    suite or episode list (the best on it). With '' all do. None: learn.select_by, which is kpi1 in preset paper."""
    worlds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Worker processes that drive data for a danger network, or that compare clients. Results do not depend on their
    number. None: one per core, at most 4."""
    cluster: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = ""
    """HOST:PORT of a Ray cluster that drives data for a danger network, or `local`. Data and weights stay the same
    (docs/cluster.md)."""
    data: Repeated = ()
    """Data folder of `wcsim collect` that a danger network also learns from, as collect.data."""
    lease: Annotated[float, tyro.conf.arg(metavar="S")] = 120.0
    """Seconds without progress after which a client is restarted."""
    recovery: Literal["new_epoch", "replay"] = "new_epoch"
    """If the world of several clients dies: start a new one, or rebuild the same one step by step."""
    seed: int = 0
    """Random seed: equal seeds give equal weights."""
    out: OutFolder = None
    """Run folder; default runs/TOWN-PRESET-SEED."""
    tensorboard: bool = False
    """Also log scalars for TensorBoard in the run folder, as --set learn.tensorboard=true."""
    resume: bool = False
    """Continue the run in --out from its newest checkpoint with its own settings; --steps may extend it."""
    allow_test_town: bool = False
    """Allow training in a test town."""
    verbose: Verbose = False
    """Show which SUMO options of the town are overridden, and why."""
    json: OutFile = None
    """Write the path of the run to this file."""


def run(words: list[str]) -> int:
    """Train and leave a run folder."""
    options = _as_settings(parse(Options, words, "train"))
    if options.resume and options.clients is None and options.out is not None and is_of_clients(options.out):
        return _train_clients(options, words)
    if options.clients is not None:
        return _train_clients(options, words)
    machines_of(options.cluster, options.worlds, "--worlds")
    _require_one(words)
    if options.resume:
        return _resume(options, words)
    if options.select_by:
        raise ConfigError("--select-by: there is only one network; expected several: --clients A,B,...")
    config = resolve_config(options, options.network)
    require_heard(config, _only_by_steps(options, config))
    require_rounds(config, _only_in_rounds(options))
    if learns_in_rounds(config):
        require_drawn_users(config, options.set, options.config)
    town, info = _placed(options, words, config)
    resolved = resolve_run(config, info, town, _out(options, town))
    note = how_it_learns(config)
    train_in(resolved, town, note=note, verbose=options.verbose, worlds=options.worlds, cluster=options.cluster)
    return _told(options, resolved)


def _as_settings(options: Options) -> Options:
    """The options with `--select-by`, `--tensorboard` and `--data` as the settings that they are, and their preset."""
    choice = () if options.select_by is None else (f"learn.select_by={json.dumps(options.select_by)}",)
    board = ("learn.tensorboard=true",) if options.tensorboard else ()
    data = (f"collect.data={json.dumps(options.data)}",) if options.data else ()
    options = replace(options, set=(*options.set, *choice, *board, *data))
    by_steps = bool(options.clients is not None or options.reward or options.hook)
    return replace(options, preset=preset_of(options, options.network, by_steps))


def _only_by_steps(options: Options, config: RunConfig) -> dict[str, object]:
    """Options that only a network hears of that learns from every step, by name."""
    return {
        "--network": options.network and config.danger.eye == "map",
        "--steps": options.steps is not None,
        "--reward": options.reward,
        "--hook": options.hook,
        "--tensorboard": options.tensorboard,
    }


def _only_in_rounds(options: Options) -> dict[str, object]:
    """Options that only a network hears of that learns in rounds, by name."""
    return {"--data": options.data, "--worlds": options.worlds is not None}


def _require_one(words: list[str]) -> None:
    """Refuse options that are for several clients. Raises ConfigError."""
    found = [f"--{name.replace('_', '-')}" for name in _OF_CLIENTS if name in given(words)]
    if found:
        raise ConfigError(f"{', '.join(found)}: only for several networks; expected --clients A,B,... with it")


def _resume(options: Options, words: list[str]) -> int:
    """Go on with a run of one network, by what its folder says."""
    out = options.out
    if out is None:
        out = _out(options, _first_town(options))
    check_folder("--out", out)
    run = open_run(out)
    config, own = run.config, "a resumed run keeps its settings; leave that out"
    require_heard(config, {"--steps": options.steps is not None}, own)
    require_rounds(config, _only_in_rounds(options), own)
    resolved, town = resumed(out, typed(options, words))
    if run.manifest.status == "done" and resolved.config.learn.total_steps == config.learn.total_steps:
        print(f"note: {_finished(out, config)}", file=sys.stderr)
    train_in(resolved, town, verbose=options.verbose, worlds=options.worlds, cluster=options.cluster)
    return _told(options, resolved)


def _finished(out: Path, config: RunConfig) -> str:
    """What to say of a run that has nothing left to do."""
    if learns_in_rounds(config):
        return f"{out} is finished: all of its {config.collect.rounds} rounds are done"
    return f"{out} is finished: all of its {config.learn.total_steps} steps are done; extend it with --steps N"


def _info_of(options: Options, words: list[str]) -> RunInfo:
    """What is known of a run before its town is."""
    command = ("wcsim", "train", *words)
    return RunInfo(seed=options.seed, rewards=options.reward, command=command, hook=options.hook)


def typed(options: Options, words: list[str]) -> Typed:
    """The options that were typed, and say something of a run."""
    names = given(words)
    return Typed(
        town=options.town if "town" in names else None,
        preset=options.preset if "preset" in names else None,
        config=options.config,
        set=options.set,
        network=options.network or None,
        reward=options.reward,
        hook=options.hook if "hook" in names else None,
        steps=options.steps,
        seed=options.seed if "seed" in names else None,
    )


def _told(options: Options, run: ResolvedRun) -> int:
    from wcsim.cli.training.report import print_crossings

    if not learns_in_rounds(run.config):  # rounds write no line an episode
        print_crossings(run.out)
    trained_in = (run.info.town, *run.info.more_towns)
    print(f"run folder: {run.out}    test it: {how_to_test(run.out, run.config.learn.network, trained_in)}")
    if options.json is not None:
        write_json(options.json, {"run": str(run.out), "town": run.info.town, "seed": run.info.seed})
    return Exit.DONE


def _out(options: Options, town: Town) -> Path:
    return options.out if options.out is not None else Path("runs") / f"{town.name}-{options.preset}-{options.seed}"


def _train_clients(options: Options, words: list[str]) -> int:
    """Several networks in one world."""
    from wcsim.agents.clients.group_run import GroupRun
    from wcsim.cli.training.clients import resolved, resumed_group
    from wcsim.cli.training.phases_apart import train_group

    require_no_cluster(options.cluster, "has several clients in one world")
    if options.data:
        raise ConfigError("--data and --clients: expected only one of them; only round-based training reads data")
    if options.network:
        raise ConfigError("--network and --clients: expected only one of them; --clients names the networks")
    if options.resume:
        out = options.out if options.out is not None else _out(options, _first_town(options))
        return train_group(options, *resumed_group(options, out, typed(options, words)))
    clients = resolved(options)
    town, info = _placed(options, words, clients[0].config)
    info = in_town(info, town, clients[0].config)
    return train_group(options, GroupRun(clients=clients, out=_out(options, town), info=info), town)


def _first_town(options: Options) -> Town:
    """The one that names the run folder."""
    return checked_town(some_words("--town", options.town)[0], allow_test_town=True)


def _placed(options: Options, words: list[str], config: RunConfig) -> tuple[Town, RunInfo]:
    """The run's own town, and what is known of a run with those that take turns with it.

    Raises:
        TownError: One is kept for tests, or two have one name.
        ConfigError: The world would never change town.
    """
    typed = some_words("--town", options.town)
    towns = [checked_town(word, options.allow_test_town) for word in typed]
    if len(by_name(towns)) < len(towns):
        raise ConfigError(f"--town {options.town}: a town comes twice; expected each once")
    if len(towns) > 1 and not learns_in_rounds(config) and not config.epoch_ticks:
        raise ConfigError(
            f"--town {options.town}: with world.epoch_ticks=0 the world never changes town; set it above 0"
        )
    more = {word: streets_hash(town) for word, town in zip(typed[1:], towns[1:], strict=True)}
    return towns[0], replace(_info_of(options, words), more_towns=more)


def checked_town(name: str, allow_test_town: bool) -> Town:
    """The town to train in. Raises TownError for one that is kept for tests."""
    town = asked_town(name)
    validate_net(town.net)
    if town.split == "test" and not allow_test_town:
        raise TownError(
            f"{town.name} is a test town; networks trained in it cannot be tested fairly. "
            "Train in a town of split train (wcsim town list), or pass --allow-test-town"
        )
    return town


def train_in(
    run: ResolvedRun, town: Town, *, note: str = "", verbose: bool = False, worlds: int | None = None, cluster: str = ""
) -> Path:
    """Train with a progress bar; returns the run folder."""
    if learns_in_rounds(run.config):
        from wcsim.cli.training.rounds import train_rounds_in

        return train_rounds_in(run, town, worlds, cluster, note)
    require_no_cluster(cluster, "learns from every step")
    from wcsim.agents.envs.wheelchair_env import WheelchairEnv
    from wcsim.agents.learning.callbacks import TrainProgress
    from wcsim.agents.learning.train import train
    from wcsim.supervisor.rewards import find_reward_term

    config, info = run.config, run.info
    terms = tuple(find_reward_term(name) for name in info.rewards)
    notes = (note,) if note else ()
    with TrainBar(config.learn.total_steps) as bar, gone_if_nothing_came_of_it(run.out):
        place = beside(bar.console)
        announce = _once(lambda: print_overrides(place, town.name, info.overrides, notes, verbose=verbose, kept=True))

        def show(now: TrainProgress) -> None:
            announce()
            bar.show(now)

        def make_env() -> WheelchairEnv:
            towns = tuple(info.more_towns)
            env = WheelchairEnv(
                town.address, towns=towns, config=config, reward_terms=terms, run=run.out, hook=info.hook
            )
            env.on_town = lambda word: open_run(run.out).event("town", town=Path(word).name)
            return env

        def say(text: str) -> None:
            print(f"wcsim: {text}", file=sys.stderr)

        return train(run, make_env, show, log=say)


def _once(call: Callable[[], None]) -> Callable[[], None]:
    """The same, but only the first time."""
    left = [call]
    return lambda: left.pop()() if left else None
