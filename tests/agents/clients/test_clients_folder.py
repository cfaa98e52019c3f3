"""The folder of a run with several clients: when nothing is lost by removing it."""

from pathlib import Path

import pytest

from tests.support.one_process import die_after
from tests.support.worlds import dqn_config
from wcsim.agents.clients.group_run import (
    CONFIGS,
    GroupRunFolder,
    create_group_run_folder,
    open_group_run_folder,
)
from wcsim.agents.runs.run_folder import make_run_manifest
from wcsim.errors import PolicyError
from wcsim.log.records import SeenFrame
from wcsim.server.ledger import open_ledger_writer
from wcsim.server.specs import RunInfo


@pytest.fixture
def folder(tmp_path: Path) -> GroupRunFolder:
    config = dqn_config()
    manifest = make_run_manifest(config, RunInfo(seed=1, town="t"))
    return create_group_run_folder(tmp_path / "run", config, manifest, {"a": config, "b": config})


def write(folder: GroupRunFolder, name: str, *stepped: bool) -> None:
    with open_ledger_writer(folder.ledger(name), name) as ledger:
        for tick, own in enumerate(stepped):
            ledger.append(SeenFrame(epoch=0, tick=tick, stepped=own))


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


def longer(config, steps):
    return config.model_copy(update={"learn": config.learn.model_copy(update={"total_steps": steps})})


@pytest.mark.parametrize("written", [0, 1, 2, 3])
def test_a_process_that_ends_while_configurations_are_written_leaves_a_run_that_goes_on(folder, monkeypatch, written):
    more = {name: longer(folder.config, 900) for name in folder.clients}
    with monkeypatch.context() as dying:
        die_after(dying, written)
        with pytest.raises(KeyboardInterrupt):
            folder.rewrite(more)
            folder.with_status("running", 0)
    again = open_group_run_folder(folder.path)
    again.rewrite(more)
    again = again.with_status("running", 7)
    assert open_group_run_folder(folder.path) == again
    assert {again.client_config(name).learn.total_steps for name in "ab"} == {900}
    (folder.path / CONFIGS / "b.json").write_text(folder.config.model_dump_json(indent=2))
    with pytest.raises(PolicyError, match="changed by hand"):
        open_group_run_folder(folder.path)
