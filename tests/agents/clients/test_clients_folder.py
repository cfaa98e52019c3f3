"""The folder of a run with several clients: when nothing is lost by removing it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.worlds import dqn_config
from wcsim.agents.clients.clients_folder import ClientsFolder, create_clients_folder
from wcsim.agents.runs.run_folder import make_manifest
from wcsim.server.journal.ledger import LedgerEntry, LedgerWriter
from wcsim.server.specs import RunInfo


@pytest.fixture
def folder(tmp_path: Path) -> ClientsFolder:
    config = dqn_config()
    manifest = make_manifest(config, RunInfo(seed=1, town="t"))
    return create_clients_folder(tmp_path / "run", config, manifest, {"a": config, "b": config})


def write(folder: ClientsFolder, name: str, *stepped: bool) -> None:
    with LedgerWriter(folder.ledger(name)) as ledger:
        for tick, own in enumerate(stepped):
            ledger.add(LedgerEntry(session=b"s" * 16, epoch=0, tick=tick, stepped=own))


def test_a_run_in_which_clients_only_joined_is_fruitless(folder):
    assert folder.fruitless()
    write(folder, "a", False)
    assert folder.fruitless()


def test_a_run_with_one_step_is_not(folder):
    write(folder, "b", False, True)
    assert not folder.fruitless()


def test_a_run_whose_ledger_is_damaged_is_somebodys_work(folder):
    write(folder, "a", False, False, False)
    data = bytearray(folder.ledger("a").read_bytes())
    data[5] ^= 1
    folder.ledger("a").write_bytes(data)
    assert not folder.fruitless()
