"""`wcsim join`: one client by hand, in a world that somebody serves."""

import re
import secrets
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from wcsim.agents.clients.group_run import CLIENT_ARGV
from wcsim.agents.networks.names import client_name_from_network, require_known_network
from wcsim.agents.opening.learner_registry import Q_LEARNING
from wcsim.agents.runs.run_folder import ResolvedRun, has_results, open_run, require_empty_folder
from wcsim.cli.shared.common import Bounds, Flag, OutFolder, parse_options, require_writable_folder
from wcsim.cli.shared.consoles import StageBar
from wcsim.cli.shared.exit_codes import ExitCode, NothingSavedInterrupt
from wcsim.cli.shared.run_config import format_test_command, require_known_users
from wcsim.cli.shared.training import (
    make_progress_callback,
    make_q_config_layers,
    remove_run_without_results,
)
from wcsim.cli.shared.training_options import QLearningBaseOptions
from wcsim.config import resolve
from wcsim.core.files import lock_run_folder
from wcsim.core.own_folder import create_runtime_folder
from wcsim.errors import ConfigError, InterruptedRunError, ServerGoneError
from wcsim.server.launch.launcher import ProcessLauncher
from wcsim.server.launch.states import ClientLaunchPlan
from wcsim.server.protocol.client_core import Patience
from wcsim.server.protocol.messages import ANY_SEAT
from wcsim.server.specs import (
    ClientProcessSpec,
    RunInfo,
    SeatRequest,
    encode_json_line,
    seat_spec_from_env,
)
from wcsim.types import CLIENT_NAME
from wcsim.view.live_table import LiveTable


@dataclass(kw_only=True)
class _Options(QLearningBaseOptions):
    """Train one network in a running world of `wcsim serve`.

    The server sets world, chair and camera.
    """

    endpoint: Annotated[str, Positional]
    """Address of the world, as printed by `wcsim serve`: ipc://FILE or tcp://HOST:PORT."""
    out: OutFolder = None
    """Run folder; default runs/joined-NETWORK-SEED."""
    network: str = ""
    """Name of a network, or your own as module:Class; same as --set learn.network=..."""
    seat: Annotated[int | None, arg(metavar="K"), Bounds(0, 63)] = None
    """Seat to take; by default the first free one."""
    name: str = ""
    """Name of this client; default the network's."""
    keys: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder with the server's public key and this client's secret key."""
    seed: int = 0
    """Random seed of network, exploration and replay. The server sets the world's seed."""
    wait: Annotated[float, arg(metavar="S"), Bounds(0.1, 3600.0)] = 20.0
    """Seconds to wait for the server's first answer."""
    resume: bool = False
    """Continue an interrupted run from its newest checkpoint."""
    supervise: Flag = False
    """Start it again from its newest checkpoint when it died (five times without progress) or lost its world (20)."""  # noqa: E501 - help text


def run(words: list[str]) -> int:
    """Join, learn, leave a run folder."""
    options = parse_options(_Options, words, "join")
    if options.endpoint.partition("://")[0] not in ("ipc", "tcp"):
        raise ConfigError(
            f"endpoint {options.endpoint!r}: expected ipc://FILE or tcp://HOST:PORT, as `wcsim "
            "serve` prints it"
        )
    if options.name and not re.fullmatch(CLIENT_NAME, options.name):
        raise ConfigError(
            f"--name {options.name!r}: expected 1 to 64 letters, digits, - _ or ., not starting "
            "with ."
        )
    config = resolve(options.preset, *make_q_config_layers(options, options.network))
    require_known_network(config.learn.network)
    require_known_users(config.env.profile)
    network = config.learn.network.rpartition(":")[2]
    out = options.out or Path("runs") / f"joined-{network}-{options.seed}"
    require_writable_folder("--out", out)
    info = RunInfo(seed=options.seed, rewards=options.reward, command=("wcsim", "join", *words))
    request = SeatRequest(
        endpoint=options.endpoint,
        name=options.name or client_name_from_network(config.learn.network),
        claim=secrets.token_hex(16),
        spec=seat_spec_from_env(config.env),
        seat=ANY_SEAT if options.seat is None else options.seat,
        keys="" if options.keys is None else str(options.keys.absolute()),
        patience=Patience(reconnect_s=options.wait),
    )
    order = ClientProcessSpec(join=request, config=config, out=str(out), info=info)
    if options.supervise:
        _supervised(order, options.resume)
    else:
        _joined(order, options.resume)
    if options.steps is not None:
        print(f"note: {Q_LEARNING.describe(config)}")
    print(f"run folder: {out}    test it: {format_test_command(out, config.learn.network)}")
    return ExitCode.DONE


def _joined(order: ClientProcessSpec, resume: bool) -> None:
    # torch is loaded here, before there is a seat for which others would wait
    from wcsim.agents.clients.client import make_client_env
    from wcsim.agents.learning.train import train_dqn

    out, beats = Path(order.out), count(1)
    with remove_run_without_results(out):
        order, street = make_client_env(order)
        with street, StageBar("loading the town") as bar:
            run = ResolvedRun(config=order.config, out=out, info=order.info, resume=resume)
            train_dqn(
                run,
                lambda: street,
                make_progress_callback(bar),
                alive=lambda: street.beat(next(beats)),
            )


def _supervised(order: ClientProcessSpec, resume: bool) -> None:
    """Learn in a process of its own, which is started again as one of `wcsim train-clients` is.

    Raises:
        InterruptedRunError: The user stopped it.
        NothingSavedInterrupt: ... before anything was learned.
        ConfigError: Something that was asked for cannot be used.
        PolicyError: There is no run to resume, the folder of a new one is not empty, or another
            process has it.
        ServerGoneError: It has died, or lost its world, too often.
    """
    out = Path(order.out).absolute()
    beside = out.with_name(f"{out.name}.supervised")
    beside.mkdir(parents=True, exist_ok=True)
    try:
        with lock_run_folder(beside):
            # A restarted client removes a folder without a run and starts again: it must not be
            # another user's folder.
            if resume:
                open_run(out)
            else:
                require_empty_folder(out)
            with remove_run_without_results(out):
                _launched(replace(order, out=str(out)), resume, beside)
    finally:
        with suppress(OSError):  # it stays where something was logged
            beside.rmdir()


def _launched(order: ClientProcessSpec, resume: bool, beside: Path) -> None:
    out, name = order.out, order.join.name
    with create_runtime_folder() as place, LiveTable() as table:
        file = place / f"{name}.json"
        plan = ClientLaunchPlan(
            name=name,
            seat=max(0, order.join.seat),
            argv=(*CLIENT_ARGV, str(file)),
            log=beside / f"{name}.log",
            resume=resume,
            order=encode_json_line(order),
            order_file=file,
        )
        outcome = ProcessLauncher(None, (plan,), beside, show=table.show).run()
    if outcome.code == ExitCode.REFUSED:
        raise ConfigError(outcome.message)
    if outcome.code:
        raise ServerGoneError(outcome.message)
    if outcome.stopped and not has_results(Path(out)):
        raise NothingSavedInterrupt("stopped before anything was learned; nothing is saved")
    if outcome.stopped:
        lost = outcome.clients[0].unsaved
        stopped = "stopped"
        if lost:
            stopped += f", but it {lost}: the training since its last checkpoint is lost"
        raise InterruptedRunError(
            f"{stopped}; {out} holds the rest; the same command with --resume goes on"
        )
