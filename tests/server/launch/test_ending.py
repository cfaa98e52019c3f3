"""A launch that ends while its world is away: clients that wait for it save their work all the same."""

import pytest

from tests.server.launch.test_launcher import launcher, standings
from tests.support.events import read_events


@pytest.mark.parametrize("world", ["idle", "hang=0"])
def test_clients_that_wait_for_a_world_which_does_not_tick_save_their_work_and_leave(tmp_path, world):
    def stop_when_all_wait(state):
        if not state.stopping and all(client.status for client in state.clients):
            it.stop()

    clients = {"a": "waits", "b": "waits"}
    it = launcher(tmp_path, clients, world=world, show=stop_when_all_wait, world_lease_s=60.0)
    outcome = it.run()
    assert (outcome.code, outcome.stopped) == (0, True)
    assert standings(outcome) == {"a": "stopped", "b": "stopped"}
    assert [(tmp_path / name / "saved").exists() for name in "ab"] == [True, True], "what they have learned is gone"
    assert [line["code"] for line in read_events(tmp_path) if line["event"] == "stopped"] == [3, 3]
