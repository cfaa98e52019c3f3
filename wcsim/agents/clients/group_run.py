"""Several clients in one world as they are going to be, and the orders that their processes and their world get."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

from wcsim.agents.clients.clients_folder import ClientsFolder
from wcsim.config import RunConfig, resolve
from wcsim.config.load import Layer
from wcsim.core import seeding
from wcsim.server.launch.states import ClientPlan
from wcsim.server.protocol.client_core import Patience
from wcsim.server.protocol.events import Rules, rejoin_within
from wcsim.server.specs import ClientSpec, Recovery, RunInfo, SeatRequest, WorldSpec, seat_spec, to_line
from wcsim.server.transport.world_folder import endpoint_in
from wcsim.towns.making.asked_town import made_seed
from wcsim.towns.scenario.town import find_town
from wcsim.users.profiles import recordings

GATHER_S = 600.0  # the first tick waits so long for all clients, whose learners take their time to load
RECONNECT_S = 330.0  # longer than a world may take to load again
CLIENT_ARGV = (sys.executable, "-m", "wcsim.agents.clients.client_process")


@dataclass(frozen=True, slots=True, kw_only=True)
class Client:
    """One of them, resolved."""

    name: str
    seat: int
    config: RunConfig
    until: int | None = None  # steps after which it stops for now; None for all of them

    @property
    def shortened(self) -> Layer:
        """What its process learns with instead; a rate that fades does so in the last part alone."""
        return None if self.until is None else {"learn": {"total_steps": self.until, "learning_rate_fade": 0.0}}

    @property
    def steps(self) -> int:
        """Steps that it learns for, for now."""
        return self.config.learn.total_steps if self.until is None else self.until


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupRun:
    """All of them in one world, as it is going to be: a `ResolvedRun` with a configuration for each."""

    clients: tuple[Client, ...]
    out: Path
    info: RunInfo
    resume: bool = False
    best: str = ""  # the client that was chosen after the first phase
    last: bool = True  # whether the run is done when all have learned for `Client.steps`


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldTerms:
    """How a world deals with its clients."""

    expected: int  # clients that the first tick waits for
    lease_s: float
    recovery: Recovery = "new_epoch"


def world_order(run: GroupRun, town: str, folder: ClientsFolder, place: Path, terms: WorldTerms) -> WorldSpec:
    """The world of a run, with its rules; `town` is the town's address, `place` where sockets and orders lie."""
    rules = Rules(
        capacity=len(run.clients),
        config=folder.config.world_digest(),
        expected=terms.expected,
        gather_s=GATHER_S,
        lease_s=terms.lease_s,
        rejoin_s=rejoin_within(terms.lease_s),
        recordings=recordings(client.config.env.profile for client in run.clients),
    )
    more = [word if made_seed(word) is not None else find_town(word).address for word in run.info.more_towns]
    return WorldSpec(
        town=town,
        more_towns=tuple(more),
        config_json=folder.config.model_dump_json(),  # as in the journal, whatever the clients have learned since
        seed=run.info.seed,
        rules=rules,
        endpoint=endpoint_in(place),
        ring=str(place / "ring"),
        name=folder.path.name,
        run=str(folder.path.absolute()),
        hook=run.info.hook,
        recovery=terms.recovery,
        epoch_ticks=_epoch_ticks(run),
    )


def _epoch_ticks(run: GroupRun) -> int:
    """Of the client with the longest episodes; 0 where one client wants no end."""
    ticks = [client.config.epoch_ticks for client in run.clients]
    return max(ticks) if all(ticks) else 0


def client_plan(run: GroupRun, folder: ClientsFolder, place: Path, client: Client) -> ClientPlan:
    """A client's order, and how its process is started."""
    config, env = resolve(client.config, client.shortened), client.config.env
    out = (folder.path / client.name).absolute()
    order = ClientSpec(
        join=SeatRequest(
            endpoint=endpoint_in(place),
            name=client.name,
            claim=folder.claim(client.name),
            spec=seat_spec(env),
            seat=client.seat,
            config=config.world_digest(),
            ledger=str(folder.ledger(client.name).absolute()),
            patience=Patience(reconnect_s=RECONNECT_S),
        ),
        config_json=config.model_dump_json(),
        out=str(out),
        info=replace(run.info, seed=seeding.derive(run.info.seed, "client", client.seat)),
    )
    file = place / f"{client.name}.json"
    return ClientPlan(
        name=client.name,
        seat=client.seat,
        argv=(*CLIENT_ARGV, str(file)),
        log=folder.log(client.name),
        folder=out,
        resume=run.resume,
        order=to_line(order),
        order_file=file,
    )
