"""The process that speaks to Ray: gives work to nodes, notices those that come and go, passes on what they answer.

It is a process of its own because Ray ends the process that it is in when it loses its cluster, takes over its signals,
and talks to its terminal. The run hears of the cluster by a pipe. Whatever Ray says against joining becomes one line.
What must be the same on all machines of a run is asked of each node, so that work is the same wherever it is done.
"""

from __future__ import annotations

import os
import platform
import re
import secrets
import shutil
import signal
import socket
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from wcsim.core.files import home
from wcsim.core.sources import code_digest
from wcsim.errors import ConfigError, WcsimError
from wcsim.server.workers.cluster_node import SentParcel, digest_of, do_work, packed
from wcsim.server.workers.machines import Facts, Parcel, Work, WorkEnd

LOCAL: Final = "local"
STORE_BYTES: Final = 160 << 20  # of objects on their way; what travels is small
_PATIENCE: Final = {"RAY_gcs_rpc_server_connect_timeout_s": "60", "RAY_raylet_start_wait_time_s": "80"}
"""For busy machines, where Ray's own 5 s for a process to start are too short."""
_LOOPBACK: Final = re.compile(r"127\.\d+\.\d+\.\d+|localhost|\[?::1\]?")
_VERSIONS: Final = re.compile(r"Ray: (\S+)\s+Python: (\S+)")


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkSpec:
    """What the process that speaks to Ray is told."""

    address: str  # HOST:PORT, or `local`
    count: int  # processes of a local cluster
    log: Path  # for what Ray says


def _join(spec: LinkSpec) -> Any:
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
                _temp_dir=str(Path(tempfile.gettempdir()) / f"wcsim-ray-{os.getuid()}"),
            )
        else:
            ray.init(address=spec.address, log_to_driver=False, configure_logging=False)
    except Exception as error:
        raise ConfigError(_told(spec, error, ray, _logged(spec.log, before))) from None
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # Ray's own handler waits
    return ray


def _prepare(spec: LinkSpec) -> None:
    """What Ray reads of its environment when it is loaded; this process and those that it starts are its only users."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    for name, seconds in _PATIENCE.items():
        os.environ.setdefault(name, seconds)
    if spec.address == LOCAL or _is_loopback(spec.address):
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # Ray's word for: on 127.0.0.1, not on all addresses
    if spec.address == LOCAL:
        os.environ["RAY_AUTH_MODE"] = "token"
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)  # known to nobody else, and on no disk
    elif _has_token():
        os.environ.setdefault("RAY_AUTH_MODE", "token")  # without a word Ray shows a token to no cluster that it joins


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


def _told(spec: LinkSpec, error: Exception, ray: Any, logged: str = "") -> str:
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


_PACKAGES: Final = (
    *("wcsim", "libsumo", "eclipse-sumo", "pybullet", "torch", "numpy", "numba", "opencv-python-headless"),
    *("shapely", "networkx", "zstandard", "gymnasium"),
)
_EXTRAS: Final = ("onnxruntime",)  # asked for where this machine has them
LEAST_SHM_BYTES: Final = 256 << 20
_SHM: Final = Path("/dev/shm")  # noqa: S108 - it is only looked at


@dataclass(frozen=True, slots=True, kw_only=True)
class _NodeFacts:
    """A machine, as a process of it sees it."""

    host: str
    python: str
    versions: tuple[tuple[str, str], ...]  # of packages, sorted
    code: str  # SHA-256 of wcsim's own
    cpu: str
    shm_bytes: int


def _facts_here() -> _NodeFacts:
    """Those of this machine."""
    return _NodeFacts(
        host=socket.gethostname(),
        python=platform.python_version(),
        versions=tuple(sorted((name, _version(name)) for name in (*_PACKAGES, *_EXTRAS))),
        code=code_digest(),
        cpu=_cpu(),
        shm_bytes=shutil.disk_usage(_SHM).total if os.path.isdir(_SHM) else 0,  # noqa: PTH112
    )


def _facts_of(found: Any) -> _NodeFacts:
    """What a node has said of itself, in a shape that no version need share. Raises ConfigError for anything else."""
    if isinstance(found, str):
        raise ConfigError(found)
    try:
        return _NodeFacts(**found)
    except TypeError:
        raise ConfigError("it has another version of wcsim; install the same one as here") from None


def _why_refused(node: _NodeFacts, here: _NodeFacts) -> str:
    """What a node has other than this machine and must not, "" for nothing."""
    there, ours = dict(node.versions), dict(here.versions)
    if there.get("wcsim") != ours["wcsim"] or node.code != here.code:
        return (
            f"it has wcsim {there.get('wcsim')}, code {node.code[:12]}; expected wcsim {ours['wcsim']}, code "
            f"{here.code[:12]}, as here: install the same there, then `ray stop` and `ray start` it again"
        )
    asked = [name for name in ours if ours[name] or name not in _EXTRAS]
    differ = [name for name in asked if there.get(name, "") != ours[name]]
    other = [f"{name} {there.get(name) or 'none'} (here {ours[name] or 'none'})" for name in differ]
    if node.python.split(".")[:2] != here.python.split(".")[:2]:
        other.append(f"Python {node.python} (here {here.python})")
    if other:
        return f"it has {', '.join(other)}; expected the same as here: install from the same constraints.txt"
    return ""


def _notes_on(node: _NodeFacts, here: _NodeFacts) -> tuple[str, ...]:
    """What is worth a line, and no reason to refuse a node."""
    notes = []
    if node.shm_bytes < LEAST_SHM_BYTES:
        notes.append(
            f"{_SHM} has {node.shm_bytes >> 20} MiB; expected {LEAST_SHM_BYTES >> 20}: Ray then stores its objects on "
            "disk, which is slower; start the container with --shm-size=1g"
        )
    if node.cpu != here.cpu:
        notes.append(f"its processor is different ({node.cpu}; here {here.cpu}): the last bits of its data may differ")
    return tuple(notes)


def _version(package: str) -> str:
    try:
        return metadata.version(package).partition("+")[0]  # torch 2.13.0+cpu is 2.13.0
    except metadata.PackageNotFoundError:
        return ""


def _cpu() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


_LOOK_S: Final = 2.0  # at which nodes there are
_WAIT_S: Final = 0.05
_GET_S: Final = 30.0
_MOST_TRIES: Final = 3
_MOST_SENT: Final = 64  # parcels that stay in Ray's store


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
    key: str
    since_s: float


def run_link(pipe: Connection, spec: LinkSpec) -> None:
    """Join, and serve the pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the run, which closes the pipe
    log = os.open(spec.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    os.dup2(log, sys.stdout.fileno())
    os.dup2(log, sys.stderr.fileno())
    try:
        ray = _join(spec)
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
        self._here = _facts_here()
        self._nodes: dict[str, _Node] = {}
        self._probes: dict[Any, str] = {}
        self._begun: dict[Any, _Begun] = {}
        # A town is wanted again with every piece, a network with all pieces of its round.
        self._sent = lru_cache(_MOST_SENT)(self._put)
        self._tries: dict[str, int] = {}  # to ask a node
        self._looked_s = float("-inf")
        self._do = ray.remote(num_cpus=1, max_retries=0)(do_work)
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
            self._ended(begun, lost="its node died", counts=False)

    def _tell_workers(self) -> None:
        works = [(key, node) for key, node in self._nodes.items() if node.state == "works"]
        names = [f"{node.name}/{slot + 1}" for _, node in works for slot in range(node.cpus)]
        self._pipe.send(("workers", (tuple(names), sum(node.state == "asked" for node in self._nodes.values()))))

    def _on(self, node: str) -> Any:
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        return NodeAffinitySchedulingStrategy(node_id=node, soft=False)

    def _begin(self, worker: str, work: Work, parcels: tuple[Parcel, ...]) -> None:
        name = worker.rpartition("/")[0]
        node = next((key for key, each in self._nodes.items() if each.name == name and each.state == "works"), "")
        begun = _Begun(worker=worker, node=node, key=work.key, since_s=time.monotonic())
        if not node:  # it went while the piece was on its way here
            self._ended(begun, lost="its node died", counts=False)
            return
        try:
            sent = tuple(self._sent(parcel) for parcel in parcels)
        except (OSError, WcsimError) as error:  # of files here: no node could do better
            self._ended(begun, error=error)
            return
        options = {"scheduling_strategy": self._on(node), "name": f"wcsim {work.key}"}
        self._begun[self._do.options(**options).remote(worker, work, sent)] = begun

    def _put(self, parcel: Parcel) -> SentParcel:
        """A parcel in Ray's store."""
        digest = digest_of(parcel.folder, parcel.names)
        return SentParcel(parcel=parcel, digest=digest, ref=(self._ray.put(packed(parcel)),))

    def _stop(self, worker: str) -> None:
        for ref, begun in self._begun.items():
            if begun.worker == worker and begun.node in self._nodes:
                self._ray.cancel(ref, force=True)  # Ray kills the process, even one that was stopped

    def _heard(self, ref: Any) -> None:
        """A node has answered, or will not any more."""
        if ref in self._probes:
            self._judge(self._probes.pop(ref), ref)
            return
        try:
            end: WorkEnd = self._ray.get(ref, timeout=_GET_S)
        except self._ray.exceptions.GetTimeoutError:
            return  # its machine is slow to give it out, or cut off
        except Exception as error:
            known = self._ray.exceptions
            of_machine = (
                known.NodeDiedError,
                known.TaskUnschedulableError,
                known.ObjectLostError,
                known.OwnerDiedError,
            )
            told = f"{type(error).__name__}: {_first_line(error)}"
            self._ended(self._begun.pop(ref), lost=told, counts=not isinstance(error, of_machine))
            self._looked_s = float("-inf")  # its node may be gone
            return
        self._ended(self._begun.pop(ref), data=end.data, error=end.error, lost=end.lost, facts=end.facts)

    def _ended(self, begun: _Begun, facts: Facts | None = None, **what: Any) -> None:
        """Tell the run what has come of a piece."""
        whole = {**(facts or {}), "total_s": round(time.monotonic() - begun.since_s, 3)}
        self._pipe.send(("ended", WorkEnd(worker=begun.worker, key=begun.key, facts=whole, **what)))

    def _judge(self, key: str, ref: Any) -> None:
        """Whether a node may work."""
        node = self._nodes.get(key)
        if node is None:
            return
        try:
            facts = _facts_of(self._ray.get(ref, timeout=_GET_S))
            why = _why_refused(facts, self._here)
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
            for note in _notes_on(facts, self._here):
                self._say(f"node {node.name}: {note}")
        self._tell_workers()

    def _say(self, text: str) -> None:
        self._pipe.send(("say", text))


def _look_at_node() -> Callable[[], Any]:
    """What is asked of a node that may have no wcsim, or another: a function that travels as it is written here."""

    def look() -> Any:
        try:
            from dataclasses import asdict

            from wcsim.server.workers.cluster_link import _facts_here as facts

            return asdict(facts())
        except Exception as error:
            told = f"{type(error).__name__}: {error}"
            return (
                f"wcsim cannot be loaded there ({told}); install the same version as here: pip install 'wcsim[cluster]'"
            )

    look.__module__ = "__main__"  # or Ray would look for it in wcsim there
    return look


def _first_line(error: Exception) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), "")[:200]
