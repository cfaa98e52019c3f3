"""What a world process and its clients are started with, and what they report while they run."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec

from wcsim.bridge.sumo.open_scenario import RunPlace
from wcsim.config import EnvConfig, RunConfig
from wcsim.core.reading import FileKind, read_bytes
from wcsim.errors import ConfigError, DiskFullError
from wcsim.server.protocol.client_core import Patience
from wcsim.server.protocol.events import Rules
from wcsim.server.protocol.messages import ANY_SEAT
from wcsim.towns.scenario.overrides import Override
from wcsim.types import SeatSpec

_MOST_ORDER_BYTES = 16 << 20


def seat_spec(env: EnvConfig) -> SeatSpec:
    """What a client with these settings asks for when it takes a seat."""
    return SeatSpec(profile=env.profile, max_steps=env.max_steps, truth=env.truth, truth_visible=env.truth_visible)


def town_of_epoch(town: str, more_towns: Sequence[str], epoch: int) -> str:
    """The word for the town of an epoch: a run's towns take turns, its own one first.

    >>> [town_of_epoch("helsinki", ("made:7", "made:8"), epoch) for epoch in (0, 1, 3)]
    ['helsinki', 'made:7', 'helsinki']
    """
    return (town, *more_towns)[epoch % (1 + len(more_towns))]


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldOrder:
    """Everything that a world is made from."""

    town: str
    config: RunConfig
    seed: int
    seat: SeatSpec = SeatSpec()  # noqa: RUF009 - frozen; of a sole client
    seats: int = 1
    run: str = ""  # the run folder, where the outputs of the town's own scenario go
    hook: str = ""  # the user's own step hook, module:Class
    more_towns: tuple[str, ...] = ()  # see `town_of_epoch`

    @property
    def place(self) -> RunPlace:
        """The same for a world."""
        return RunPlace(folder=Path(self.run) if self.run else None, hook=self.hook)


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldSpec(WorldOrder):
    """A world process: its world, how it is reached, and its rules, which say how many seats it has."""

    rules: Rules
    endpoint: str  # ipc://..., in a folder that only its owner can enter
    ring: str  # folder for the shared memory of the seats' pictures
    name: str = ""
    journal: bool = True  # in the run folder; False: that is for the outputs alone
    listen: str = ""  # tcp://..., for clients on other machines
    keys: str = ""  # folder of CURVE keys; needed beyond loopback
    epoch_ticks: int = 0  # after which it ends, or by its growth; whoever starts it has to start it again
    begins: bool = False  # no world of this launch has been there yet, and its clients take their time to load
    status_fd: int = -1  # a pipe for WorldStatus lines; the process ends when its other end is closed
    quiet: bool = False  # an error goes into that pipe alone, not to stderr too


@dataclass(frozen=True, slots=True, kw_only=True)
class SeatRequest:
    """How a client reaches its seat in a world process."""

    endpoint: str  # ipc://... or tcp://...
    name: str
    claim: str  # the same over all lives of a client
    spec: SeatSpec = SeatSpec()  # noqa: RUF009 - frozen
    seat: int = ANY_SEAT
    config: str = ""  # RunConfig.world_digest() that the client expects, "" for any
    keys: str = ""  # folder of CURVE keys
    ledger: str = ""  # file
    patience: Patience = field(default_factory=Patience)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunInfo:
    """What the manifest of a training run says of it, beside its configuration."""

    seed: int  # of networks, exploration, replay and, unless that is a server's, the world
    town: str = ""  # name of the training town
    town_sha256: str = ""  # of its streets
    more_towns: dict[str, str] = field(default_factory=dict)  # that take turns with it: their streets' hashes by word
    rewards: tuple[str, ...] = ()  # the user's own reward terms, as module:Class
    command: tuple[str, ...] = ()  # what started the run
    hook: str = ""  # the user's own step hook, as module:Class
    overrides: tuple[Override, ...] = ()  # of the town's own SUMO options


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientSpec:
    """A client process that learns: its seat, its own settings, its run folder, and what its manifest says."""

    join: SeatRequest
    config: RunConfig
    out: str  # run folder
    info: RunInfo


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """How long the others have waited for one client while the barrier filled."""

    name: str
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldStatus:
    """What a world process says of itself a few times a second."""

    stage: str  # "loading", or a Stage
    epoch: int = 0
    tick: int = 0
    ticks: int = 0  # done by this process
    ticks_per_s: float = 0.0  # over the last seconds
    step_ms: float = 0.0  # median of the last steps
    members: tuple[str, ...] = ()
    master: str = ""
    late: tuple[str, ...] = ()  # for whom the barrier waits
    late_s: float = 0.0  # since when
    rss_mb: float = 0.0
    held: tuple[Held, ...] = ()  # over the life of this process, by seat; those who left are not in it
    waited_s: tuple[tuple[float, ...], ...] = ()  # what each of `members` (rows) has waited for each (columns)
    listening: str = ""  # the address for clients on other machines


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientStatus:
    """What a client process says of itself."""

    name: str
    step: int = 0
    total_steps: int = 0
    phase: int = 1
    episodes: int = 0
    crashes: int = 0
    kpi1: float | None = None  # of the agent's own choice, mean of the last 2,000 steps
    simulation_s: float = 0.0  # waiting for the world's own work
    barrier_s: float = 0.0  # waiting for others, and for messages
    inference_s: float = 0.0
    learning_s: float = 0.0
    overlap_s: float = 0.0  # of learning_s, done while it waited: in one of the first two as well
    pid: int = 0  # of the life that these times are of


T = TypeVar("T", WorldSpec, SeatRequest, ClientSpec, WorldStatus, ClientStatus)


def to_line(value: WorldSpec | SeatRequest | ClientSpec | WorldStatus | ClientStatus) -> bytes:
    """A value as one line of JSON, with its newline."""
    return msgspec.json.encode(value, enc_hook=_config_text) + b"\n"


def _config_text(config: RunConfig) -> str:
    return config.model_dump_json()


def of_line(kind: type[T], line: bytes) -> T:
    """The value of a line. Raises ConfigError when it is none."""
    try:
        return msgspec.json.decode(line, type=kind, dec_hook=lambda _, text: RunConfig.model_validate_json(text))
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise ConfigError(f"{line[:80]!r} is not a {kind.__name__}: {error}") from None


def write_order(path: Path, line: bytes) -> None:
    """Write an order where its process looks for it; its folder is made again when somebody has removed it.

    Raises:
        DiskFullError: It could not be written.
    """
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.write_bytes(line)
    except OSError as error:
        raise DiskFullError(f"{path}: an order could not be written ({error.strerror}); make room") from None


def read_order(kind: type[T], path: Path) -> T:
    """The value in a file. Raises ConfigError when it is none."""
    return of_line(kind, read_bytes(path, FileKind(what=f"a {kind.__name__}", limit_bytes=_MOST_ORDER_BYTES)))


def rss_mb() -> float:
    """Memory of this process, in MB of 2**20 bytes."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 2**20
