"""The process that speaks to Ray: gives work to nodes, notices those that come and go, passes on what they answer.

It is a process of its own because Ray ends the process that it is in when it loses its cluster, takes over its signals,
and talks to its terminal. The run hears of the cluster by a pipe.
"""

from __future__ import annotations

import os
import secrets
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Final

from wcsim.errors import ConfigError, WcsimError, WorkersError
from wcsim.server.workers.cluster.bundle import digest_of, packed
from wcsim.server.workers.cluster.joining import LOCAL, LinkSpec, join
from wcsim.server.workers.cluster.node_facts import facts_here, facts_of, notes_on, why_refused
from wcsim.server.workers.cluster.on_node import Reply, SentParcel, SentWork, do_work, kill_worker
from wcsim.server.workers.worker_api import Parcel, Work, WorkEnd

_LOOK_S: Final = 2.0  # at which nodes there are
_WAIT_S: Final = 0.05
_GET_S: Final = 30.0
_MOST_TRIES: Final = 3
_MOST_LOOSE: Final = 8  # parcels that are remembered and not wanted again


@dataclass(slots=True, kw_only=True)
class _Node:
    """A node, from the first look at it on."""

    name: str
    cpus: int
    state: str = "asked"  # then "works" or "refused"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Begun:
    """A piece that a node is at."""

    worker: str
    node: str
    work: Work
    attempt: str
    since_s: float


def run_link(pipe: Connection, spec: LinkSpec) -> None:
    """Join, and serve the pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the run, which closes the pipe
    log = os.open(spec.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    os.dup2(log, sys.stdout.fileno())
    os.dup2(log, sys.stderr.fileno())
    try:
        ray = join(spec)
    except WcsimError as error:
        pipe.send(("refused", str(error)))
        return
    try:
        _Link(pipe, spec, ray).serve()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass  # the run has ended
    except Exception:  # Ray has lost its cluster; its log has the rest, and the run hears of it by the end of the pipe
        traceback.print_exc()
        pipe.close()
    ray.shutdown()


class _Link:
    """One run's dealings with a cluster."""

    def __init__(self, pipe: Connection, spec: LinkSpec, ray: Any) -> None:
        self._pipe, self._spec, self._ray = pipe, spec, ray
        self._here = facts_here()
        self._nodes: dict[str, _Node] = {}
        self._probes: dict[Any, str] = {}
        self._begun: dict[Any, _Begun] = {}
        self._kept: dict[str, SentParcel] = {}  # by address
        self._loose: dict[str, SentParcel] = {}
        self._tries: dict[str, int] = {}  # to ask a node
        self._looked_s = float("-inf")
        self._do = ray.remote(num_cpus=1, max_retries=0)(do_work)
        self._kill = ray.remote(num_cpus=0, max_retries=0)(kill_worker)
        self._probe = ray.remote(num_cpus=0, max_retries=0)(_look_at_node())
        self._pipe.send(("joined", ""))

    def serve(self) -> None:
        """Go on until the pipe is closed, which is an EOFError."""
        while True:
            if time.monotonic() - self._looked_s > _LOOK_S:
                self._looked_s = time.monotonic()
                self._look()
            while self._pipe.poll(0.0 if self._begun or self._probes else _WAIT_S):
                word, what = self._pipe.recv()
                if word == "begin":
                    self._begin(*what)
                elif word == "stop":
                    self._stop(what)
            refs = [*self._probes, *self._begun]
            if refs:
                ready, _ = self._ray.wait(refs, num_returns=1, timeout=_WAIT_S)
                for ref in ready:
                    self._heard(ref)

    def _look(self) -> None:
        """Which nodes there are now."""
        alive = {node["NodeID"]: node for node in self._ray.nodes() if node["Alive"]}
        for gone in [each for each in self._nodes if each not in alive]:
            node = self._nodes.pop(gone)
            if node.state != "refused":
                self._say(f"node {node.name} is gone; its work goes to another node")
            self._give_up(gone)
        taken = {node.name for node in self._nodes.values()}
        for key, found in alive.items():
            if key not in self._nodes:
                name = str(found["NodeManagerAddress"])
                name = f"{name}-{key[:4]}" if name in taken else name
                taken.add(name)
                self._nodes[key] = _Node(name=name, cpus=int(found["Resources"].get("CPU", 0)))
                self._probes[self._probe.options(scheduling_strategy=self._on(key)).remote()] = key
        self._tell_workers()

    def _give_up(self, node: str) -> None:
        """Wait no longer for a node: one that was stopped keeps its connections, and Ray would wait for them."""
        for ref, begun in [item for item in self._begun.items() if item[1].node == node]:
            del self._begun[ref]
            self._pipe.send(("ended", _lost_with_its_node(begun)))

    def _tell_workers(self) -> None:
        works = [(key, node) for key, node in self._nodes.items() if node.state == "works"]
        names = [f"{node.name}/{slot + 1}" for _, node in works for slot in range(node.cpus)]
        self._pipe.send(("workers", (tuple(names), sum(node.state == "asked" for node in self._nodes.values()))))

    def _on(self, node: str) -> Any:
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        return NodeAffinitySchedulingStrategy(node_id=node, soft=False)

    def _begin(self, worker: str, work: Work, parcels: tuple[Parcel, ...]) -> None:
        name = worker.rpartition("/")[0]
        node = next((key for key, each in self._nodes.items() if each.name == name and each.state == "works"), None)
        if node is None:
            self._pipe.send(("ended", WorkEnd(worker=worker, key=work.key, lost="its node died", counts=False)))
            return
        try:
            sent = tuple(self._sent(parcel) for parcel in parcels)
        except (OSError, WcsimError) as error:
            self._pipe.send(("ended", WorkEnd(worker=worker, key=work.key, error=error)))
            return
        attempt = secrets.token_hex(4)
        whole = SentWork(
            run=self._spec.run, key=work.key, attempt=attempt, call=work.call, piece=work.piece, parcels=sent
        )
        options = {"scheduling_strategy": self._on(node), "name": f"wcsim {work.key}"}
        ref = self._do.options(**options).remote(whole)
        self._begun[ref] = _Begun(worker=worker, node=node, work=work, attempt=attempt, since_s=time.monotonic())

    def _sent(self, parcel: Parcel) -> SentParcel:
        """A parcel in Ray's store, put there once."""
        store = self._kept if parcel.kept else self._loose
        if parcel.address not in store:
            store[parcel.address] = SentParcel(
                address=parcel.address,
                digest=digest_of(parcel.folder, parcel.names),
                name=parcel.folder.name,
                inner=parcel.inner,
                kept=parcel.kept,
                ref=(self._ray.put(packed(parcel)),),
            )
            while len(self._loose) > _MOST_LOOSE:
                self._loose.pop(next(iter(self._loose)))
        return store[parcel.address]

    def _stop(self, worker: str) -> None:
        for begun in self._begun.values():
            if begun.worker == worker and begun.node in self._nodes:
                kill = self._kill.options(scheduling_strategy=self._on(begun.node))
                kill.remote(self._spec.run, begun.work.key, begun.attempt)

    def _heard(self, ref: Any) -> None:
        """A node has answered, or will not any more."""
        if ref in self._probes:
            self._judge(self._probes.pop(ref), ref)
            return
        try:
            reply: Reply = self._ray.get(ref, timeout=_GET_S)
        except self._ray.exceptions.GetTimeoutError:
            return  # its machine is slow to give it out, or cut off
        except Exception as error:
            begun = self._begun.pop(ref)
            self._pipe.send(("ended", _without_reply(begun, error, self._ray)))
            self._looked_s = float("-inf")  # its node may be gone
            return
        begun = self._begun.pop(ref)
        self._pipe.send(("ended", _with_reply(begun, reply)))

    def _judge(self, key: str, ref: Any) -> None:
        """Whether a node may work."""
        node = self._nodes.get(key)
        if node is None:
            return
        try:
            facts = facts_of(self._ray.get(ref, timeout=_GET_S))
            why = why_refused(facts, self._here)
        except ConfigError as error:
            why = str(error)
        except Exception as error:
            self._tries[key] = self._tries.get(key, 0) + 1
            if self._tries[key] < _MOST_TRIES:
                del self._nodes[key]  # it is asked again
                return
            why = f"it could not start a process ({type(error).__name__}: {_first_line(error)}); check that node"
        node.state = "refused" if why else "works"
        if why:
            self._pipe.send(("refused node", f"node {node.name} is not used: {why}"))
        else:
            if self._spec.address != LOCAL:
                self._say(f"node {node.name} ({facts.host}) works with {node.cpus} CPUs")
            for note in notes_on(facts, self._here):
                self._say(f"node {node.name}: {note}")
        self._tell_workers()

    def _say(self, text: str) -> None:
        self._pipe.send(("say", text))


def _look_at_node() -> Callable[[], Any]:
    """What is asked of a node that may have no wcsim, or another: a function that travels as it is written here."""

    def look() -> Any:
        try:
            from dataclasses import asdict

            from wcsim.server.workers.cluster.node_facts import facts_here as facts

            return asdict(facts())
        except Exception as error:
            told = f"{type(error).__name__}: {error}"
            return (
                f"wcsim cannot be loaded there ({told}); install the same version as here: pip install 'wcsim[cluster]'"
            )

    look.__module__ = "__main__"  # or Ray would look for it in wcsim there
    return look


def _with_reply(begun: _Begun, reply: Reply) -> WorkEnd:
    total_s = time.monotonic() - begun.since_s
    facts = {
        "pid": reply.pid,
        "bytes": len(reply.data),
        "fetched_bytes": reply.fetched_bytes,
        "fetch_s": round(reply.fetch_s, 3),
        "work_s": round(reply.work_s, 3),
        "total_s": round(total_s, 3),
    }
    worker, key = begun.worker, begun.work.key
    if reply.error is not None:
        return WorkEnd(worker=worker, key=key, error=reply.error, facts=facts)
    if reply.fault:
        told = f"{key} failed on {worker}: {reply.fault[:300]}; see Ray's log on that machine"
        return WorkEnd(worker=worker, key=key, error=WorkersError(told), facts=facts)
    if reply.lost:
        return WorkEnd(worker=worker, key=key, lost=reply.lost, facts=facts)
    return WorkEnd(worker=worker, key=key, data=reply.data, facts=facts)


def _lost_with_its_node(begun: _Begun) -> WorkEnd:
    waited_s = round(time.monotonic() - begun.since_s, 3)
    facts = {"total_s": waited_s}
    return WorkEnd(worker=begun.worker, key=begun.work.key, lost="its node died", counts=False, facts=facts)


def _without_reply(begun: _Begun, error: Exception, ray: Any) -> WorkEnd:
    known = ray.exceptions
    of_machine = (known.NodeDiedError, known.TaskUnschedulableError, known.ObjectLostError, known.OwnerDiedError)
    return WorkEnd(
        worker=begun.worker,
        key=begun.work.key,
        lost=f"{type(error).__name__}: {_first_line(error)}",
        counts=not isinstance(error, of_machine),
        facts={"total_s": round(time.monotonic() - begun.since_s, 3)},
    )


def _first_line(error: Exception) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), "")[:200]
