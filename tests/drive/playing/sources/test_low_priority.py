import os
from multiprocessing import Pipe, get_context
from multiprocessing.connection import Connection

from wcsim.drive.playing.sources.source_process import LAST, run_at_low_priority


def look_on(say: Connection, before: int) -> None:
    run_at_low_priority()
    run_at_low_priority()  # a second time changes nothing
    say.send((os.getsid(0) == os.getpid() != before, os.nice(0) == LAST, os.sched_getscheduler(0) == os.SCHED_IDLE))


def test_who_looks_on_comes_last_in_a_session_of_its_own() -> None:
    """In a process of its own, for it cannot be taken back; a fork, for whoever comes last takes long to end."""
    heard, say = Pipe()
    process = get_context("fork").Process(target=look_on, args=(say, os.getsid(0)))
    process.start()
    process.join()
    assert heard.poll() and heard.recv() == (True, True, True)
