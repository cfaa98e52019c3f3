"""`wcsim join`: one client by hand, in a world that somebody serves."""

from __future__ import annotations

import re
import secrets
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from wcsim.agents.clients.group_run import RECONNECT_S
from wcsim.agents.networks.names import check_network, client_name
from wcsim.agents.runs.run_folder import ResolvedRun
from wcsim.cli.shared.common import Bounds, OutFolder, check_folder, parse
from wcsim.cli.shared.consoles import StageBar
from wcsim.cli.shared.run_config import how_it_learns, how_to_test, require_user
from wcsim.cli.training.train import LearnerOptions, gone_if_nothing_came_of_it, q_layers, steps_shown
from wcsim.config import RunConfig, parse_json, resolve
from wcsim.config.plant import known_plants
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError, ServerGoneError
from wcsim.server.protocol.client_core import Patience
from wcsim.server.protocol.messages import ANY_SEAT
from wcsim.server.specs import RunInfo, SeatRequest, seat_spec
from wcsim.types import CLIENT_NAME

if TYPE_CHECKING:
    from wcsim.server.links.socket import SocketSeat
    from wcsim.server.protocol import messages as m

WORLD_PARTS = ("world", "chair", "cameras", "imu", "sensors", "reward", "vary")
"""Parts of a configuration that are the world's, not the client's."""


@dataclass(kw_only=True)
class _Options(LearnerOptions):
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


def run(words: list[str]) -> int:
    """Join, learn, leave a run folder."""
    options = parse(_Options, words, "join")
    if options.endpoint.partition("://")[0] not in ("ipc", "tcp"):
        raise ConfigError(
            f"endpoint {options.endpoint!r}: expected ipc://FILE or tcp://HOST:PORT, as `wcsim serve` prints it"
        )
    if options.name and not re.fullmatch(CLIENT_NAME, options.name):
        raise ConfigError(f"--name {options.name!r}: expected 1 to 64 letters, digits, - _ or ., not starting with .")
    config = resolve(options.preset, *q_layers(options, options.network))
    check_network(config.learn.network)
    require_user(config.env.profile)
    network = config.learn.network.rpartition(":")[2]
    out = options.out or Path("runs") / f"joined-{network}-{options.seed}"
    check_folder("--out", out)
    folder = _joined(options, config, out, ("wcsim", "join", *words))
    if options.steps is not None:
        print(f"note: {how_it_learns(config)}")
    print(f"run folder: {folder}    test it: {how_to_test(folder, config.learn.network)}")
    return 0


def _joined(options: _Options, config: RunConfig, out: Path, command: tuple[str, ...]) -> Path:
    # torch is loaded here, before there is a seat for which others would wait
    from wcsim.agents.envs.wheelchair_env import WheelchairEnv
    from wcsim.agents.learning.build import network_settings
    from wcsim.agents.learning.train import train
    from wcsim.agents.networks.device import checked_device
    from wcsim.server.links.socket import SocketSeat
    from wcsim.supervisor.rewards import find_reward_term

    checked_device(config.learn.device)
    config = resolve(config, network_settings(config))
    terms = tuple(find_reward_term(name) for name in options.reward)
    with SocketSeat(_order(options, config)) as seat, gone_if_nothing_came_of_it(out):
        world = _world(options, seat)
        fit = resolve(config, _of_world(world, options.endpoint))
        street = WheelchairEnv(world.town, config=fit, reward_terms=terms, join=seat)
        info = RunInfo(seed=options.seed, town=world.town, rewards=options.reward, command=command)
        beats = count(1)
        with StageBar("loading the town") as bar:
            run = ResolvedRun(config=fit, out=out, info=info, resume=options.resume)
            return train(run, lambda: street, steps_shown(bar), alive=lambda: street.beat(next(beats)))


def _of_world(world: m.Welcome, endpoint: str) -> dict[str, Any]:
    """What the world sets of a configuration. Raises ConfigError rather than open a file that a server names."""
    offered = parse_json(RunConfig, world.config_json, f"the configuration of {endpoint}")
    if not endpoint.startswith("ipc://") and offered.chair.plant not in known_plants():
        raise ConfigError(
            f"the world of {endpoint} drives a wheelchair of a file ({escaped(offered.chair.plant, 80)!r}); expected "
            f"{' or '.join(known_plants())} over the network: join on the world's own machine"
        )
    return {**{part: getattr(offered, part) for part in WORLD_PARTS}, "env": {"actions": offered.env.actions}}


def _order(options: _Options, config: RunConfig) -> SeatRequest:
    env = config.env
    return SeatRequest(
        endpoint=options.endpoint,
        name=options.name or client_name(config.learn.network),
        claim=secrets.token_hex(16),
        spec=seat_spec(env),
        seat=ANY_SEAT if options.seat is None else options.seat,
        keys="" if options.keys is None else str(options.keys.absolute()),
        patience=Patience(reconnect_s=options.wait),
    )


def _world(options: _Options, seat: SocketSeat) -> m.Welcome:
    """Take the seat, and hear what the world is; from then on the server may be silent for longer."""
    try:
        seat.join()
    except ServerGoneError:
        raise ConfigError(
            f"{options.endpoint}: no answer within {options.wait:g} s; is `wcsim serve` running there? "
            "(--wait S waits longer)"
        ) from None
    seat.core.patience = Patience(reconnect_s=RECONNECT_S)
    return seat.welcome
