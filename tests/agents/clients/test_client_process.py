"""A client's own process: how it ends, what it says, where its time went, what it begins again with."""

import json
import os
import signal
from itertools import count

import pytest

from tests.agents.learning.test_train import CAMERA, Nervous, config, street
from tests.agents.toy import ToyStreet, train_toy
from wcsim import errors
from wcsim.agents.clients.client import (
    _ProcessGrownError,
    _ProcessGrowth,
    _StatusPipe,
    _TimeShares,
    client_exit_from_error,
    train_client,
)
from wcsim.agents.clients.client_process import main
from wcsim.agents.learning.callbacks import StopSignalHandler, TrainProgress
from wcsim.config import LearnConfig
from wcsim.core.files import lock_run_folder
from wcsim.server.launch.states import ClientExitCode, ClientStatusReport
from wcsim.server.links.base import LinkWaitTimes
from wcsim.server.specs import ClientProcessSpec, RunInfo, SeatRequest, decode_json_line, encode_json_line
from wcsim.towns.scenario.overrides import Override


@pytest.mark.parametrize(
    "error, code",
    [
        (errors.InterruptedRunError, ClientExitCode.STOPPED),
        (_ProcessGrownError, ClientExitCode.GROWN),
        (errors.ConfigError, ClientExitCode.USER_ERROR),
        (errors.PolicyError, ClientExitCode.USER_ERROR),
        (errors.DiskFullError, ClientExitCode.DISK_FULL),
        (errors.ConfigMismatchError, ClientExitCode.USER_ERROR),
        (errors.VersionMismatchError, ClientExitCode.USER_ERROR),
        (errors.AccessError, ClientExitCode.USER_ERROR),
        (errors.PicturesError, ClientExitCode.USER_ERROR),
        (errors.ProtocolError, ClientExitCode.SERVER_GONE),
        (errors.EvictedError, ClientExitCode.EVICTED),
        (errors.StaleSessionError, ClientExitCode.EVICTED),
        (errors.ServerGoneError, ClientExitCode.SERVER_GONE),
        (errors.TickTimeoutError, ClientExitCode.SERVER_GONE),
        (errors.SeatTakenError, ClientExitCode.SERVER_GONE),
    ],
)
def test_how_a_client_ends(error, code):
    assert client_exit_from_error(error("so")) is code


def test_a_mistake_in_the_order_is_told_before_anybody_waits_for_the_client(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr("wcsim.agents.clients.client_process.die_with_parent", lambda: None)
    monkeypatch.setattr("wcsim.agents.clients.client_process.limit_orphan_lifetime", lambda *words: None)
    join = SeatRequest(endpoint=f"ipc://{tmp_path}/nobody", name="a", claim="c")
    order = ClientProcessSpec(
        join=join,
        config=config(network="nonesuch"),
        out=str(tmp_path / "run"),
        info=RunInfo(seed=1),
    )
    (tmp_path / "order").write_bytes(encode_json_line(order))
    assert main([str(tmp_path / "order")]) == ClientExitCode.USER_ERROR
    assert "wcsim: unknown network 'nonesuch'" in capfd.readouterr().err
    assert main([str(tmp_path / "none")]) == ClientExitCode.USER_ERROR
    assert not (tmp_path / "run").exists()


def test_an_order_brings_everything_that_the_manifest_says():
    override = Override(option="--step-length", author="1", wcsim="0.1", why="ticks")
    info = RunInfo(seed=1, town="a", rewards=("a:B",), command=("x",), hook="c:D", overrides=(override,))
    order = ClientProcessSpec(
        join=SeatRequest(endpoint="ipc://a", name="a", claim="c"), config=config(), out="o", info=info
    )
    assert decode_json_line(ClientProcessSpec, encode_json_line(order)) == order


class WaitingEnv:
    waits, epoch = LinkWaitTimes(steps=3, simulation_s=1.5, link_s=4.0), 0


def told(step, total=100):
    return TrainProgress(step=step, total_steps=total, phase=2, episodes=1, crashes=0, kpi1=None)


def test_status_lines_come_half_a_second_apart_and_in_the_end():
    reads, writes = os.pipe()
    pipe = _StatusPipe("a", writes, WaitingEnv(), _TimeShares(), _ProcessGrowth(LearnConfig()))
    for step in (1, 2, 3, 100):
        pipe.show(told(step))
    os.close(writes)
    lines = [decode_json_line(ClientStatusReport, line) for line in os.read(reads, 1 << 16).splitlines()]
    os.close(reads)
    assert [status.step for status in lines] == [1, 100]
    assert (lines[0].name, lines[0].simulation_s, lines[0].barrier_s) == ("a", 1.5, 2.5)


def test_a_client_whose_launcher_died_while_it_began_does_not_begin(tmp_path, monkeypatch):
    monkeypatch.setattr("wcsim.agents.clients.client_process.die_with_parent", lambda: None)
    monkeypatch.setattr("wcsim.agents.clients.client_process.limit_orphan_lifetime", lambda *words: None)
    reads, writes = os.pipe()
    os.close(reads)
    assert main([str(tmp_path / "none"), "--status-fd", str(writes)]) == ClientExitCode.SERVER_GONE
    os.close(writes)


def test_a_client_whose_launcher_is_gone_is_asked_once_and_may_save():
    reads, writes = os.pipe()
    os.close(reads)
    pipe = _StatusPipe("a", writes, WaitingEnv(), _TimeShares(), _ProcessGrowth(LearnConfig()))
    with StopSignalHandler() as request:
        signal.raise_signal(signal.SIGTERM)  # as the kernel does when the launcher dies
        pipe.show(told(100))
        pipe.show(told(100))
        os.close(writes)
    assert (request.requested, request.forced) == (True, False)


def test_time_shares_of_a_run_and_progress_at_every_rollout(tmp_path):
    shares, seen = _TimeShares(), []
    settings = config(total_steps=60, phase1_steps=20, learning_starts=10, train_every=4)
    train_toy(settings, tmp_path / "run", street, seen.append, seed=3, progress_every=1, callbacks=(shares,))
    assert shares.learning.calls == pytest.approx(50 / 4, abs=2)
    assert shares.inference.calls >= 40  # each step of the second phase, and some of the first
    assert min(shares.learning.seconds, shares.inference.seconds) > 0.0
    assert [now.step for now in seen] == sorted(now.step for now in seen)
    assert len(seen) >= 15


def test_a_client_that_has_grown_saves_its_work_and_says_that_another_process_goes_on(tmp_path, monkeypatch):
    class Seat(ToyStreet):
        waits, steps = LinkWaitTimes(), 0

        def __init__(self):
            super().__init__(CAMERA, max_steps=30)

        def step(self, action):
            self.steps += 1
            return super().step(action)

        def beat(self, progress):
            pass

        def wait_no_more(self):
            pass

        @property
        def epoch(self):
            return self.steps // 30

    monkeypatch.setattr("wcsim.agents.clients.client.WheelchairEnv", lambda *town, **options: Seat())
    monkeypatch.setattr("wcsim.agents.clients.client.SETTLED_STEPS", 5)
    memory_mb = count(100, 60)
    monkeypatch.setattr(
        "wcsim.agents.clients.client._ProcessGrowth", lambda learn: _ProcessGrowth(learn, lambda: next(memory_mb))
    )
    few = {"total_steps": 140, "phase1_steps": 20, "learning_starts": 10, "replay_frames": 100}
    settings = config(**few, process_growth_mb=50, checkpoint_every=1000)
    join = SeatRequest(endpoint=f"ipc://{tmp_path}/nobody", name="patch", claim="c")
    info = RunInfo(seed=1, town="toy", town_sha256="0" * 64)
    order = ClientProcessSpec(join=join, config=settings, out=str(tmp_path / "run"), info=info)
    with pytest.raises(_ProcessGrownError, match="grown from 100 to 160 MB") as told:
        train_client(order, resume=False)
    assert client_exit_from_error(told.value) is ClientExitCode.GROWN
    (kept,) = (path.name for path in (tmp_path / "run" / "checkpoints").glob("step-*"))
    assert kept == "step-00000120"
    train_client(order, resume=True)
    assert json.loads((tmp_path / "run" / "manifest.json").read_text())["status"] == "done"


def test_a_client_that_loses_its_world_keeps_what_it_has_learned(tmp_path):
    def fail():
        raise errors.ServerGoneError("gone")

    settings = config(total_steps=60, phase1_steps=20, learning_starts=10, checkpoint_every=1000)
    with pytest.raises(errors.ServerGoneError):
        train_toy(settings, tmp_path / "run", lambda: Nervous(31, fail), seed=3)
    assert [path.name for path in (tmp_path / "run" / "checkpoints").glob("step-*")] == ["step-00000030"]
    train_toy(settings, tmp_path / "run", street, seed=3, resume=True)
    assert json.loads((tmp_path / "run" / "manifest.json").read_text())["status"] == "done"


def test_measuring_changes_nothing(tmp_path):
    settings = config(total_steps=60, phase1_steps=20, learning_starts=10)
    train_toy(settings, tmp_path / "a", street, seed=3)
    train_toy(settings, tmp_path / "b", street, seed=3, progress_every=1, callbacks=(_TimeShares(),))
    a, b = ((tmp_path / name / "policies" / "final" / "weights.safetensors").read_bytes() for name in "ab")
    assert a == b
    assert json.loads((tmp_path / "a" / "manifest.json").read_text())["status"] == "done"


def test_a_run_folder_belongs_to_one_launcher_at_a_time(tmp_path):
    with (
        lock_run_folder(tmp_path),
        pytest.raises(errors.PolicyError, match="another process"),
        lock_run_folder(tmp_path),
    ):
        pass
    with lock_run_folder(tmp_path):
        pass
