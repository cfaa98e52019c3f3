"""Workers that are CPUs of the nodes of a Ray cluster, and the process that speaks to Ray for a run.

It is a process of its own because Ray ends the process that it is in when it loses its cluster, takes over its signals,
talks to its terminal, and can hang. It is asked again and again for what there is to hear. Whatever Ray says against
joining becomes one line. What must be the same on all machines of a run is asked of each node, so that work is the same
wherever it is done. Ray repeats no piece: the crew does, as it does for processes, away from the machine that lost it.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import socket
import sys
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from signal import SIGTERM, alarm, signal
from typing import Any, Final

from wcsim.core.files import home
from wcsim.core.own_folder import OwnFolder
from wcsim.core.processes import die_with_parent
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError, DiskFullError, WcsimError, WorkersError, check_installed
from wcsim.server.workers.cluster_node import (
    MOST_BYTES,
    do_work,
    facts_here,
    notes_on,
    packed,
    why_refused,
)
from wcsim.server.workers.machines import Facts, OneProcess, Parcel, Work, WorkEnd

LOCAL: Final = "local"
RAY_LOG, PIECES = "ray.log", "pieces.jsonl"
REACH_S: Final = 5.0
JOIN_S: Final = 90.0
_SILENT_S: Final = 120.0
_CLOSE_S: Final = 30.0
_GIVE_UP_S: Final = 3.0  # for a process that has not joined
_ADDRESS: Final = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):(\d{1,5})")
STORE_BYTES: Final = 160 << 20  # of objects on their way; what travels is small
_PATIENCE: Final = {
    "RAY_gcs_rpc_server_connect_timeout_s": "60",
    "RAY_raylet_start_wait_time_s": "80",
}
"""For busy machines, where Ray's own 5 s for a process to start are too short."""
_LOOPBACK: Final = re.compile(r"127\.\d+\.\d+\.\d+|localhost|\[?::1\]?")
_VERSIONS: Final = re.compile(r"Ray: (\S+)\s+Python: (\S+)")
_LOOK_S: Final = 2.0  # at which nodes there are
_WAIT_S: Final = 0.1
_GET_S: Final = 30.0
_MOST_TRIES: Final = 3
_MOST_SENT: Final = 64  # parcels that stay in Ray's store

Say = Callable[[str], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class _LinkSpec:
    """What the process that speaks to Ray is told."""

    address: str  # HOST:PORT, or `local`
    count: int  # processes of a local cluster
    log: Path  # for what Ray says
    temporary: Path = Path()  # of Ray, for a local cluster: its sockets, too


@dataclass(slots=True)
class _News:
    """What there is to hear of a cluster."""

    names: tuple[str, ...] = ()  # of all workers
    ended: list[WorkEnd] = field(default_factory=list)
    said: list[str] = field(default_factory=list)


class RayWorkers:
    """The CPUs of the nodes of a cluster, each of them a worker.

    Args:
        address: HOST:PORT of its head, or `local` for one that is made here.
        count: Workers of a local one.
        folder: For logs: what Ray says, and a line for each piece.
        say: Told of nodes that come, go, or are refused.
        join_s: So long Ray may take to join, and the first node to answer.

    Raises:
        ConfigError: There is no Ray, or no cluster at that address, or none of its nodes can be used.
    """

    def __init__(
        self, address: str, count: int, folder: Path, say: Say, join_s: float = JOIN_S
    ) -> None:
        require_address(address)
        folder.mkdir(parents=True, exist_ok=True)
        # Ray makes its folder at a name that others know, and lets them write there, unless it lies in one's own.
        self._own = OwnFolder(prefix="wcsim-ray-")
        self._spec = _LinkSpec(
            address=address, count=count, log=folder / RAY_LOG, temporary=self._own.path
        )
        self._say, self._pieces = say, folder / PIECES
        self._names: tuple[str, ...] = ()
        self._begun: list[tuple[str, Work, tuple[Parcel, ...]]] = []
        self._stopped: list[str] = []
        self._news: Future[_News] | None = None
        self._asked_s = 0.0
        self._link = OneProcess()
        try:
            self._join(join_s)
        except BaseException:
            self.close()
            raise

    def names(self) -> tuple[str, ...]:
        """The workers of nodes that may work now."""
        return self._names

    def begin(self, worker: str, work: Work) -> None:
        """Give a piece to a node, with what it needs."""
        self._begun.append((worker, work, work.needs(work.piece)))

    def stop(self, worker: str) -> None:
        """Have the process killed that a worker's piece is in."""
        self._stopped.append(worker)

    def ended(self, timeout_s: float) -> list[WorkEnd]:
        """What has come back; waits a while for it. Raises WorkersError when the cluster is lost."""
        try:
            if self._news is None:
                self._asked_s = time.monotonic()
                self._news = self._link.submit(_hear, self._spec, self._begun, self._stopped)
                self._begun, self._stopped = [], []
            if not wait((self._news,), timeout_s).done:
                if time.monotonic() - self._asked_s > _SILENT_S:
                    raise _lost(self._spec)
                return []
            news, self._news = self._news.result(), None
        except BrokenProcessPool:
            raise _lost(self._spec) from None
        self._names = news.names
        for told in news.said:
            self._say(told)
        for each in news.ended:
            self._note(each)
        return news.ended

    def close(self) -> None:
        """Leave the cluster; one that was made here ends."""
        try:
            with suppress(BrokenProcessPool):
                wait((self._link.submit(_leave),), _CLOSE_S if self._names else _GIVE_UP_S)
        finally:  # Ctrl-C may come while it waits, and Ray may hang
            self._link.kill()
            self._link.shutdown()
            self._own.close()

    def _join(self, join_s: float) -> None:
        """Wait for the first node that may work."""
        until_s = time.monotonic() + join_s
        while not self._names:
            if time.monotonic() > until_s:
                raise ConfigError(
                    f"--cluster {self._spec.address}: no node was ready within {join_s:.0f} s; expected a Ray head at "
                    f"that address, a node on this machine and CPUs (`ray start --address={self._spec.address} "
                    f"--num-cpus=N`); Ray's messages are in {self._spec.log}"
                )
            try:
                self.ended(0.2)
            except WorkersError as error:
                raise ConfigError(f"--cluster {self._spec.address}: {error}") from None

    def _note(self, ended: WorkEnd) -> None:
        """A line for a piece: who was at it, and what came of it. Raises DiskFullError."""
        how = "done" if ended.data is not None else "failed" if ended.error is not None else "lost"
        row = {
            "key": ended.key,
            "worker": ended.worker,
            "how": how,
            "why": ended.lost,
            **ended.facts,
        }
        try:
            with self._pieces.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
        except OSError as error:
            raise DiskFullError(
                f"{self._pieces}: cannot be written ({error.strerror}); make room"
            ) from None


def _lost(spec: _LinkSpec) -> WorkersError:
    head = f"the Ray cluster at {spec.address} is lost: start its head again, then"
    return WorkersError(
        f"{'the Ray of this run ended:' if spec.address == LOCAL else head} continue (a training: wcsim resume RUN; a "
        f"test: --resume); Ray's messages are in {spec.log}"
    )


def require_address(address: str) -> None:
    """Refuse what is no address of a cluster, or one where nobody answers. Raises ConfigError."""
    found = _ADDRESS.fullmatch(address)
    if address != LOCAL and (found is None or not 0 < int(found[2]) < 1 << 16):
        raise ConfigError(
            f"--cluster {escaped(address, 80)!r}: expected `local`, or HOST:PORT as `ray start --head` prints it, such "
            "as 10.0.0.1:6379"
        )
    check_installed("--cluster needs Ray", "cluster", "ray")
    if found is not None:
        try:
            socket.create_connection((found[1].strip("[]"), int(found[2])), REACH_S).close()
        except OSError as error:
            raise ConfigError(
                f"--cluster {address}: no answer within {REACH_S:g} s ({error.strerror or error}); "
                "start a Ray head there with `ray start --head --port=6379`, and check the firewall"
            ) from None


def _hear(
    spec: _LinkSpec, begun: list[tuple[str, Work, tuple[Parcel, ...]]], stopped: list[str]
) -> _News:
    """In the process that speaks to Ray: begin and stop these, and say what there is to hear.

    Raises:
        ConfigError: Ray cannot join, or all nodes were refused.
        WorkersError: Ray has lost its cluster.
    """
    try:
        link = _link(spec)
        for each in begun:
            link.begin(*each)
        for worker in stopped:
            link.stop(worker)
        return link.hear()
    except WcsimError:
        raise
    except SystemExit:  # the run is gone: Ray's own handler of SIGTERM, while it joins; a pool's process would go on
        os._exit(1)
    except Exception:
        traceback.print_exc()
        raise _lost(spec) from None  # what Ray raises is not to be unpickled by the run


def _leave() -> None:
    import ray

    ray.shutdown()


def _end(*_: object) -> None:
    """The run is gone, or somebody wants this process to end: leave, but do not wait for Ray for long."""
    alarm(int(_CLOSE_S))
    _leave()
    os._exit(1)


@cache
def _link(spec: _LinkSpec) -> _Link:
    """That of this process, which has joined. Raises ConfigError."""
    log = os.open(spec.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    os.dup2(log, sys.stdout.fileno())
    os.dup2(log, sys.stderr.fileno())
    die_with_parent(SIGTERM)  # a cluster that was made here does not outlive a run that was killed
    return _Link(spec, _join(spec))


def _join(spec: _LinkSpec) -> Any:
    """The module `ray`, joined. To be called once, in a process that is there for nothing else.

    Raises:
        ConfigError: Ray cannot join; with the cure.
    """
    _prepare(spec)
    import ray

    before = spec.log.stat().st_size if spec.log.exists() else 0
    try:
        if spec.address == LOCAL:
            ray.init(
                address=LOCAL,
                num_cpus=spec.count,
                num_gpus=0,
                include_dashboard=False,
                object_store_memory=STORE_BYTES,
                log_to_driver=False,
                configure_logging=False,
                _temp_dir=str(spec.temporary),
            )
        else:
            ray.init(address=spec.address, log_to_driver=False, configure_logging=False)
    except Exception as error:
        raise ConfigError(_told(spec, error, ray, _logged(spec.log, before))) from None
    signal(SIGTERM, _end)  # Ray's own handler is not heard while the run's question is answered
    return ray


def _prepare(spec: _LinkSpec) -> None:
    """What Ray reads of its environment when it is loaded; this process and those that it starts are its only users."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    for name, seconds in _PATIENCE.items():
        os.environ.setdefault(name, seconds)
    if spec.address == LOCAL or _is_loopback(spec.address):
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = (
            "0"  # Ray's word for: on 127.0.0.1, not on all addresses
        )
    if spec.address == LOCAL:
        os.environ["RAY_AUTH_MODE"] = "token"
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)  # known to nobody else, and on no disk
    elif _has_token():
        os.environ.setdefault(
            "RAY_AUTH_MODE", "token"
        )  # without a word Ray shows a token to no cluster that it joins


def _has_token() -> bool:
    """Whether this user has one, in any of the places where Ray looks."""
    own = home()
    named = any(os.environ.get(name) for name in ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"))
    return named or (own is not None and (own / ".ray" / "auth_token").is_file())


def _is_loopback(address: str) -> bool:
    """Whether a HOST:PORT is of this machine alone.

    >>> _is_loopback("127.0.0.1:6379"), _is_loopback("10.0.0.1:6379")
    (True, False)
    """
    return _LOOPBACK.fullmatch(address.rpartition(":")[0]) is not None


def _logged(log: Path, before: int) -> str:
    """What Ray has written beside what it raises, which names no token where none was shown."""
    with suppress(OSError), log.open("rb") as file:
        file.seek(before)
        return file.read(1 << 20).decode("utf-8", "replace")
    return ""


def _told(spec: _LinkSpec, error: Exception, ray: Any, logged: str = "") -> str:
    text = str(error)
    found = _VERSIONS.findall(text)
    if "ersion mismatch" in text and found:
        (theirs, python), ours = found[0], _VERSIONS.findall(text)[-1]
        return (
            f"--cluster {spec.address} runs Ray {theirs} with Python {python}; expected Ray {ours[0]} with Python "
            f"{ours[1]}, as here: install that on its nodes, or python -m pip install 'ray=={theirs}' here"
        )
    kind = type(error).__name__
    if kind == "AuthenticationError" or "auth" in text.lower() or "InvalidAuthToken" in logged:
        return (
            f"--cluster {spec.address} needs its token, and this user has none or another one; copy the "
            "head's file ~/.ray/auth_token to this machine, readable by you alone (chmod 600)"
        )
    first = next((line.strip() for line in text.splitlines() if line.strip()), kind)
    return (
        f"--cluster {spec.address}: Ray {ray.__version__} cannot join ({kind}: {first[:200]}); expected the address of "
        f"a head, and a node on this machine: `ray start --address={spec.address}`; Ray's messages are in {spec.log}"
    )


@dataclass(slots=True, kw_only=True)
class _Node:
    """A node, from the first look at it on."""

    name: str
    cpus: int
    state: str = "new"  # then "asked", then "works" or "refused", or "new" again
    tries: int = 0  # to ask it


@dataclass(frozen=True, slots=True, kw_only=True)
class _Begun:
    """A piece that a node is at."""

    worker: str
    node: str
    key: str
    since_s: float


class _Link:
    """One run's dealings with a cluster."""

    def __init__(self, spec: _LinkSpec, ray: Any) -> None:
        self._spec, self._ray = spec, ray
        self._here = facts_here()
        self._nodes: dict[str, _Node] = {}
        self._probes: dict[Any, str] = {}
        self._begun: dict[Any, _Begun] = {}
        self._news = _News()
        self._refused: list[str] = []
        self._works = False  # or has worked
        # A town is wanted again with every piece, a network with all pieces of its round.
        self._sent = lru_cache(_MOST_SENT)(lambda parcel: ray.put(packed(parcel)))
        self._looked_s = float("-inf")
        self._do = ray.remote(num_cpus=1, max_retries=0)(do_work)
        self._probe = ray.remote(num_cpus=0, max_retries=0)(facts_here)

    def begin(self, worker: str, work: Work, parcels: tuple[Parcel, ...]) -> None:
        """Give a piece to a worker's node."""
        name = worker.rpartition("/")[0]
        node = next(
            (
                key
                for key, each in self._nodes.items()
                if each.name == name and each.state == "works"
            ),
            "",
        )
        begun = _Begun(worker=worker, node=node, key=work.key, since_s=time.monotonic())
        if not node:  # it went while the piece was on its way here
            self._end(begun, lost="its node died", counts=False)
            return
        try:
            contents = [self._sent(parcel) for parcel in parcels]
        except (OSError, WcsimError) as error:  # of files here: no node could do better
            self._end(begun, error=error)
            return
        do = self._do.options(scheduling_strategy=self._on(node), name=f"wcsim {work.key}")
        self._begun[do.remote(worker, work, parcels, *contents)] = begun

    def stop(self, worker: str) -> None:
        """Have the process killed that a worker's piece is in."""
        for ref, begun in self._begun.items():
            if begun.worker == worker:
                self._ray.cancel(
                    ref, force=True
                )  # Ray kills the process, even one that was stopped

    def hear(self) -> _News:
        """What there is to hear; waits a moment for it. Raises ConfigError when all nodes were refused."""
        if time.monotonic() - self._looked_s > _LOOK_S:
            self._looked_s = time.monotonic()
            self._look()
        refs = [*self._probes, *self._begun]
        if refs:
            for ref in self._ray.wait(refs, num_returns=1, timeout=_WAIT_S)[0]:
                self._heard(ref)
        else:
            time.sleep(_WAIT_S)
        if (
            self._refused
            and not self._works
            and all(node.state == "refused" for node in self._nodes.values())
        ):
            raise ConfigError(f"--cluster {self._spec.address}: {'; '.join(self._refused)}")
        works = [node for node in self._nodes.values() if node.state == "works"]
        self._news.names = tuple(
            f"{node.name}/{slot + 1}" for node in works for slot in range(node.cpus)
        )
        news, self._news = self._news, _News()
        return news

    def _look(self) -> None:
        """Which nodes there are now."""
        alive = {node["NodeID"]: node for node in self._ray.nodes() if node["Alive"]}
        for gone in [each for each in self._nodes if each not in alive]:
            node = self._nodes.pop(gone)
            if node.state != "refused":
                self._news.said.append(f"node {node.name} is gone; its work goes to another node")
            # One that was stopped keeps its connections, and Ray would wait for it.
            for ref in [ref for ref, begun in self._begun.items() if begun.node == gone]:
                self._end(self._begun.pop(ref), lost="its node died", counts=False)
        taken = {node.name for node in self._nodes.values()}
        for key, found in alive.items():
            if key not in self._nodes:
                name = str(found["NodeManagerAddress"])
                name = f"{name}-{key[:4]}" if name in taken else name
                taken.add(name)
                self._nodes[key] = _Node(name=name, cpus=int(found["Resources"].get("CPU", 0)))
            if self._nodes[key].state == "new":
                self._nodes[key].state = "asked"
                self._probes[self._probe.options(scheduling_strategy=self._on(key)).remote()] = key

    def _on(self, node: str) -> Any:
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        return NodeAffinitySchedulingStrategy(node_id=node, soft=False)

    def _heard(self, ref: Any) -> None:
        """A node has answered, or will not any more."""
        try:
            answer = self._ray.get(ref, timeout=_GET_S)
        except self._ray.exceptions.GetTimeoutError:
            return  # its machine is slow to give it out, or cut off
        except Exception as error:
            answer = error
        if ref not in self._probes:
            self._take_back(self._begun.pop(ref), answer)
        elif node := self._nodes.get(self._probes.pop(ref)):
            self._judge(node, answer)

    def _take_back(self, begun: _Begun, answer: Any) -> None:
        if isinstance(answer, Exception):
            known = self._ray.exceptions
            of_machine = (
                known.NodeDiedError,
                known.TaskUnschedulableError,
                known.ObjectLostError,
                known.OwnerDiedError,
            )
            told = f"{type(answer).__name__}: {_line(answer, 0)}"
            self._end(begun, lost=told, counts=not isinstance(answer, of_machine))
            self._looked_s = float("-inf")  # its node may be gone
        elif not isinstance(answer, WorkEnd) or not isinstance(answer.data, bytes | None):
            self._end(
                begun,
                error=WorkersError(
                    f"{begun.key}: {begun.worker} has answered with what is no result"
                ),
            )
        elif len(answer.data or b"") > MOST_BYTES:
            told = f"has answered with more than {MOST_BYTES >> 20} MiB"
            self._end(begun, error=WorkersError(f"{begun.key}: {begun.worker} {told}"))
        else:
            self._end(begun, answer.facts, data=answer.data, error=answer.error, lost=answer.lost)

    def _end(self, begun: _Begun, facts: Facts | None = None, **what: Any) -> None:
        """Tell the run what has come of a piece."""
        whole = {**(facts or {}), "total_s": round(time.monotonic() - begun.since_s, 3)}
        self._news.ended.append(WorkEnd(worker=begun.worker, key=begun.key, facts=whole, **what))

    def _judge(self, node: _Node, answer: Any) -> None:
        """Whether a node may work."""
        if isinstance(answer, self._ray.exceptions.RayTaskError):
            why = (
                f"wcsim cannot be loaded there ({_line(answer, -1)}); install the same version as here: pip install "
                "'wcsim[cluster]'"
            )
        elif isinstance(answer, Exception):
            node.tries += 1
            if (
                node.tries < _MOST_TRIES
            ):  # Ray may not know yet how to reach a node that has just joined
                node.state = "new"
                return
            why = f"it could not start a process ({type(answer).__name__}: {_line(answer, 0)}); check that node"
        else:
            why = why_refused(answer, self._here)
        node.state = "refused" if why else "works"
        if why:
            told = f"node {node.name} is not used: {why}"
            self._refused.append(told)
            self._news.said.append(told)
            return
        self._works = True
        if self._spec.address != LOCAL:
            self._news.said.append(
                f"node {node.name} ({answer['host']}) works with {node.cpus} CPUs"
            )
        self._news.said += [f"node {node.name}: {note}" for note in notes_on(answer, self._here)]


def _line(error: Exception, which: int) -> str:
    """A line of what is said that is not empty."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[which][:200] if lines else ""
