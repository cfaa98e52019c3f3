"""A client that learns, in a process of its own: `python -m wcsim.agents.clients.client_process`.

Its environment is a seat in a running world, its run folder a normal one. It ends with a code of
`ClientExitCode`. It does not outlive its launcher: it saves its work first, but within five
minutes.
"""

import argparse
import select
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from wcsim.core.processes import die_with_parent, limit_orphan_lifetime
from wcsim.errors import WcsimError
from wcsim.server.launch.states import WAIT_NO_MORE, ClientExitCode
from wcsim.server.protocol.limits import NO_ROOM, explain_resource_limit_error, write_stderr_line
from wcsim.server.specs import ClientProcessSpec, read_spec_file

SAVING_S: Final = 300.0  # longest life after that of the launcher


def main(words: Sequence[str]) -> int:
    """Run a client; returns a code of `ClientExitCode`."""
    parser = argparse.ArgumentParser(
        prog="wcsim.agents.clients.client_process", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("order", type=Path)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--status-fd", type=int, default=-1)
    options = parser.parse_args(words)
    # 1. The launcher is watched. Before and after it learns, a client waits for no world.
    signal.signal(WAIT_NO_MORE, signal.SIG_IGN)
    die_with_parent()
    # The world of a launcher that died is not started again.
    limit_orphan_lifetime(SAVING_S, ClientExitCode.SERVER_GONE, WAIT_NO_MORE)
    # It may have died before it could be watched.
    if _has_no_reader(options.status_fd):
        return ClientExitCode.SERVER_GONE
    # 2. The order, and only now torch, which takes its time.
    try:
        order = read_spec_file(ClientProcessSpec, options.order)
        from wcsim.agents.clients.client import client_exit_from_error, train_client
    except WcsimError as error:
        write_stderr_line(f"wcsim: {error}")
        return ClientExitCode.USER_ERROR
    # 3. The run, and what became of it.
    try:
        train_client(order, options.resume, options.status_fd, write_stderr_line)
    except WcsimError as error:
        write_stderr_line(f"wcsim: {error}")
        return client_exit_from_error(error)
    except Exception as error:
        message = explain_resource_limit_error(error)
        if not message:
            raise
        write_stderr_line(f"wcsim: {message}")
        is_full = getattr(error, "errno", None) in NO_ROOM
        return ClientExitCode.DISK_FULL if is_full else ClientExitCode.USER_ERROR
    except KeyboardInterrupt:
        write_stderr_line("wcsim: interrupted")
        return ClientExitCode.STOPPED
    return ClientExitCode.DONE


def _has_no_reader(pipe: int) -> bool:
    """Whether the other end of a pipe is closed; False where there is none."""
    if pipe < 0:
        return False
    poll = select.poll()
    poll.register(pipe, 0)
    return any(events & select.POLLERR for _, events in poll.poll(0))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
