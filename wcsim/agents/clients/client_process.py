"""A client that learns, in a process of its own: `python -m wcsim.agents.clients.client_process ORDER_FILE [options]`.

Its environment is a seat in a running world, its run folder a normal one. It ends with a code of `ClientExit`. It does
not outlive its launcher: it saves its work first, but within five minutes.
"""

from __future__ import annotations

import argparse
import select
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from wcsim.core.processes import die_with_parent, outlive_parent_by
from wcsim.errors import WcsimError
from wcsim.server.launch.states import WAIT_NO_MORE, ClientExit
from wcsim.server.protocol.limits import NO_ROOM, limit_message, write_last_line
from wcsim.server.specs import ClientSpec, read_order

SAVING_S = 300.0  # longest life after that of the launcher


def main(words: Sequence[str]) -> int:
    """Run a client; returns a code of `ClientExit`."""
    parser = argparse.ArgumentParser(
        prog="wcsim.agents.clients.client_process", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("order", type=Path)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--status-fd", type=int, default=-1)
    options = parser.parse_args(words)
    signal.signal(WAIT_NO_MORE, signal.SIG_IGN)  # before and after it learns it waits for no world
    die_with_parent()
    outlive_parent_by(
        SAVING_S, ClientExit.SERVER_GONE, WAIT_NO_MORE
    )  # its world is not started again
    if _has_no_reader(options.status_fd):  # the launcher died before it could be watched
        return ClientExit.SERVER_GONE
    return _learned(options.order, options.resume, options.status_fd)


def _learned(file: Path, resume: bool, status_fd: int) -> int:
    try:
        order = read_order(ClientSpec, file)
        from wcsim.agents.clients.client import (  # torch takes its time, and the launcher is watched by now
            exit_code,
            learn,
        )
    except WcsimError as error:
        write_last_line(f"wcsim: {error}")
        return ClientExit.USER_ERROR
    try:
        learn(order, resume, status_fd, write_last_line)
    except WcsimError as error:
        write_last_line(f"wcsim: {error}")
        return exit_code(error)
    except Exception as error:
        message = limit_message(error)
        if not message:
            raise
        write_last_line(f"wcsim: {message}")
        return (
            ClientExit.DISK_FULL
            if getattr(error, "errno", None) in NO_ROOM
            else ClientExit.USER_ERROR
        )
    except KeyboardInterrupt:
        write_last_line("wcsim: interrupted")
        return ClientExit.STOPPED
    return ClientExit.DONE


def _has_no_reader(pipe: int) -> bool:
    """Whether the other end of a pipe is closed; False where there is none."""
    if pipe < 0:
        return False
    poll = select.poll()
    poll.register(pipe, 0)
    return any(events & select.POLLERR for _, events in poll.poll(0))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
