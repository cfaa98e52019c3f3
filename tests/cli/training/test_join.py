"""A client by hand: how long it waits for its world, and what its world hears of it."""

import os
import re
import signal
from pathlib import Path

import pytest

from tests.cli.conftest import parsed
from tests.server.servers import Server, stand_in_order
from tests.support.events import read_events
from wcsim.agents.clients.client import make_client_env
from wcsim.agents.clients.group_run import RECONNECT_S
from wcsim.cli.training import join
from wcsim.config import RunConfig
from wcsim.core.files import lock_run_folder
from wcsim.errors import ConfigError, PolicyError, ServerGoneError
from wcsim.server.links.socket import SocketSeatLink
from wcsim.server.protocol.client_core import ClientPhase, Patience
from wcsim.server.specs import ClientProcessSpec, RunInfo, SeatRequest

ROOT = Path(__file__).parents[3]
WORDS = ("--network", "patch", "--steps", "20")


@pytest.fixture
def joins(tmp_path, monkeypatch):
    """Joins the world of a server, and does something instead of learning; tells the server and the exit code."""
    monkeypatch.chdir(tmp_path)

    def joined(do):
        def train(run, make_env, progress, *, alive):
            do(make_env(), alive)
            return run.out

        monkeypatch.setattr("wcsim.agents.learning.train.train_dqn", train)
        with Server(stand_in_order(tmp_path), tmp_path) as server:
            server.status()
            assert join.run([server.order.endpoint, *WORDS]) == 0

    return joined


def test_it_waits_as_long_as_a_world_may_take_to_come_back(joins):
    waits = []
    joins(lambda env, alive: waits.append(env._join.core.patience.reconnect_s))
    assert waits == [RECONNECT_S]


def test_its_world_hears_of_it_before_its_first_step_and_while_it_saves(joins):
    heard = []

    def learn(env, alive):
        env._join.beat = heard.append
        alive()  # a checkpoint is read
        env.reset()
        alive()  # one is written

    joins(learn)
    assert heard == [1, 2]


def test_one_that_is_supervised_is_started_again_after_a_death(tmp_path, monkeypatch):
    killed = []

    def kill_once(table, state):
        (client,) = state.clients
        if client.pid and client.status is not None and not killed:
            killed.append(client.pid)
            os.kill(client.pid, signal.SIGKILL)

    monkeypatch.setattr(join.LiveTable, "show", kill_once)
    with Server(stand_in_order(tmp_path), tmp_path) as server:
        server.status()
        words = ["--network", "patch", "--steps", "300", "--out", str(tmp_path / "run"), "--supervise"]
        assert join.run([server.order.endpoint, *words]) == 0
    events = [line["event"] for line in read_events(tmp_path / "run.supervised")]
    assert events == ["start", "death", "restart", "recovery", "done"]
    assert parsed(tmp_path / "run" / "manifest.json")["status"] == "done"


def test_a_world_that_was_never_there_is_refused_and_one_that_was_is_tried_again(tmp_path):
    nobody = f"ipc://{tmp_path}/nobody"
    words = ["--network", "patch", "--out", str(tmp_path / "run"), "--wait", "0.5", "--supervise"]
    with pytest.raises(ConfigError, match=r"no answer within 0\.5 s; is `wcsim serve` running"):
        join.run([nobody, *words])
    assert [line["event"] for line in read_events(tmp_path / "run.supervised")][:2] == ["start", "refused"]
    assert not (tmp_path / "run").exists()
    request = SeatRequest(endpoint=nobody, name="a", claim="a", patience=Patience(reconnect_s=0.2))
    order = ClientProcessSpec(join=request, config=RunConfig(), out="", info=RunInfo(seed=0))
    with pytest.raises(ServerGoneError):
        make_client_env(order, again=True)


@pytest.mark.parametrize("more", [(), ("--resume",)])
def test_a_folder_of_something_else_is_refused_before_a_life_could_remove_it(tmp_path, more):
    (tmp_path / "thesis.txt").touch()
    with pytest.raises(PolicyError, match=str(tmp_path)):
        join.run([f"ipc://{tmp_path}/nobody", "--network", "patch", "--out", str(tmp_path), "--supervise", *more])
    assert (tmp_path / "thesis.txt").exists()


def test_a_run_that_somebody_looks_after_is_not_looked_after_twice(tmp_path):
    words = ["--network", "patch", "--out", str(tmp_path / "run"), "--supervise"]
    (tmp_path / "run.supervised").mkdir()
    with lock_run_folder(tmp_path / "run.supervised"), pytest.raises(PolicyError, match="in use by another process"):
        join.run([f"ipc://{tmp_path}/nobody", *words])


def test_a_client_that_is_refused_once_it_has_a_seat_gives_it_back(tmp_path, monkeypatch):
    closed, close = [], SocketSeatLink.close
    monkeypatch.setattr(SocketSeatLink, "close", lambda seat: (closed.append(seat.core.phase), close(seat)))
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.txt").touch()
    with Server(stand_in_order(tmp_path), tmp_path) as server:
        server.status()
        with pytest.raises(PolicyError, match="not empty"):
            join.run([server.order.endpoint, *WORDS, "--out", str(tmp_path / "run")])
    assert len(closed) == 1 and closed[0] is not ClientPhase.JOINING


def test_commands_of_the_compose_file_hold_for_their_images(wcsim):
    text = (ROOT / "compose.yaml").read_text()
    stages = re.findall(r" AS (\w+)\n", (ROOT / "Dockerfile").read_text())
    assert set(re.findall(r"target: (\w+)", text)) <= set(stages)
    served, *joined = (" ".join(lines.split()) for lines in re.findall(r">-\n((?:      .+\n)+)", text))

    assert (
        "unknown town 'nowhere'" in wcsim(*served.replace("helsinki", "nowhere").replace("/keys", "keys").split()).err
    )
    names = [command.split("--name ")[1].split()[0] for command in joined]
    assert f"--make-keys {','.join(names)} " in served
    for command in joined:
        assert "expected ipc://FILE or tcp://HOST:PORT" in wcsim(*command.replace("tcp:", "udp:").split()).err
