"""Ray clusters on this machine for tests: a head and nodes on 127.0.0.1, each with a cache of its own, to be killed."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

QUICK_TO_SEE = '{"health_check_period_ms": 1000, "health_check_timeout_ms": 2000, "health_check_failure_threshold": 5}'
"""A head's settings: nobody answers for some ten seconds, and a node is dead."""
_READY_S = 240.0


class RayNode:
    """A node and all its processes; a context manager.

    Args:
        cache: Where it keeps towns and streets.
        head: The address of its head, "" for a head.
        cpus: Workers that it offers.
        environment: More of it.
    """

    def __init__(self, cache: Path, head: str = "", cpus: int = 1, environment: dict[str, str] | None = None) -> None:
        self._work = tempfile.mkdtemp(prefix="wcray-")  # short: a socket's path has at most 107 letters
        said = Path(self._work) / "address.json"
        words = ["--head", head, "--cpus", str(cpus), "--folder", self._work, "--said", str(said)]
        with (Path(self._work) / "err").open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.support.cluster.ray_nodes", *words],
                env={**os.environ, "XDG_CACHE_HOME": str(cache), **quiet_environment(), **(environment or {})},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=log,
            )
        until_s = time.monotonic() + _READY_S
        while not said.is_file():
            if self._process.poll() is not None or time.monotonic() > until_s:
                self.kill()
                raise RuntimeError((Path(self._work) / "err").read_text(errors="replace")[-2000:])
            time.sleep(0.1)
        self.address = str(json.loads(said.read_text())["address"])

    def __enter__(self) -> RayNode:
        return self

    def __exit__(self, *exception: object) -> None:
        self.kill()

    def processes(self) -> list[psutil.Process]:
        """All of them, those that do the work among them."""
        with contextlib.suppress(psutil.NoSuchProcess):
            own = psutil.Process(self._process.pid)
            return [*own.children(recursive=True), own]
        return []

    def signal(self, number: int) -> None:
        """Send it to all of them."""
        for process in self.processes():
            with contextlib.suppress(psutil.NoSuchProcess):
                process.send_signal(number)

    def kill(self) -> None:
        """As a machine whose power fails."""
        self.signal(signal.SIGKILL)
        self._process.wait()


def quiet_environment() -> dict[str, str]:
    """For Ray's processes of a test: on loopback alone, nothing sent home, no token of the user's."""
    return {
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
        "RAY_AUTH_MODE": "disabled",
        "OMP_NUM_THREADS": "1",
        "RAY_gcs_rpc_server_connect_timeout_s": "120",  # on a busy machine
        "RAY_raylet_start_wait_time_s": "120",
    }


def _serve() -> None:
    """Be a node until somebody ends it; as `ray start`, which takes no loopback for its nodes."""
    parser = argparse.ArgumentParser()
    for word in ("--head", "--cpus", "--folder", "--said"):
        parser.add_argument(word, default="")
    words = parser.parse_args()
    from ray._private.node import Node
    from ray._private.parameter import RayParams

    own = {"gcs_server_port": free_port()} if not words.head else {"gcs_address": words.head}
    params = RayParams(
        node_ip_address="127.0.0.1",
        num_cpus=int(words.cpus),
        num_gpus=0,
        object_store_memory=120 << 20,
        include_dashboard=False if not words.head else None,
        include_log_monitor=False,
        temp_dir=words.folder,
        no_monitor=True,
        _system_config=json.loads(QUICK_TO_SEE) if not words.head else None,
        **own,
    )
    node = Node(params, head=not words.head, shutdown_at_exit=True, spawn_reaper=False)
    Path(words.said).with_suffix(".tmp").write_text(json.dumps({"address": node.address}))
    Path(words.said).with_suffix(".tmp").rename(words.said)
    while True:
        time.sleep(1.0)


def free_port() -> int:
    import socket

    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


if __name__ == "__main__":
    _serve()
