"""What a world process and its clients are started with."""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

import msgspec

from wcsim.config import EnvConfig, RunConfig
from wcsim.core.reading import ORDER, read_bytes
from wcsim.errors import ConfigError, WcsimError
from wcsim.log.reader import iter_journal_part_inputs
from wcsim.log.records import EpochBegun, Ticked
from wcsim.log.writer import JOURNAL
from wcsim.server.launch.states import ClientStatusReport, WorldLaunchPlan, WorldStatusReport
from wcsim.server.protocol.client_core import Patience
from wcsim.server.protocol.events import ServerRules
from wcsim.server.protocol.messages import ANY_SEAT
from wcsim.towns.scenario.overrides import Override
from wcsim.types import SeatSpec
from wcsim.types.episode import RunPlace

WORLD_ARGV: Final = (sys.executable, "-m", "wcsim.server.host.process")
MOST_READ_BYTES: Final = 8 << 20  # of a journal, between a death and a restart


def seat_spec_from_env(env: EnvConfig) -> SeatSpec:
    """What a client with these settings requests when it takes a seat."""
    return SeatSpec(
        profile=env.profile,
        max_steps=env.max_steps,
        truth=env.truth,
        truth_visible=env.truth_visible,
        near=env.observation == "state",
    )


def town_name_for_epoch(town: str, more_towns: Sequence[str], epoch: int) -> str:
    """The name of the town of an epoch: a run's towns take turns, its own one first.

    >>> [town_name_for_epoch("helsinki", ("made:7", "made:8"), epoch) for epoch in (0, 1, 3)]
    ['helsinki', 'made:7', 'helsinki']
    """
    return (town, *more_towns)[epoch % (1 + len(more_towns))]


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldBuildSpec:
    """Everything that a world is made from."""

    town: str
    config: RunConfig
    seed: int
    seat: SeatSpec = SeatSpec()  # noqa: RUF009 - frozen; of a sole client
    seats: int = 1
    run: str = ""  # the run folder, where the outputs of the town's own scenario go
    hook: str = ""  # the user's own step hook, module:Class
    more_towns: tuple[str, ...] = ()  # see `town_name_for_epoch`

    @property
    def place(self) -> RunPlace:
        """Where the outputs of the world go, and its user's step hook."""
        return RunPlace(folder=Path(self.run) if self.run else None, hook=self.hook)


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldProcessSpec(WorldBuildSpec):
    """A world process: its world, how it is reached, and its rules with the number of seats."""

    rules: ServerRules
    endpoint: str  # ipc://..., in a folder that only its owner can enter
    ring: str  # folder for the shared memory of the seats' pictures
    name: str = ""
    journal: bool = True  # in the run folder; False: that is for the outputs alone
    listen: str = ""  # tcp://..., for clients on other machines
    keys: str = ""  # folder of CURVE keys; needed beyond loopback
    # After so many ticks, or by its growth, the process ends and has to be started again; 0: never.
    epoch_ticks: int = 0
    # No world of this launch has been there yet, and its clients take their time to load.
    begins: bool = False
    # A pipe for lines of WorldStatusReport; the process ends when its reader is closed.
    status_fd: int = -1
    quiet: bool = False  # errors go into that pipe alone, not to stderr too


@dataclass(frozen=True, slots=True, kw_only=True)
class SeatRequest:
    """How a client reaches its seat in a world process."""

    endpoint: str  # ipc://... or tcp://...
    name: str
    claim: str  # the same over all processes of a client
    spec: SeatSpec = SeatSpec()  # noqa: RUF009 - frozen
    seat: int = ANY_SEAT
    config: str = ""  # RunConfig.world_digest() that the client expects, "" for any
    keys: str = ""  # folder of CURVE keys
    ledger: str = ""  # file
    patience: Patience = field(default_factory=Patience)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunInfo:
    """What the manifest of a training run has beside its configuration."""

    seed: int  # of networks, exploration, replay and, unless that is a server's, the world
    town: str = ""  # name of the training town
    town_sha256: str = ""  # of its streets
    # Towns that take turns with it: the hashes of their streets by name.
    more_towns: dict[str, str] = field(default_factory=dict)
    rewards: tuple[str, ...] = ()  # the user's own reward terms, as module:Class
    command: tuple[str, ...] = ()  # what started the run
    hook: str = ""  # the user's own step hook, as module:Class
    overrides: tuple[Override, ...] = ()  # of the town's own SUMO options


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientProcessSpec:
    """A client process that learns: its seat, its own settings, its run folder, its manifest."""

    join: SeatRequest
    config: RunConfig
    out: str  # run folder
    info: RunInfo


T = TypeVar(
    "T", WorldProcessSpec, SeatRequest, ClientProcessSpec, WorldStatusReport, ClientStatusReport
)


def encode_json_line(
    value: WorldProcessSpec
    | SeatRequest
    | ClientProcessSpec
    | WorldStatusReport
    | ClientStatusReport,
) -> bytes:
    """A value as one line of JSON, with its newline."""
    return msgspec.json.encode(value, enc_hook=RunConfig.model_dump_json) + b"\n"


def decode_json_line(kind: type[T], line: bytes) -> T:
    """The value of a line. Raises ConfigError for any other line."""
    try:
        return msgspec.json.decode(
            line, type=kind, dec_hook=lambda _, text: RunConfig.model_validate_json(text)
        )
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise ConfigError(f"{line[:80]!r} is not a {kind.__name__}: {error}") from None


def make_world_launch_plan(
    order: WorldProcessSpec, place: Path, log: Path, argv: Sequence[str] = WORLD_ARGV
) -> WorldLaunchPlan:
    """How a launcher starts the world of an order, again and again.

    Args:
        order: The world.
        place: A folder that only its owner can enter; for the order's file.
        log: A file for the output of its process.
        argv: Its command line, but for the order's file.
    """

    def order_line(status_fd: int, begins: bool, listening: str) -> bytes:
        listen = listening or order.listen
        return encode_json_line(replace(order, status_fd=status_fd, begins=begins, listen=listen))

    file = place / "world.json"
    return WorldLaunchPlan(
        argv=(*argv, str(file)),
        order=order_line,
        order_file=file,
        log=log,
        last_tick=partial(_last_tick, order.run),
    )


def _last_tick(run: str, reported: int) -> int:
    """The last tick that a world has done in its last epoch.

    From its journal if it has one; otherwise the one that it has `reported`, which may be older.
    """
    journal = Path(run) / JOURNAL
    if not run or not journal.is_file() or journal.stat().st_size > MOST_READ_BYTES:
        return reported
    tick = 0
    try:
        # A world that died while it loaded has not reported its epoch: the last one counts.
        for record in iter_journal_part_inputs(journal):
            if isinstance(record, EpochBegun):
                tick = 0
            elif isinstance(record, Ticked):
                tick = record.tick
    except WcsimError:
        return reported
    return tick


def read_spec_file(kind: type[T], path: Path) -> T:
    """The value in a file. Raises ConfigError for any other file."""
    return decode_json_line(kind, read_bytes(path, ORDER))


def measure_rss_mb() -> float:
    """Memory of this process, in MB of 2**20 bytes."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 2**20
