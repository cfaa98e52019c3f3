"""A run that is asked to stop while its world is away, or while it saves: nothing of it is lost."""

import signal

import pytest

from tests.agents.learning.test_train import Nervous, config
from tests.agents.toy import a_run, stopped_while_away, train_toy
from wcsim.agents.learning.train import train_dqn
from wcsim.agents.runs.checkpoint import newest_checkpoint_number
from wcsim.agents.runs.run_folder import open_run
from wcsim.errors import InterruptedRunError, ServerGoneError
from wcsim.server.launch.states import WAIT_NO_MORE


def test_a_run_that_is_stopped_while_its_world_is_away_keeps_all_its_steps(tmp_path):
    waits = []
    env, before = Nervous(150, lambda: stopped_while_away(waits)), signal.getsignal(WAIT_NO_MORE)
    with pytest.raises(InterruptedRunError, match="wcsim resume"):
        train_toy(config(), tmp_path / "run", lambda: env, wait_no_more=lambda: waits.append(True))
    manifest = open_run(tmp_path / "run").manifest
    assert (manifest.status, manifest.steps) == ("interrupted", 149)
    assert newest_checkpoint_number(tmp_path / "run" / "checkpoints") == 149
    assert signal.getsignal(WAIT_NO_MORE) is before


@pytest.mark.parametrize("again, last", [(False, 149), (True, 120)])
def test_ctrl_c_while_the_world_is_silent_shortens_the_wait_and_keeps_all_steps(again, last, tmp_path):
    """A second one, `again` while that is saved, leaves the checkpoint before."""

    def away():
        signal.raise_signal(signal.SIGINT)
        assert less, "it waits as long as ever"
        raise ServerGoneError("nobody answers")

    def saves():
        if again and less:
            signal.raise_signal(signal.SIGINT)

    env, less = Nervous(150, away), []
    env.unwrapped.wait_less = lambda: less.append(True)
    with pytest.raises(InterruptedRunError, match="wcsim resume"):
        train_toy(config(), tmp_path / "run", lambda: env, alive=saves)
    assert newest_checkpoint_number(tmp_path / "run" / "checkpoints") == last
    assert open_run(tmp_path / "run").manifest.status == "interrupted"


def test_a_second_signal_that_was_sent_to_all_does_not_tear_what_a_client_saves(tmp_path):
    asked = []

    def saves():
        if asked:  # the checkpoint before the end is being written
            signal.raise_signal(signal.SIGTERM)

    def ask():
        asked.append(True)
        signal.raise_signal(signal.SIGTERM)

    run = a_run(config(), tmp_path / "run", 5)
    with pytest.raises(InterruptedRunError):
        train_dqn(run, lambda: Nervous(150, ask), alive=saves, wait_no_more=lambda: asked.append(False))
    assert newest_checkpoint_number(tmp_path / "run" / "checkpoints") == 152
    assert False in asked
