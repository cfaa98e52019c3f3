"""The folder of a run with several clients in one world; each client's own run is a folder in it.

- manifest.json: what the run was made with, its clients, and its status
- config.json: the configuration of the world
- journal: everything that happened to the world
- ledgers/NAME.ledger: every frame that a client has seen
- events.jsonl, logs/: what the processes did and said
- NAME/: a run folder of its own for each client, see `agents/runfolder.py`
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from wcsim.agents import files
from wcsim.agents.runfolder import CONFIG, MANIFEST, METRICS, Manifest, Status, manifest_of, read_json
from wcsim.config import RunConfig, parse
from wcsim.errors import ConfigError, PolicyError

LEDGERS, LOGS = "ledgers", "logs"


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientsFolder:
    """An existing run of several clients."""

    path: Path
    config: RunConfig  # of the world
    manifest: Manifest
    clients: tuple[str, ...]  # in seat order

    def ledger(self, name: str) -> Path:
        """Where a client's ledger is."""
        return self.path / LEDGERS / f"{name}.ledger"

    def claim(self, name: str) -> str:
        """The secret by which a client is known again, also by a world that was made again from its journal."""
        path = self.path / LEDGERS / f"{name}.claim"
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch(mode=0o600)
            path.write_text(secrets.token_hex(16), encoding="ascii")
        return path.read_text(encoding="ascii")

    def log(self, name: str) -> Path:
        """Where a client's log is."""
        return self.path / LOGS / f"{name}.log"

    def done(self, name: str) -> bool:
        """Whether a client has learned all that it was to."""
        folder = self.path / name
        return (folder / MANIFEST).is_file() and read_json(folder, MANIFEST).get("status") == "done"

    def fruitless(self) -> bool:
        """Whether no client has finished an episode, or saved anything."""
        return not any(_has_work(self.path / name) for name in self.clients)

    def with_status(self, status: Status, steps: int) -> ClientsFolder:
        """Write a new status into the manifest."""
        return _written(replace(self, manifest=replace(self.manifest, status=status, steps=steps)))


def create_clients_folder(
    path: Path, config: RunConfig, manifest: Manifest, clients: Sequence[str]
) -> ClientsFolder:
    """Make a new folder. Raises PolicyError when it exists and is not empty."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise PolicyError(f"{path} exists and is not empty; choose another --out, or continue that run with --resume")
    path.mkdir(parents=True, exist_ok=True)
    files.write_bytes(path / CONFIG, config.model_dump_json(indent=2).encode())
    return _written(ClientsFolder(path=path, config=config, manifest=manifest, clients=tuple(clients)))


def open_clients_folder(path: Path) -> ClientsFolder:
    """Open an existing folder. Raises PolicyError when it is none."""
    data = read_json(path, MANIFEST)
    clients = data.pop("clients", None)
    if not isinstance(clients, list):
        raise PolicyError(f"{path} is a run of one client; expected one made with --clients: leave that option out")
    try:
        config = parse(RunConfig, read_json(path, CONFIG), str(path / CONFIG))
    except ConfigError as error:
        raise PolicyError(str(error)) from None
    manifest = manifest_of(data, path)
    return ClientsFolder(path=path, config=config, manifest=manifest, clients=tuple(map(str, clients)))


def _written(folder: ClientsFolder) -> ClientsFolder:
    files.write_json(folder.path / MANIFEST, {**asdict(folder.manifest), "clients": list(folder.clients)})
    return folder


def _has_work(run: Path) -> bool:
    metrics = run / METRICS
    episodes = len(metrics.read_bytes().splitlines()) - 1 if metrics.is_file() else 0
    steps = read_json(run, MANIFEST).get("steps", 0) if (run / MANIFEST).is_file() else 0
    return episodes > 0 or steps > 0 or any(run.glob("checkpoints/*"))
