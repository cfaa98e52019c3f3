"""A client by hand: how long it waits for its world, and what its world hears of it."""

from __future__ import annotations

import pytest

from tests.server.servers import Server, stand_in_order
from wcsim.agents.clients.group_run import RECONNECT_S
from wcsim.cli.training import join

WORDS = ("--network", "patch", "--steps", "20")


@pytest.fixture
def joins(tmp_path, monkeypatch):
    """Joins the world of a server, and does something instead of learning; tells the server and the exit code."""
    monkeypatch.chdir(tmp_path)

    def joined(do):
        def train(run, make_env, progress, *, alive):
            do(make_env(), alive)
            return run.out

        monkeypatch.setattr("wcsim.agents.learning.train.train", train)
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
