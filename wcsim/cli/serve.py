"""`wcsim serve`: a shared world, for clients that join and leave as they like."""

import shlex
import socket
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final

from tyro.conf import arg

from wcsim.cli.shared.common import (
    Bounds,
    Flag,
    Lease,
    OutFolder,
    SettingsOptions,
    parse_options,
    require_writable_folder,
    split_nonempty_list,
)
from wcsim.cli.shared.consoles import choose_result_console, print_sumo_overrides, warn
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.cli.shared.run_config import list_sumo_overrides
from wcsim.config import RunConfig, resolve
from wcsim.core.own_folder import create_runtime_folder, world_endpoint_from_folder
from wcsim.core.reading import require_no_outward_links
from wcsim.errors import ConfigError
from wcsim.log.reader import list_log_parts
from wcsim.log.writer import JOURNAL, LogWriter, format_truncation_warning
from wcsim.server.launch.launcher import ProcessLauncher
from wcsim.server.launch.states import LaunchProcessStates
from wcsim.server.protocol.events import ServerRules
from wcsim.server.protocol.limits import ensure_open_file_limit
from wcsim.server.specs import WorldProcessSpec, make_world_launch_plan
from wcsim.server.transport.keys import create_missing_keys, is_loopback, list_known_clients
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.making.asked_town import requested_town
from wcsim.towns.scenario.town import Town
from wcsim.types.bounds import MOST_SEATS
from wcsim.users.profiles import filter_user_file_names
from wcsim.view.live_table import LiveTable

GATHER_S: Final = 600.0
_MOST_NAMED: Final = 4  # clients whose whole commands are printed
_EVERYWHERE: Final = ("0.0.0.0", "[::]", "*")  # noqa: S104 - only compared with


@dataclass(kw_only=True)
class _Options(SettingsOptions):
    """Run a shared world until Ctrl-C; clients join it with `wcsim join`, on this machine or on others."""  # noqa: E501

    town: str = "helsinki"
    """Where: a town's name, its folder, or a .sumocfg file; made:SEED is generated. With --run several, separated by
    commas, take turns after world.epoch_ticks."""  # noqa: E501
    seats: Annotated[int, Bounds(1, MOST_SEATS)] = 4
    """Number of wheelchairs, one for each client."""
    expected: int = 1
    """Number of clients that the first tick waits for."""
    hook: str = ""
    """Your own step hook as module:Class, called around every step of SUMO with the libsumo module."""  # noqa: E501
    listen: Annotated[str, arg(metavar="tcp://HOST:PORT")] = ""
    """Also accept clients from other machines; beyond 127.0.0.1 this needs keys."""
    keys: OutFolder = None
    """Folder with the server's keys and those of clients that may join over the network."""
    make_keys: Annotated[str, arg(metavar="NAME,...")] = ""
    """Generate missing keys for these clients and the server in the folder --keys."""
    run: OutFolder = None
    """Save journal, logs and the outputs of the town's scenario here; continues a world in the folder."""  # noqa: E501
    lease: Lease = 120.0
    """Seconds without a sign of progress after which a client is dropped."""
    max_think: Annotated[float | None, arg(metavar="S"), Bounds(0.1, 86_400.0)] = None
    """Seconds that a client may take for an action before it is dropped; unlimited by default."""
    seed: int = 0
    """Random seed of the world."""
    verbose: Flag = False
    """Show a table of the town's SUMO options that wcsim overrides, with the reasons."""


def run(words: list[str]) -> int:
    """Serve until Ctrl-C."""
    options = parse_options(_Options, words, "serve")
    Bounds(1, options.seats).check("--expected", options.expected)
    _prepare_network(options)
    config = resolve(options.preset, options.config, options.set)
    if options.run is not None:
        _prepare_folder(options.run)
    ensure_open_file_limit(options.seats)
    towns = [requested_town(word) for word in split_nonempty_list("--town", options.town)]
    if len(towns) > 1 and (options.run is None or not config.epoch_ticks):
        raise ConfigError(
            f"--town {options.town}: the world never changes town; expected --run FOLDER, and "
            "world.epoch_ticks above 0"
        )
    for town in towns:
        validate_net(town.net)
    with create_runtime_folder() as place:
        return _serve(options, towns, config, place)


def _serve(options: _Options, towns: list[Town], config: RunConfig, place: Path) -> int:
    town, *more = towns
    folder = place if options.run is None else options.run
    overrides = list_sumo_overrides(town, config, options.seed)
    running = False
    with LiveTable() as table:
        out = choose_result_console(table.console)

        def show(state: LaunchProcessStates) -> None:
            nonlocal running
            if state.world_standing == "running" and not running:
                running = True
                print_sumo_overrides(out, town.name, overrides, verbose=options.verbose)
                listening = "" if state.world is None else state.world.listening
                out.print(
                    _how_to_join(world_endpoint_from_folder(place), listening, options),
                    soft_wrap=True,
                )
            table.show(state)

        order = _order(options, town, config, place)
        order = replace(order, more_towns=tuple(other.address for other in more))
        world = make_world_launch_plan(order, place, folder / "logs" / "world.log")
        outcome = ProcessLauncher(world, (), folder, show=show).run()
    if outcome.code == ExitCode.REFUSED:
        raise ConfigError(outcome.message)
    if outcome.code:
        warn(outcome.message)
        return ExitCode.FAILED
    return ExitCode.DONE


def _how_to_join(endpoint: str, listening: str, options: _Options) -> str:
    """The commands with which clients join."""
    lines = [
        f"the world runs until Ctrl-C; join it with: wcsim join {shlex.quote(endpoint)} --network "
        "patch --steps 1000"
    ]
    if listening:
        address = _reachable(listening, socket.gethostname())
        names = () if options.keys is None else list_known_clients(options.keys)
        keys = f" --keys {shlex.quote(str(options.keys))} --name "
        for client in [f"{keys}{name}" for name in names[:_MOST_NAMED]] or [""]:
            lines.append(
                f"over the network: wcsim join {address}{client} --network patch --steps 1000"
            )
        if len(names) > _MOST_NAMED:
            lines.append(f"also for {', '.join(names[_MOST_NAMED:])}")
    return "\n".join(lines)


def _reachable(listening: str, host: str) -> str:
    """An address for other machines: one that listens everywhere has the machine's name.

    >>> _reachable("tcp://0.0.0.0:5555", "lab3"), _reachable("tcp://[::]:5555", "lab3")
    ('tcp://lab3:5555', 'tcp://lab3:5555')
    >>> _reachable("tcp://a:5", "lab3")
    'tcp://a:5'
    """
    place, _, port = listening.removeprefix("tcp://").rpartition(":")
    return f"tcp://{host}:{port}" if place in _EVERYWHERE else listening


def _prepare_network(options: _Options) -> None:
    """Write the requested keys, and refuse an address that others could reach without keys."""
    if options.make_keys:
        if options.keys is None:
            raise ConfigError("--make-keys: add --keys FOLDER, where to write them")
        require_writable_folder("--keys", options.keys)
        create_missing_keys(options.keys, split_nonempty_list("--make-keys", options.make_keys))
    if options.keys is not None and not options.listen:
        raise ConfigError(
            "--keys without --listen: keys are for clients of other machines; add --listen "
            "tcp://HOST:PORT"
        )
    if options.listen and not is_loopback(options.listen) and options.keys is None:
        raise ConfigError(
            f"--listen {options.listen} can be reached from other machines; expected --keys FOLDER "
            "(--make-keys NAME,... makes them), or an address such as tcp://127.0.0.1:5555"
        )


def _prepare_folder(folder: Path) -> None:
    """Cut off a truncated end of a world's journal, which a killed process left, and warn of it.

    Raises:
        ConfigError: The folder cannot be used, or has other things in it.
        JournalError: The journal is damaged elsewhere.
    """
    require_writable_folder("--run", folder)
    journal = folder / JOURNAL
    if any(folder.glob("*")) and not list_log_parts(journal):
        raise ConfigError(
            f"--run {folder} is not empty and has no journal; choose a new folder, or one with a "
            "world"
        )
    if folder.exists():
        require_no_outward_links(folder, ConfigError)
    if journal.is_file():
        with LogWriter.append_to(journal) as writer:
            if writer.cut_bytes:
                warn(format_truncation_warning(journal, writer.cut_bytes))


def _order(options: _Options, town: Town, config: RunConfig, place: Path) -> WorldProcessSpec:
    return WorldProcessSpec(
        town=town.address,
        config=config,
        seed=options.seed,
        rules=ServerRules(
            capacity=options.seats,
            config=config.world_digest(),
            expected=options.expected,
            gather_s=GATHER_S,
            lease_s=options.lease,
            max_think_s=options.max_think,
            recordings=filter_user_file_names([config.env.profile]),
        ),
        endpoint=world_endpoint_from_folder(place),
        ring=str(place / "ring"),
        name=town.name,
        run="" if options.run is None else str(options.run.absolute()),
        hook=options.hook,
        listen=options.listen,
        keys="" if options.keys is None else str(options.keys.absolute()),
        epoch_ticks=config.epoch_ticks if options.run is not None else 0,
    )
