"""The run of several clients in one world: its folder, and the orders that its processes get.

- manifest.json: what the run was made with, its clients, and its status
- config.json: the configuration of the world
- configs/NAME.json: that of each client
- journal: everything that happened to the world
- ledgers/NAME.ledger: every frame that a client has seen
- events.jsonl, logs/: events and messages of the processes
- NAME/: a run folder of its own for each client, see `agents/runs/run_folder.py`
- selection/: choice.json names the client that learns the second phase (`learn.select_by`); beside
  it is the test that chose, if one did
"""

import os
import re
import secrets
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final, Self, TypeVar

from wcsim.agents.runs.policy_file import parse_saved
from wcsim.agents.runs.run_folder import (
    CONFIG,
    MANIFEST,
    RunManifest,
    Status,
    has_results,
    read_run_json,
    require_empty_folder,
    run_manifest_from_json,
)
from wcsim.config import RunConfig, resolve
from wcsim.config.load import Layer
from wcsim.core import files, seeding
from wcsim.core.own_folder import world_endpoint_from_folder
from wcsim.core.reading import CLAIM, JsonObject, read_text
from wcsim.errors import PolicyError, WcsimError
from wcsim.log.reader import iter_journal_inputs, list_log_parts
from wcsim.log.records import Ticked
from wcsim.log.writer import JOURNAL
from wcsim.server.launch.states import ClientLaunchPlan
from wcsim.server.ledger import iter_ledger_frames
from wcsim.server.protocol.client_core import Patience
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import (
    ClientProcessSpec,
    RunInfo,
    SeatRequest,
    WorldProcessSpec,
    encode_json_line,
    seat_spec_from_env,
)
from wcsim.towns.making.asked_town import made_seed
from wcsim.towns.scenario.town import find_town
from wcsim.types import CLIENT_NAME
from wcsim.users.profiles import filter_user_file_names

T = TypeVar("T")
LEDGERS: Final = "ledgers"
LOGS: Final = "logs"
CONFIGS: Final = "configs"
SELECTION: Final = "selection"
CHOICE: Final = "choice.json"
# The value of `learn.select_by` that compares by KPI 1 of the first phase; its name in the choice.
KPI1: Final = "kpi1"
# The first tick waits so long for all clients, whose learners take their time to load.
GATHER_S: Final = 600.0
RECONNECT_S: Final = 330.0  # longer than a world may take to load again
CLIENT_ARGV: Final = (sys.executable, "-m", "wcsim.agents.clients.client_process")
_FILES: Final = "files_sha256"
_FILES_TO_COME: Final = "files_to_come_sha256"
_NAME: Final = re.compile(CLIENT_NAME)
_CLAIM: Final = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupRunFolder:
    """An existing run of several clients."""

    path: Path
    config: RunConfig  # of the world
    manifest: RunManifest
    clients: tuple[str, ...]  # in seat order

    def ledger(self, name: str) -> Path:
        """Where a client's ledger is."""
        return self.path / LEDGERS / f"{name}.ledger"

    def load_or_create_claim(self, name: str) -> str:
        """The secret that identifies a client, also to a world that is restored from its journal.

        It is written by the first call.
        """
        path = self.path / LEDGERS / f"{name}.claim"
        if not os.path.lexists(path):
            files.write_bytes(path, secrets.token_hex(16).encode(), mode=0o600)
        claim = read_text(path, CLAIM)
        if not _CLAIM.fullmatch(claim):
            raise PolicyError(f"{path}: is damaged; remove it, and the client joins as a new one")
        return claim

    def log(self, name: str) -> Path:
        """Where a client's log is."""
        return self.path / LOGS / f"{name}.log"

    def done(self, name: str, steps: int) -> bool:
        """Whether a client has learned for so many steps in all."""
        return _own_manifest(self.path / name).get("status") == "done" and self.steps(name) >= steps

    def steps(self, name: str) -> int:
        """Steps that a client has learned for, as far as its own run has them."""
        done = _own_manifest(self.path / name).get("steps", 0)
        return done if isinstance(done, int) else 0

    def fruitless(self) -> bool:
        """Whether nothing was done: no tick of the world, no step of a client, nothing saved.

        A new run of which that is true is removed when it fails. For a run of one network
        `remove_run_without_results` of `cli/shared/training.py` judges, by `has_results` alone.
        """
        journal = self.path / JOURNAL
        if list_log_parts(journal) and _may_hold(
            journal, iter_journal_inputs, lambda record: isinstance(record, Ticked)
        ):
            return False
        # The frame that its join gave a client is no step.
        for ledger in map(self.ledger, self.clients):
            if ledger.exists() and _may_hold(ledger, iter_ledger_frames, lambda seen: seen.stepped):
                return False
        return not any(_has_work(self.path / name) for name in self.clients)

    def client_config(self, name: str) -> RunConfig:
        """The configuration of a client. Raises PolicyError when it is not there, or damaged."""
        folder, file = self.path / CONFIGS, f"{name}.json"
        return parse_saved(RunConfig, read_run_json(folder, file), str(folder / file))

    def truncated_parts(self) -> list[Path]:
        """What was cut off the ends of journal and ledgers, and is still there."""
        return sorted(
            [*self.path.glob(f"{JOURNAL}.torn*"), *(self.path / LEDGERS).glob("*.ledger.torn*")]
        )

    def with_status(self, status: Status, steps: int) -> Self:
        """Write a new status into the manifest."""
        folder = replace(self, manifest=replace(self.manifest, status=status, steps=steps))
        _write_manifest(folder)
        return folder

    def rewrite(self, clients: Mapping[str, RunConfig]) -> None:
        """Write other configurations of clients over theirs. Raises DiskFullError.

        Killed on the way it leaves a run that can be opened, with some of them written: do it
        again, or write a status.
        """
        texts = _config_texts(clients)
        _write_manifest(self, {name: files.sha256_from_text(text) for name, text in texts.items()})
        for name, text in texts.items():
            files.write_bytes(self.path / name, text.encode())


def create_group_run_folder(
    path: Path, config: RunConfig, manifest: RunManifest, clients: Mapping[str, RunConfig]
) -> GroupRunFolder:
    """Make a new folder. Raises PolicyError when it exists and is not empty, DiskFullError.

    Args:
        path: Where.
        config: Of the world.
        manifest: What it is made with.
        clients: The configuration of each, in seat order.
    """
    require_empty_folder(path)
    path.mkdir(parents=True, exist_ok=True)
    files.write_bytes(path / CONFIG, config.model_dump_json(indent=2).encode())
    for name, text in _config_texts(clients).items():
        files.write_bytes(path / name, text.encode())
    folder = GroupRunFolder(path=path, config=config, manifest=manifest, clients=tuple(clients))
    _write_manifest(folder)
    return folder


def open_group_run_folder(path: Path) -> GroupRunFolder:
    """Open an existing folder. Raises PolicyError when it is none."""
    data = read_run_json(path, MANIFEST)
    _check_sealed(path, data)
    clients = data.pop("clients", None)
    if not isinstance(clients, list) or not all(
        isinstance(name, str) and _NAME.fullmatch(name) for name in clients
    ):
        raise PolicyError(f"{path} is a run of one network; expected one of wcsim train-clients")
    config = parse_saved(RunConfig, read_run_json(path, CONFIG), str(path / CONFIG))
    manifest = run_manifest_from_json(data, path)
    return GroupRunFolder(path=path, config=config, manifest=manifest, clients=tuple(clients))


def read_chosen_client_name(path: Path, clients: Collection[str]) -> str:
    """The client of a run that was chosen to go on; "" where none was.

    Raises PolicyError when the file is damaged.
    """
    if not (path / SELECTION / CHOICE).is_file():
        return ""
    best = read_run_json(path / SELECTION, CHOICE).get("best")
    if not isinstance(best, str) or best not in clients:
        raise PolicyError(
            f"{path / SELECTION / CHOICE}: names no client of this run; remove it to compare again"
        )
    return best


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedClient:
    """One client of a run, resolved."""

    name: str
    seat: int
    config: RunConfig
    until: int | None = None  # steps after which it stops for now; None for all of them

    @property
    def shortened(self) -> Layer:
        """Settings of a process that stops for now; a rate that fades does so in the last part."""
        if self.until is None:
            return None
        return {"learn": {"total_steps": self.until, "learning_rate_fade": 0.0}}

    @property
    def steps(self) -> int:
        """Steps that it learns for, for now."""
        return self.config.learn.total_steps if self.until is None else self.until


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedGroupRun:
    """A run of clients as it is going to be: a `ResolvedRun` with a configuration for each."""

    clients: tuple[ResolvedClient, ...]
    out: Path
    info: RunInfo
    resume: bool = False
    best: str = ""  # the client that was chosen after the first phase
    last: bool = True  # whether the run is done when all have learned for `ResolvedClient.steps`


def make_world_spec(
    run: ResolvedGroupRun,
    town: str,
    folder: GroupRunFolder,
    place: Path,
    expected: int,
    lease_s: float,
) -> WorldProcessSpec:
    """The world of a run, with its rules.

    Args:
        run: The run.
        town: The town's address.
        folder: Of the run.
        place: Where sockets and orders lie.
        expected: Clients that the first tick waits for.
        lease_s: So long a client may be silent.
    """
    rules = ServerRules(
        capacity=len(run.clients),
        config=folder.config.world_digest(),
        expected=expected,
        gather_s=GATHER_S,
        lease_s=lease_s,
        recordings=filter_user_file_names(client.config.env.profile for client in run.clients),
    )
    more = [
        word if made_seed(word) is not None else find_town(word).address
        for word in run.info.more_towns
    ]
    # As long as the longest episodes; without an end where one client sets none.
    ticks = [client.config.epoch_ticks for client in run.clients]
    return WorldProcessSpec(
        town=town,
        more_towns=tuple(more),
        config=folder.config,  # as in the journal, whatever the clients have learned since
        seed=run.info.seed,
        rules=rules,
        endpoint=world_endpoint_from_folder(place),
        ring=str(place / "ring"),
        name=folder.path.name,
        run=str(folder.path.absolute()),
        hook=run.info.hook,
        epoch_ticks=max(ticks) if all(ticks) else 0,
    )


def make_client_plan(
    run: ResolvedGroupRun, folder: GroupRunFolder, place: Path, client: ResolvedClient
) -> ClientLaunchPlan:
    """A client's order, and how its process is started."""
    config = resolve(client.config, client.shortened)
    order = ClientProcessSpec(
        join=SeatRequest(
            endpoint=world_endpoint_from_folder(place),
            name=client.name,
            claim=folder.load_or_create_claim(client.name),
            spec=seat_spec_from_env(client.config.env),
            seat=client.seat,
            config=config.world_digest(),
            ledger=str(folder.ledger(client.name).absolute()),
            patience=Patience(reconnect_s=RECONNECT_S),
        ),
        config=config,
        out=str((folder.path / client.name).absolute()),
        info=replace(run.info, seed=seeding.derive_seed(run.info.seed, "client", client.seat)),
    )
    file = place / f"{client.name}.json"
    return ClientLaunchPlan(
        name=client.name,
        seat=client.seat,
        argv=(*CLIENT_ARGV, str(file)),
        log=folder.log(client.name),
        resume=run.resume,
        order=encode_json_line(order),
        order_file=file,
    )


def _config_texts(clients: Mapping[str, RunConfig]) -> dict[str, str]:
    """Texts of the files with the clients' configurations, by their paths in the run folder."""
    return {
        f"{CONFIGS}/{name}.json": config.model_dump_json(indent=2)
        for name, config in clients.items()
    }


def _write_manifest(folder: GroupRunFolder, next_sha256: Mapping[str, str] | None = None) -> None:
    """Write the manifest, with hashes of what cannot change while the run is made, and a seal.

    `next_sha256` are hashes of files that are about to be written, and may already be in place when
    the run is opened.
    """
    configs = [CONFIG, *(f"{CONFIGS}/{name}.json" for name in folder.clients)]
    hashes = {
        name: files.sha256_from_file(folder.path / name)
        for name in configs
        if (folder.path / name).is_file()
    }
    data = {**asdict(folder.manifest), "clients": list(folder.clients), _FILES: hashes}
    if next_sha256:
        data[_FILES_TO_COME] = dict(next_sha256)
    files.write_json_with_checksum(folder.path / MANIFEST, data)


def _check_sealed(path: Path, data: JsonObject) -> None:
    """Take seal and hashes out of a manifest, and check them; one of an older version has none.

    Raises:
        PolicyError: The manifest, or a file that it has the hash of, is not as it was written.
    """
    sealed = files.verify_and_remove_checksum(data, str(path / MANIFEST), "; restore it")
    hashes = data.pop(_FILES, {})
    next_hashes = data.pop(_FILES_TO_COME, {})
    if not sealed:
        return
    for name, digest in hashes.items():
        allowed = (digest, next_hashes.get(name))
        if not (path / name).is_file() or files.sha256_from_file(path / name) not in allowed:
            raise PolicyError(f"{path / name} is damaged, or was changed by hand; restore it")


def _own_manifest(run: Path) -> JsonObject:
    """What a client's folder says of itself; nothing before it has begun."""
    return read_run_json(run, MANIFEST) if (run / MANIFEST).is_file() else {}


def _has_work(run: Path) -> bool:
    """Whether a client's folder holds a step, or results as `has_results` judges them."""
    manifest = _own_manifest(run)
    steps = manifest.get("steps", 0)
    # Stopped before its first step: its policy is the one that it started with.
    if manifest.get("status") == "interrupted" and steps == 0:
        return False
    return steps != 0 or has_results(run)


def _may_hold(log: Path, read: Callable[[Path], Iterator[T]], is_work: Callable[[T], bool]) -> bool:
    """Whether one of the records is work; a log that cannot be read may hold some."""
    try:
        return any(map(is_work, read(log)))
    except WcsimError:
        return True
