"""Small pieces of work for tests of schedulers."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import psutil
import zstandard

from wcsim.errors import TownError
from wcsim.server.workers.cluster_node import MOST_BYTES, _unpack
from wcsim.server.workers.machines import ToLocalPath


def workers() -> list[psutil.Process]:
    """The processes of pools that work for this one."""
    return [child for child in psutil.Process().children() if _is_worker(child)]


def _is_worker(process: psutil.Process) -> bool:
    try:
        return "spawn_main" in " ".join(process.cmdline())
    except (psutil.NoSuchProcess, psutil.ZombieProcess):  # it has ended meanwhile
        return False


def echo(piece: Any, at: ToLocalPath) -> bytes:
    """The piece as text."""
    return str(piece).encode()


def tell_pid(piece: Any, at: ToLocalPath) -> bytes:
    """Which process does it."""
    return str(os.getpid()).encode()


def read_parcel(piece: str, at: ToLocalPath) -> bytes:
    """All files of a parcel, and where they lie."""
    folder = Path(at(piece))
    return b"\n".join([str(folder).encode(), *(path.read_bytes() for path in sorted(folder.iterdir()))])


def itself(piece: Any) -> tuple[Any, ...]:
    """What a piece needs that is a parcel."""
    return (piece,)


def answer_with_text(piece: Any, at: ToLocalPath) -> Any:
    """Breaks its word: what comes back is no bytes."""
    return "text"


def take_in_a_bomb(piece: Any, at: ToLocalPath) -> bytes:
    """Unpacks a file of few bytes that says it holds more than any parcel may."""
    frame = zstandard.ZstdCompressor().compressobj(size=MOST_BYTES + 1)
    _unpack({"bomb": frame.compress(b"x") + frame.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)}, Path("bomb"))
    return b""


def refuse(piece: Any, at: ToLocalPath) -> bytes:
    """Fails as something that the user has to mend."""
    raise TownError(f"town {piece} is not there; expected another")


def blunder(piece: Any, at: ToLocalPath) -> bytes:
    """Fails as a fault of the program."""
    raise ZeroDivisionError("one by nothing")


def die_once(piece: str, at: ToLocalPath) -> bytes:
    """Dies when it is done for the first time."""
    if not Path(piece).exists():
        Path(piece).write_text("x")
        os.kill(os.getpid(), signal.SIGKILL)
    return b"lived"


def always_die(piece: Any, at: ToLocalPath) -> bytes:
    """Dies."""
    os.kill(os.getpid(), signal.SIGKILL)
    return b""


def hang_once(piece: str, at: ToLocalPath) -> bytes:
    """Stops as if the machine had, when it is done for the first time."""
    if not Path(piece).exists():
        Path(piece).write_text("x")
        os.kill(os.getpid(), signal.SIGSTOP)
        time.sleep(600.0)
    return b"lived"
