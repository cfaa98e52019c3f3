"""A training on three machines with addresses of their own, 20 ms and 100 Mbit/s apart, one of them cut off for 30 s.

The machines are network namespaces of this one, started as docs/cluster.md says. What a segment costs on the
wire, and how much time that takes, is printed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest

from tests.agents.rounds.small_runs import outcome, rows_of, train_in
from tests.support.cluster import slow_net
from tests.support.cluster.slow_net import SlowNet, address_of

pytestmark = pytest.mark.proof
CUT_S = 30.0
LONGER = ("collect.segments=6", "collect.ticks=120")
_WHY_NOT = slow_net.why_not()
TRAIN = """
import sys
from pathlib import Path
from tests.agents.rounds.small_runs import run_in
from wcsim.agents.rounds.train_rounds import train_danger
from wcsim.server.workers.machines import WorkerPoolSettings
from wcsim.towns.scenario.town import find_town

if __name__ == "__main__":
    corner, out, address, *words = sys.argv[1:]
    run = run_in(Path(corner), Path(out), *words)
    machines = WorkerPoolSettings(cluster=address, report=lambda told: print(told, flush=True))
    train_danger(run, find_town(corner), machines)
"""


class Machine:
    """A namespace with a Ray node in it, started by `ray start`; a context manager."""

    def __init__(self, net: SlowNet, number: int, cache: Path, head: str) -> None:
        self._temp = tempfile.mkdtemp(prefix="wcray-")
        ray = [str(Path(sys.executable).with_name("ray")), "start", "--disable-usage-stats", "--num-cpus=1"]
        where = ["--head", "--port=6379", "--include-dashboard=false"] if number == 0 else [f"--address={head}"]
        more = [f"--node-ip-address={address_of(number)}", f"--temp-dir={self._temp}", "--block"]
        self._process = subprocess.Popen(
            net.inside(number, [*ray, *where, *more, "--object-store-memory=120000000"]),
            env=environment(cache),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        said = ""
        for line in self._process.stdout or ():
            said += line
            if "runtime started" in line:
                return
        raise RuntimeError(said)

    def __enter__(self) -> Machine:
        return self

    def __exit__(self, *exception: object) -> None:
        import psutil

        own = psutil.Process(self._process.pid)
        for process in [*own.children(recursive=True), own]:
            process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


def environment(cache: Path) -> dict[str, str]:
    own = {"XDG_CACHE_HOME": str(cache), "RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}
    patient = {"RAY_gcs_rpc_server_connect_timeout_s": "120", "RAY_raylet_start_wait_time_s": "120"}
    return {**os.environ, **own, **patient, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}


@pytest.mark.skipif(bool(_WHY_NOT), reason=f"a slow network {_WHY_NOT}")
def test_three_machines_and_a_cut_link(corner: Path, tmp_path: Path, capsys):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'wcsim[cluster]'")
    train_in(corner, tmp_path / "alone", *LONGER)
    out, head, cut = tmp_path / "out", f"{address_of(0)}:6379", []
    with (
        SlowNet(3) as net,
        Machine(net, 0, tmp_path / "a", head),
        Machine(net, 1, tmp_path / "b", head),
        Machine(net, 2, tmp_path / "c", head),
    ):
        began_s = time.monotonic()
        words = [sys.executable, "-c", TRAIN, str(corner), str(out), head, *LONGER]
        run = subprocess.Popen(net.inside(0, words), env=environment(tmp_path / "a"))
        cutter = threading.Thread(target=_cut_when_it_drives, args=(net, out, cut), daemon=True)
        cutter.start()
        assert run.wait(2000) == 0
        took_s = time.monotonic() - began_s
    assert outcome(out) == outcome(tmp_path / "alone")
    rows = rows_of(out)
    assert cut == ["off", "on"] and len({row["worker"] for row in rows if row["how"] == "done"}) == 3
    with capsys.disabled():
        sys.stdout.write(_told(rows, took_s))


def _cut_when_it_drives(net: SlowNet, out: Path, cut: list[str]) -> None:
    """Cut the third machine off once it has driven a segment, and let it in again."""
    pieces = out / "cluster" / "pieces.jsonl"
    while not pieces.is_file() or f'"{address_of(2)}/1", "how": "done"' not in pieces.read_text():
        time.sleep(0.2)
    net.cut(2, off=True)
    cut.append("off")
    time.sleep(CUT_S)
    net.cut(2, off=False)
    cut.append("on")


def _told(rows: list[dict], took_s: float) -> str:
    done = [row for row in rows if row["how"] == "done" and not row["worker"].startswith(f"{address_of(0)}/")]
    begun: set[int] = set()  # with its first piece a process starts
    done = [row for row in done if row["pid"] in begun or begun.add(row["pid"])]
    total_s, work_s = sum(row["total_s"] for row in done), sum(row["work_s"] for row in done)
    lost = sum(row["how"] == "lost" for row in rows)
    return (
        f"\n{len(done)} segments of other machines: {sum(row['bytes'] for row in done) / len(done) / 1e3:.0f} kB each "
        f"back; {1 - work_s / total_s:.1%} of their time went to the network; {lost} lost; {took_s:.0f} s in all\n"
    )
