"""A training on three Ray nodes, of which one is killed and one is stopped: the same data and weights as on processes.

The nodes are processes of this machine, on 127.0.0.1, each with a cache of its own.
"""

import os
import signal
import threading
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest

from tests.agents.rounds.small_runs import outcome, rows_of, train_in
from tests.support.cluster.ray_nodes import RayNode, quiet_environment
from wcsim.agents.rounds.train_rounds import DATA, RoundProgress
from wcsim.errors import ConfigError, WorkersError
from wcsim.server.workers.machines import WorkerPoolSettings

pytestmark = pytest.mark.proof
LONGER = ("collect.segments=4", "collect.ticks=60")


@pytest.fixture(autouse=True)
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'wcsim[cluster]'")
    for name, value in quiet_environment().items():
        monkeypatch.setenv(name, value)


def trained(
    corner: Path, out: Path, machines: WorkerPoolSettings, *, resume: bool = False, show=lambda now: None
) -> tuple[str, str]:
    train_in(corner, out, *LONGER, resume=resume, machines=machines, progress=show)
    return outcome(out)


@pytest.fixture(scope="module")
def by_processes(corner: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """With one world, with two and with three: the same."""
    out = tmp_path_factory.mktemp("processes")
    found = {trained(corner, out / str(worlds), WorkerPoolSettings(count=worlds)) for worlds in (1, 2, 3)}
    assert len(found) == 1
    return found.pop()


def test_a_node_that_is_killed_and_one_that_is_stopped_change_nothing(by_processes, corner, tmp_path):
    told: list[str] = []
    with (
        RayNode(tmp_path / "head") as head,
        RayNode(tmp_path / "a", head.address) as killed,
        RayNode(tmp_path / "b", head.address) as stopped,
    ):
        hit: list[str] = []

        def harm(now: RoundProgress) -> None:
            busy = sum(bool(worker.key) for worker in now.workers)
            if len(now.workers) == 3 and busy == 3 and not hit:
                hit.append("killed")
                threading.Thread(target=killed.kill).start()
                stopped.signal(signal.SIGSTOP)

        try:
            machines = WorkerPoolSettings(cluster=head.address, report=told.append)
            assert trained(corner, tmp_path / "out", machines, show=harm) == by_processes
        finally:
            stopped.signal(signal.SIGCONT)
    assert hit and sum("is gone" in line for line in told) == 2, told
    rows = rows_of(tmp_path / "out")
    done = Counter(row["key"] for row in rows if row["how"] == "done")
    assert set(done.values()) == {1} and len(done) == 12
    assert [row for row in rows if row["how"] == "lost"]


def test_a_node_that_joins_works(by_processes, corner, tmp_path):
    told: list[str] = []
    joined: list[RayNode] = []
    with RayNode(tmp_path / "head") as head:

        def join(now: RoundProgress) -> None:
            if now.segments and not joined:
                joined.append(RayNode(tmp_path / "late", head.address))

        try:
            machines = WorkerPoolSettings(cluster=head.address, report=told.append)
            assert trained(corner, tmp_path / "out", machines, show=join) == by_processes
        finally:
            for node in joined:
                node.kill()
    assert len({row["worker"] for row in rows_of(tmp_path / "out")}) == 2


def test_a_cluster_lets_in_who_has_its_token_and_one_without_does_not_mind(by_processes, corner, tmp_path, monkeypatch):
    token, other = tmp_path / "token", tmp_path / "other"
    token.write_text("ab" * 32)
    other.write_text("cd" * 32)
    guarded = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(token)}
    monkeypatch.delenv("RAY_AUTH_MODE")
    monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(token))
    with RayNode(tmp_path / "a", environment=guarded) as head:
        assert trained(corner, tmp_path / "in", WorkerPoolSettings(cluster=head.address)) == by_processes
        for number, mode in enumerate(("token", "disabled")):  # another token, and none
            monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(other))
            monkeypatch.setenv("RAY_AUTH_MODE", mode)
            with pytest.raises(ConfigError, match="needs its token, and this user has none or another one"):
                trained(corner, tmp_path / str(number), WorkerPoolSettings(cluster=head.address))
    monkeypatch.delenv("RAY_AUTH_MODE")
    with RayNode(tmp_path / "b") as head:
        assert trained(corner, tmp_path / "free", WorkerPoolSettings(cluster=head.address)) == by_processes


def test_the_heads_death_ends_the_run_in_a_line_and_it_goes_on_from_its_checkpoint(by_processes, corner, tmp_path):
    out = tmp_path / "out"
    with RayNode(tmp_path / "head") as head:

        def die(now: RoundProgress) -> None:
            if now.round == 1 and now.segments == 1:
                head.kill()

        with pytest.raises(WorkersError, match=r"is lost: start its head again.*wcsim resume"):
            trained(corner, out, WorkerPoolSettings(cluster=head.address), show=die)
    assert (out / "checkpoints" / "round-000").is_dir()
    with RayNode(tmp_path / "again") as head:
        assert trained(corner, out, WorkerPoolSettings(cluster=head.address), resume=True) == by_processes


def test_a_worker_that_is_stopped_alone_is_killed(by_processes, corner, tmp_path, monkeypatch):
    """Its segment is driven again."""
    monkeypatch.setattr("wcsim.agents.rounds.collect_data.LEAST_LATE_S", 20.0)
    with RayNode(tmp_path / "head", cpus=2) as head:
        hit: list[int] = []

        def stop(now: RoundProgress) -> None:
            if now.round == 1 and not hit and (busy := [p.pid for p in head.processes() if _works(p)]):
                hit.append(busy[0])
                os.kill(busy[0], signal.SIGSTOP)

        assert trained(corner, tmp_path / "out", WorkerPoolSettings(cluster=head.address), show=stop) == by_processes
    assert hit
    assert not Path(f"/proc/{hit[0]}").exists()
    assert len(list((tmp_path / "out" / DATA / "segments").iterdir())) == 12


def _works(process) -> bool:
    """Whether a process of a node is at a piece; one that has just been killed is at none."""
    import psutil

    with suppress(psutil.Error):
        return any("ray::wcsim" in word for word in process.cmdline())
    return False
