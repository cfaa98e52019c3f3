"""Workers that are CPUs of the nodes of a Ray cluster, and the run's driver process for Ray.

Ray's driver has a process of its own: Ray ends its process when it loses the cluster, takes over
its signals, prints to its terminal, and can hang. `RayWorkerPool`, in the process of the run, polls
it. What Ray raises against joining becomes one line. What must be the same on all machines is
checked for each node, so that work gives the same result everywhere. Ray repeats no piece: the
scheduler does, as for processes, away from the machine that lost it.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import sys
import time
import traceback
from concurrent.futures import Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from signal import SIGTERM, alarm, signal
from typing import Any, Final, Literal

from wcsim.core.files import find_home_folder
from wcsim.core.own_folder import LockedTempFolder
from wcsim.core.processes import die_with_parent, kill_workers, start_single_worker_pool
from wcsim.errors import ConfigError, DiskFullError, WcsimError, WorkersError
from wcsim.server.workers.cluster_node import (
    MOST_BYTES,
    collect_machine_info,
    compress_input_files,
    find_node_mismatch,
    find_node_warnings,
    run_work_piece,
)
from wcsim.server.workers.machines import (
    LOCAL,
    Facts,
    Report,
    WorkInputFiles,
    WorkPiece,
    WorkResult,
    machine_from_worker,
    require_reachable_cluster,
)

_LOOPBACK: Final = re.compile(r"127\.\d+\.\d+\.\d+|localhost|\[?::1\]?")
_VERSIONS: Final = re.compile(r"Ray: (\S+)\s+Python: (\S+)")
_RAY_LOG: Final = "ray.log"
_PIECE_LOG: Final = "pieces.jsonl"
# Ray's object store on a local cluster; what travels is small.
_STORE_BYTES: Final = 160 << 20
# Input files that stay in that store.
_MOST_SENT: Final = 64
# Ray's own 5 s for a process to start are too short on busy machines.
_START_TIMEOUTS: Final = {
    "RAY_gcs_rpc_server_connect_timeout_s": "60",
    "RAY_raylet_start_wait_time_s": "80",
}
_JOIN_TIMEOUT_S: Final = 90.0
# Without an answer from the driver for so long, the cluster is lost.
_REQUEST_TIMEOUT_S: Final = 120.0
_CLOSE_TIMEOUT_S: Final = 30.0
_CLOSE_UNJOINED_TIMEOUT_S: Final = 3.0
_LIST_NODES_S: Final = 2.0
_POLL_S: Final = 0.1
_GET_TIMEOUT_S: Final = 30.0
_MOST_PROBES: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class _DriverSpec:
    """What the driver needs to join."""

    address: str  # HOST:PORT, or `local`
    count: int  # processes of a local cluster
    log: Path  # for Ray's output
    temporary: Path = Path()  # of Ray, for a local cluster: its sockets, too


@dataclass(slots=True)
class _Update:
    """What is new about a cluster."""

    names: tuple[str, ...] = ()  # of all workers
    results: list[WorkResult] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)


class RayWorkerPool:
    """The CPUs of the nodes of a cluster, each of them a worker.

    Args:
        address: HOST:PORT of its head, or `local` for one that is made here.
        count: Workers of a local one.
        folder: For logs: Ray's output, and a line for each piece.
        report: Called with a line for nodes that join, leave, or are refused.
        join_s: Time for Ray to join, and for the first node to answer.

    Raises:
        ConfigError: There is no Ray, or no cluster at that address, or no node can be used.
    """

    def __init__(
        self,
        address: str,
        count: int,
        folder: Path,
        report: Report,
        join_s: float = _JOIN_TIMEOUT_S,
    ) -> None:
        require_reachable_cluster(address)
        folder.mkdir(parents=True, exist_ok=True)
        # Ray makes its folder at a name that others know, and lets them write there, unless it lies
        # in one's own.
        self._own = LockedTempFolder(prefix="wcsim-ray-")
        self._spec = _DriverSpec(
            address=address, count=count, log=folder / _RAY_LOG, temporary=self._own.path
        )
        self._report = report
        self._piece_log = folder / _PIECE_LOG
        self._names: tuple[str, ...] = ()
        self._to_begin: list[tuple[str, WorkPiece, tuple[WorkInputFiles, ...]]] = []
        self._to_stop: list[str] = []
        self._request: Future[_Update] | None = None
        self._requested_s = 0.0
        self._driver = start_single_worker_pool()
        try:
            self._join(join_s)
        except BaseException:
            self.close()
            raise

    def names(self) -> tuple[str, ...]:
        """The workers of nodes that may work now."""
        return self._names

    def begin(self, worker: str, work: WorkPiece) -> None:
        """Give a piece to a node, with the files that it needs."""
        self._to_begin.append((worker, work, work.needs(work.piece)))

    def stop(self, worker: str) -> None:
        """Have the process killed that has a worker's piece."""
        self._to_stop.append(worker)

    def collect(self, timeout_s: float) -> list[WorkResult]:
        """The pieces that have ended; waits a while for one.

        Raises WorkersError when the cluster is lost.
        """
        try:
            if self._request is None:
                self._requested_s = time.monotonic()
                self._request = self._driver.submit(
                    _exchange, self._spec, self._to_begin, self._to_stop
                )
                self._to_begin = []
                self._to_stop = []
            if not wait((self._request,), timeout_s).done:
                if time.monotonic() - self._requested_s > _REQUEST_TIMEOUT_S:
                    raise _lost(self._spec)
                return []
            update = self._request.result()
            self._request = None
        except BrokenProcessPool:
            raise _lost(self._spec) from None
        self._names = update.names
        for message in update.messages:
            self._report(message)
        for result in update.results:
            self._log_piece(result)
        return update.results

    def close(self) -> None:
        """Leave the cluster; one that was made here ends."""
        try:
            with suppress(BrokenProcessPool):
                wait(
                    (self._driver.submit(_leave),),
                    _CLOSE_TIMEOUT_S if self._names else _CLOSE_UNJOINED_TIMEOUT_S,
                )
        finally:
            # Also where Ctrl-C ends the wait. Ray may hang, so its process is killed.
            kill_workers(self._driver)
            self._driver.shutdown()
            self._own.close()

    def _join(self, join_s: float) -> None:
        """Wait for the first node that may work."""
        until_s = time.monotonic() + join_s
        while not self._names:
            if time.monotonic() > until_s:
                raise ConfigError(
                    f"--cluster {self._spec.address}: no node was ready within {join_s:.0f} s; "
                    "expected a Ray head at that address, a node on this machine and CPUs "
                    f"(`ray start --address={self._spec.address} --num-cpus=N`); Ray's messages "
                    f"are in {self._spec.log}"
                )
            try:
                self.collect(0.2)
            except WorkersError as error:
                raise ConfigError(f"--cluster {self._spec.address}: {error}") from None

    def _log_piece(self, result: WorkResult) -> None:
        """Write which worker had a piece, and how it ended. Raises DiskFullError."""
        how = "lost"
        if result.data is not None:
            how = "done"
        elif result.error is not None:
            how = "failed"
        row = {
            "key": result.key,
            "worker": result.worker,
            "how": how,
            "why": result.lost,
            **result.facts,
        }
        try:
            with self._piece_log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
        except OSError as error:
            raise DiskFullError(
                f"{self._piece_log}: cannot be written ({error.strerror}); make room"
            ) from None


def _lost(spec: _DriverSpec) -> WorkersError:
    head = f"the Ray cluster at {spec.address} is lost: start its head again, then"
    return WorkersError(
        f"{'the Ray of this run ended:' if spec.address == LOCAL else head} continue (a training: "
        f"wcsim resume RUN; a test: --resume); Ray's messages are in {spec.log}"
    )


# --- in the driver's process ---


def _exchange(
    spec: _DriverSpec,
    to_begin: list[tuple[str, WorkPiece, tuple[WorkInputFiles, ...]]],
    to_stop: list[str],
) -> _Update:
    """Begin and stop these pieces, and return what is new.

    Raises:
        ConfigError: Ray cannot join, or all nodes were refused.
        WorkersError: Ray has lost its cluster.
    """
    try:
        driver = _driver(spec)
        for each in to_begin:
            driver.begin(*each)
        for worker in to_stop:
            driver.stop(worker)
        return driver.poll()
    except WcsimError:
        raise
    except SystemExit:
        # The run has ended: while Ray joins, its own handler of SIGTERM raises this. The pool's
        # process would go on.
        os._exit(1)
    except Exception:
        traceback.print_exc()
        # The run shall not unpickle what Ray raises.
        raise _lost(spec) from None


def _leave() -> None:
    import ray

    ray.shutdown()


@cache
def _driver(spec: _DriverSpec) -> _Driver:
    """That of this process; joins the cluster at the first call. Raises ConfigError."""
    log = os.open(spec.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    os.dup2(log, sys.stdout.fileno())
    os.dup2(log, sys.stderr.fileno())
    # A cluster that was made here does not outlive a run that was killed.
    die_with_parent(SIGTERM)
    return _Driver(spec, _join_cluster(spec))


def _join_cluster(spec: _DriverSpec) -> Any:
    """The module `ray`, joined. Only once, in a process that has no other task.

    Raises:
        ConfigError: Ray cannot join; with the cure.
    """
    _set_environment(spec)
    import ray

    log_size = spec.log.stat().st_size if spec.log.exists() else 0
    try:
        if spec.address == LOCAL:
            ray.init(
                address=LOCAL,
                num_cpus=spec.count,
                num_gpus=0,
                include_dashboard=False,
                object_store_memory=_STORE_BYTES,
                log_to_driver=False,
                configure_logging=False,
                _temp_dir=str(spec.temporary),
            )
        else:
            ray.init(address=spec.address, log_to_driver=False, configure_logging=False)
    except Exception as error:
        logged = _read_log(spec.log, log_size)
        raise ConfigError(_why_not_joined(spec, error, ray, logged)) from None
    # Ray's own handler does not run while a request of the run is answered.
    signal(SIGTERM, _on_sigterm)
    return ray


def _on_sigterm(*_: object) -> None:
    """Leave the cluster and end, but do not wait long for Ray."""
    alarm(int(_CLOSE_TIMEOUT_S))
    _leave()
    os._exit(1)


def _set_environment(spec: _DriverSpec) -> None:
    """Set what Ray reads when it is loaded, for this process and those that it starts."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    for name, seconds in _START_TIMEOUTS.items():
        os.environ.setdefault(name, seconds)
    if spec.address == LOCAL or _is_loopback(spec.address):
        # Ray's name for: on 127.0.0.1, not on all addresses.
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
    if spec.address == LOCAL:
        # Nothing else knows this token, and it is on no disk.
        os.environ["RAY_AUTH_MODE"] = "token"
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
    elif _has_token():
        # Without this Ray shows a token to no cluster that it joins.
        os.environ.setdefault("RAY_AUTH_MODE", "token")


def _has_token() -> bool:
    """Whether this user has a token, in any of the places where Ray searches."""
    own = find_home_folder()
    named = any(os.environ.get(name) for name in ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"))
    return named or (own is not None and (own / ".ray" / "auth_token").is_file())


def _is_loopback(address: str) -> bool:
    """Whether a HOST:PORT is of this machine alone.

    >>> _is_loopback("127.0.0.1:6379"), _is_loopback("10.0.0.1:6379")
    (True, False)
    """
    return _LOOPBACK.fullmatch(address.rpartition(":")[0]) is not None


def _read_log(log: Path, start: int) -> str:
    """Ray's log from byte `start` on.

    What Ray raises does not name the token where none was shown; its log does.
    """
    with suppress(OSError), log.open("rb") as file:
        file.seek(start)
        return file.read(1 << 20).decode("utf-8", "replace")
    return ""


def _why_not_joined(spec: _DriverSpec, error: Exception, ray: Any, logged: str = "") -> str:
    """A line with the cause and the cure of what Ray raised."""
    text = str(error)
    versions = _VERSIONS.findall(text)
    if "ersion mismatch" in text and versions:
        cluster_ray, cluster_python = versions[0]
        own_ray, own_python = versions[-1]
        return (
            f"--cluster {spec.address} runs Ray {cluster_ray} with Python {cluster_python}; "
            f"expected Ray {own_ray} with Python {own_python}, as here: install that on its nodes, "
            f"or python -m pip install 'ray=={cluster_ray}' here"
        )
    kind = type(error).__name__
    if kind == "AuthenticationError" or "auth" in text.lower() or "InvalidAuthToken" in logged:
        return (
            f"--cluster {spec.address} needs its token, and this user has none or another one; "
            "copy the head's file ~/.ray/auth_token to this machine, readable by you alone "
            "(chmod 600)"
        )
    return (
        f"--cluster {spec.address}: Ray {ray.__version__} cannot join "
        f"({kind}: {_line(error, 0) or kind}); expected the address of a head, and a node on this "
        f"machine: `ray start --address={spec.address}`; Ray's messages are in {spec.log}"
    )


@dataclass(slots=True, kw_only=True)
class _Node:
    """A node, since it was first listed."""

    name: str
    cpus: int
    state: Literal["new", "probed", "works", "refused"] = "new"
    failed_probes: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class _RunningPiece:
    worker: str
    node: str  # its id
    key: str
    since_s: float


class _Driver:
    """Ray's driver for one run: starts pieces on the nodes of a cluster, and reports their ends."""

    def __init__(self, spec: _DriverSpec, ray: Any) -> None:
        self._spec = spec
        self._ray = ray
        self._here = collect_machine_info()
        self._nodes: dict[str, _Node] = {}  # by id
        self._probes: dict[Any, str] = {}  # nodes by Ray's reference
        self._running: dict[Any, _RunningPiece] = {}
        self._update = _Update()
        self._refusals: list[str] = []
        self._has_worked = False
        # Every piece needs its town again, and all pieces of a round need the same network.
        self._send = lru_cache(_MOST_SENT)(lambda files: ray.put(compress_input_files(files)))
        self._listed_s = float("-inf")
        self._do = ray.remote(num_cpus=1, max_retries=0)(run_work_piece)
        self._probe = ray.remote(num_cpus=0, max_retries=0)(collect_machine_info)

    def begin(self, worker: str, work: WorkPiece, needed: tuple[WorkInputFiles, ...]) -> None:
        """Give a piece to a worker's node."""
        working = {node.name: id_ for id_, node in self._nodes.items() if node.state == "works"}
        node = working.get(machine_from_worker(worker), "")
        piece = _RunningPiece(worker=worker, node=node, key=work.key, since_s=time.monotonic())
        if not node:
            # It left while the piece was on its way here.
            self._settle(piece, lost="its node died", counts=False)
            return
        try:
            contents = [self._send(files) for files in needed]
        except (OSError, WcsimError) as error:
            # The files here are at fault: another node would end in the same way.
            self._settle(piece, error=error)
            return
        do = self._do.options(scheduling_strategy=self._on(node), name=f"wcsim {work.key}")
        self._running[do.remote(worker, work, needed, *contents)] = piece

    def stop(self, worker: str) -> None:
        """Have the process killed that has a worker's piece."""
        for ref, piece in self._running.items():
            if piece.worker == worker:
                # Forced, Ray kills the process, even one that a signal stopped.
                self._ray.cancel(ref, force=True)

    def poll(self) -> _Update:
        """What is new; waits a moment for it. Raises ConfigError when all nodes were refused."""
        if time.monotonic() - self._listed_s > _LIST_NODES_S:
            self._listed_s = time.monotonic()
            self._list_nodes()
        refs = [*self._probes, *self._running]
        if refs:
            for ref in self._ray.wait(refs, num_returns=1, timeout=_POLL_S)[0]:
                self._take_answer(ref)
        else:
            time.sleep(_POLL_S)
        nodes = self._nodes.values()
        all_refused = all(node.state == "refused" for node in nodes)
        if self._refusals and not self._has_worked and all_refused:
            raise ConfigError(f"--cluster {self._spec.address}: {'; '.join(self._refusals)}")
        self._update.names = tuple(
            f"{node.name}/{slot + 1}"
            for node in nodes
            if node.state == "works"
            for slot in range(node.cpus)
        )
        update, self._update = self._update, _Update()
        return update

    def _list_nodes(self) -> None:
        """Drop the nodes that have left, and probe new ones."""
        alive = {node["NodeID"]: node for node in self._ray.nodes() if node["Alive"]}
        for left in [id_ for id_ in self._nodes if id_ not in alive]:
            node = self._nodes.pop(left)
            if node.state != "refused":
                self._update.messages.append(
                    f"node {node.name} is gone; its work goes to another node"
                )
            # A stopped node keeps its connections, and Ray would wait for it.
            for ref in [ref for ref, piece in self._running.items() if piece.node == left]:
                self._settle(self._running.pop(ref), lost="its node died", counts=False)
        names = {node.name for node in self._nodes.values()}
        for id_, listed in alive.items():
            if id_ not in self._nodes:
                name = str(listed["NodeManagerAddress"])
                name = f"{name}-{id_[:4]}" if name in names else name
                names.add(name)
                self._nodes[id_] = _Node(name=name, cpus=int(listed["Resources"].get("CPU", 0)))
            if self._nodes[id_].state == "new":
                self._nodes[id_].state = "probed"
                self._probes[self._probe.options(scheduling_strategy=self._on(id_)).remote()] = id_

    def _on(self, node: str) -> Any:
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        return NodeAffinitySchedulingStrategy(node_id=node, soft=False)

    def _take_answer(self, ref: Any) -> None:
        """A node has answered, or will not any more."""
        try:
            answer = self._ray.get(ref, timeout=_GET_TIMEOUT_S)
        except self._ray.exceptions.GetTimeoutError:
            # Its machine is slow to send it, or disconnected.
            return
        except Exception as error:
            answer = error
        if ref not in self._probes:
            self._settle_with(self._running.pop(ref), answer)
        elif node := self._nodes.get(self._probes.pop(ref)):
            self._judge(node, answer)

    def _settle_with(self, piece: _RunningPiece, answer: Any) -> None:
        if isinstance(answer, Exception):
            known = self._ray.exceptions
            of_machine = (
                known.NodeDiedError,
                known.TaskUnschedulableError,
                known.ObjectLostError,
                known.OwnerDiedError,
            )
            text = f"{type(answer).__name__}: {_line(answer, 0)}"
            self._settle(piece, lost=text, counts=not isinstance(answer, of_machine))
            # Its node may have left.
            self._listed_s = float("-inf")
        elif not isinstance(answer, WorkResult) or not isinstance(answer.data, bytes | None):
            text = f"{piece.key}: {piece.worker} has answered with what is no result"
            self._settle(piece, error=WorkersError(text))
        elif len(answer.data or b"") > MOST_BYTES:
            text = f"has answered with more than {MOST_BYTES >> 20} MiB"
            self._settle(piece, error=WorkersError(f"{piece.key}: {piece.worker} {text}"))
        else:
            self._settle(
                piece, answer.facts, data=answer.data, error=answer.error, lost=answer.lost
            )

    def _settle(self, piece: _RunningPiece, facts: Facts | None = None, **how: Any) -> None:
        """Report the end of a piece."""
        facts = {**(facts or {}), "total_s": round(time.monotonic() - piece.since_s, 3)}
        result = WorkResult(worker=piece.worker, key=piece.key, facts=facts, **how)
        self._update.results.append(result)

    def _judge(self, node: _Node, answer: Any) -> None:
        """Let a node work, refuse it, or have it probed again."""
        if isinstance(answer, self._ray.exceptions.RayTaskError):
            why = (
                f"wcsim cannot be loaded there ({_line(answer, -1)}); install the same version as "
                "here: pip install 'wcsim[cluster]'"
            )
        elif isinstance(answer, Exception):
            node.failed_probes += 1
            if node.failed_probes < _MOST_PROBES:
                # Ray may not know yet how to reach a node that has just joined.
                node.state = "new"
                return
            why = (
                f"it could not start a process ({type(answer).__name__}: {_line(answer, 0)}); "
                "check that node"
            )
        else:
            why = find_node_mismatch(answer, self._here)
        messages = self._update.messages
        if why:
            node.state = "refused"
            refusal = f"node {node.name} is not used: {why}"
            self._refusals.append(refusal)
            messages.append(refusal)
            return
        node.state = "works"
        self._has_worked = True
        if self._spec.address != LOCAL:
            messages.append(f"node {node.name} ({answer['host']}) works with {node.cpus} CPUs")
        messages += [f"node {node.name}: {note}" for note in find_node_warnings(answer, self._here)]


def _line(error: Exception, index: int) -> str:
    """One of the lines of an error's text that are not empty, shortened."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[index][:200] if lines else ""
