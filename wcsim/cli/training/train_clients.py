"""`wcsim train-clients A,B,...`: several networks learn at once in one world, in a process each."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from wcsim.agents.clients.group_run import ResolvedClient, ResolvedGroupRun
from wcsim.agents.networks.names import NETWORK_NAMES, client_name_from_network
from wcsim.cli.shared.common import Repeated, parse_options, split_nonempty_list
from wcsim.cli.shared.run_config import add_town_to_run_info, require_known_users
from wcsim.cli.shared.training import choose_towns_and_folder, make_q_config_layers
from wcsim.cli.shared.training_options import NewQTrainingOptions
from wcsim.cli.training.clients import ClientProcessOptions
from wcsim.cli.training.phases_apart import train_clients_in_phases
from wcsim.config import resolve
from wcsim.errors import ConfigError

MOST_CLIENTS = 64
_NETWORK = re.compile(r"[A-Za-z_][\w.-]*(:[A-Za-z_]\w*)?")
_TAKEN = (
    "world",
    "logs",
    "ledgers",
    "configs",
    "journal",
    "selection",
    "report",
)  # names in a run folder


@dataclass(kw_only=True)
class TrainClientsOptions(NewQTrainingOptions, ClientProcessOptions):
    """Train several networks at once in one shared world, by Q-learning, each in a process of its own."""  # noqa: E501 - help text

    clients: Annotated[str, Positional, arg(metavar="A,B,...")]
    """Networks, separated by commas: names or module:Class."""
    config_for: Annotated[Repeated, arg(metavar="NAME=FILE")] = ()
    """TOML file with settings for one client; overrides all others."""
    select_by: Annotated[str | None, arg(metavar="HOW")] = None
    """Which client learns the second phase: kpi1 (the lowest KPI 1 in the first phase), the name of a client, or a
    suite or episode list (the best on it). With '' all do. None: learn.select_by, which is kpi1 in preset paper."""  # noqa: E501 - help text


def run(words: list[str]) -> int:
    """Train them, and leave a run folder."""
    options = parse_options(TrainClientsOptions, words, "train-clients")
    clients = resolve_clients(options)
    config = clients[0].config
    town, info, out = choose_towns_and_folder(
        options, options.info(("wcsim", "train-clients", *words)), config
    )
    return train_clients_in_phases(
        options,
        ResolvedGroupRun(clients=clients, out=out, info=add_town_to_run_info(info, town, config)),
        town,
    )


def resolve_clients(options: TrainClientsOptions) -> tuple[ResolvedClient, ...]:
    """The clients with their names, seats and configurations.

    Raises:
        ConfigError: A name or an option cannot be used, or they do not fit into one world.
    """
    networks = split_nonempty_list("clients", options.clients)
    if len(networks) > MOST_CLIENTS:
        raise ConfigError(f"{len(networks)} clients; expected at most {MOST_CLIENTS}")
    names = make_client_names(networks)
    files = {}
    for text in options.config_for:
        name, equals, path = text.partition("=")
        if not equals or name not in names:
            raise ConfigError(
                f"--config-for {text!r}: expected NAME=FILE with a NAME of {', '.join(names)}"
            )
        files[name] = Path(path)
    learn: dict[str, object] = {"tensorboard": True} if options.tensorboard else {}
    if options.select_by is not None:
        learn["select_by"] = options.select_by
    clients: list[ResolvedClient] = []
    for seat, (name, network) in enumerate(zip(names, networks, strict=True)):
        config = resolve(
            options.preset,
            *make_q_config_layers(options, network, {"learn": learn}, files.get(name)),
        )
        require_known_users(config.env.profile)
        clients.append(ResolvedClient(name=name, seat=seat, config=config))
    worlds = {client.config.world_digest(): client.name for client in clients}
    if len(worlds) > 1:
        raise ConfigError(
            f"clients {' and '.join(worlds.values())} ask for different worlds; expected the same "
            "world, chair, camera, IMU and reward for all: only [learn] and the observation in "
            "[env] may differ (--config-for)"
        )
    return tuple(clients)


def make_client_names(networks: Sequence[str]) -> tuple[str, ...]:
    """A name for each client: its network's, numbered where it comes again.

    >>> make_client_names(("fig6", "own_file:OwnNet", "fig6"))
    ('fig6', 'OwnNet', 'fig6-2')

    Raises:
        ConfigError: A network cannot be named so.
    """
    used = set(_TAKEN)
    names = []
    for network in networks:
        if not _NETWORK.fullmatch(network):
            raise ConfigError(
                f"client {network[:80]!r} is neither the name of a network nor module:Class"
            )
        if ":" not in network and network not in NETWORK_NAMES:
            known = ", ".join(NETWORK_NAMES)
            raise ConfigError(
                f"client: unknown network {network!r}; expected {known}, or module:Class"
            )
        base = client_name_from_network(network)
        name, number = base, 1
        while name in used:
            number += 1
            name = f"{base}-{number}"
        used.add(name)
        names.append(name)
    return tuple(names)
