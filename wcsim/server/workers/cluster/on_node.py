"""What a node of a cluster does: takes what a piece of work needs, does it, says what came of it. Ray calls it."""

from __future__ import annotations

import hashlib
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wcsim.core.files import alone
from wcsim.errors import WcsimError
from wcsim.server.workers.cluster.bundle import is_kept, keep, kept_folder, unpack
from wcsim.server.workers.work_folders import find_in_work, work_folder
from wcsim.server.workers.worker_api import Call
from wcsim.towns.cache.folder import cache_folder

Fetch = Callable[[Any], bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class SentParcel:
    """A parcel on its way; what is in it is fetched only by a node that does not have it."""

    address: str
    digest: str
    name: str  # of its folder
    inner: str
    kept: bool
    ref: tuple[Any, ...]  # the object of Ray's that holds it; in a tuple, so that Ray does not fetch it unasked


@dataclass(frozen=True, slots=True, kw_only=True)
class SentWork:
    """A piece of work on its way."""

    run: str  # whose it is: a word that no other run has
    key: str
    attempt: str  # a word of its own each time that the piece is given out
    call: Call
    piece: Any
    parcels: tuple[SentParcel, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What came of it: `data`, or an `error` that is final, or `lost`: another machine may do better."""

    data: bytes = b""
    error: WcsimError | None = None
    fault: str = ""  # an error that nobody had reckoned with
    lost: str = ""
    pid: int = 0
    fetched_bytes: int = 0
    fetch_s: float = 0.0
    work_s: float = 0.0


def do_work(sent: SentWork, fetch: Fetch | None = None) -> Reply:
    """Do a piece of work in this process, which Ray has started; `fetch` stands in for Ray's store."""
    _say(f"{sent.key} starts")
    with ExitStack() as leaving:
        began_s = time.monotonic()
        try:
            own = leaving.enter_context(work_folder())
            (own / _pid_name(sent.run, sent.key, sent.attempt)).write_text(str(os.getpid()), encoding="utf-8")
            places, fetched = _received(sent.parcels, fetch or _from_ray, own)
            fetch_s = time.monotonic() - began_s
            data = sent.call(sent.piece, lambda address: places.get(address, address))
        except WcsimError as error:
            _say(f"{sent.key} failed: {error}")
            return Reply(error=error, pid=os.getpid())
        except (OSError, MemoryError) as error:
            _say(f"{sent.key} is lost: {error}")
            return Reply(lost=f"{type(error).__name__}: {error}", pid=os.getpid())
        except Exception as error:
            _say(f"{sent.key} failed: {traceback.format_exc()}")
            return Reply(fault=f"{type(error).__name__}: {error}", pid=os.getpid())
        work_s = time.monotonic() - began_s - fetch_s
        _say(f"{sent.key} is done, {len(data)} bytes after {work_s:.1f} s")
        return Reply(data=data, pid=os.getpid(), fetched_bytes=fetched, fetch_s=fetch_s, work_s=work_s)


def kill_worker(run: str, key: str, attempt: str) -> bool:
    """Kill the process of this machine that is at a piece, even one that was stopped. Whether there was one."""
    with suppress(OSError, ValueError):
        found = find_in_work(_pid_name(run, key, attempt))
        pid = 0 if found is None else int(found.read_text(encoding="utf-8"))
        if pid and b"ray::" in Path(f"/proc/{pid}/cmdline").read_bytes():  # its number may be somebody else's by now
            os.kill(pid, signal.SIGKILL)
            return True
    return False


def _received(parcels: tuple[SentParcel, ...], fetch: Fetch, own: Path) -> tuple[dict[str, str], int]:
    """Where each parcel lies here, in a folder of this piece's own unless it is kept; how many bytes came for them."""
    places, fetched = {}, 0
    for number, parcel in enumerate(parcels):
        if parcel.kept:
            folder = kept_folder(cache_folder(), parcel.digest, parcel.name)
            with alone(folder.parents[1] / f"{folder.parent.name}.lock"):  # a town comes once to a machine
                if not is_kept(folder, parcel.digest):
                    data = fetch(parcel.ref[0])
                    fetched += len(data)
                    keep(data, folder)
        else:
            folder = own / f"parcel-{number}" / (parcel.name or "folder")
            folder.mkdir(parents=True)
            data = fetch(parcel.ref[0])
            fetched += len(data)
            unpack(data, folder)
        places[parcel.address] = str(folder / parcel.inner) if parcel.inner else str(folder)
    return places, fetched


def _from_ray(ref: Any) -> bytes:
    import ray

    data: bytes = ray.get(ref)
    return data


def _pid_name(run: str, key: str, attempt: str) -> str:
    return f"{run}-{hashlib.sha256(key.encode()).hexdigest()[:16]}-{attempt}.pid"  # a key may be a long path


def _say(text: str) -> None:
    """Into Ray's log of this worker, where a key finds it."""
    sys.stderr.write(f"wcsim: {text}\n")
    sys.stderr.flush()
