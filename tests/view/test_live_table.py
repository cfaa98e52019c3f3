"""What the table of a running world says, and when it names who is slow."""

import errno
import io
import sys

from rich.console import Console

from wcsim.server.launch.states import (
    ClientBarrierDelay,
    ClientProcessState,
    ClientStatusReport,
    LaunchProcessStates,
    WorldStatusReport,
)
from wcsim.view.live_table import LiveTable, _head_of, _line_of, _table_of, _waits_of

NAMES = ("fig6", "conv3d", "convlstm")


def world(**changed):
    usual = {"stage": "collect", "epoch": 1, "tick": 70, "ticks": 40, "ticks_per_s": 9.5, "members": NAMES}
    return WorldStatusReport(**{**usual, "master": "conv3d", "rss_mb": 310.2, "step_ms": 20.0, **changed})


def client(name, seat, **changed):
    status = ClientStatusReport(name=name, step=40 + seat, total_steps=100, phase=2, episodes=3, crashes=1, kpi1=0.25)
    return ClientProcessState(
        **{"name": name, "seat": seat, "standing": "running", "pid": 7, "status": status, **changed}
    )


def state(elapsed_s=12.0, standing="running", seen=None, clients=None, **changed):
    return LaunchProcessStates(
        elapsed_s=elapsed_s,
        world_standing=standing,
        world_pid=1,
        world_restarts=changed.pop("restarts", 0),
        world=world() if seen is None else seen,
        clients=tuple(client(name, seat) for seat, name in enumerate(NAMES)) if clients is None else clients,
        **changed,
    )


def console(out):
    """A terminal that is wide enough."""
    return Console(markup=False, file=out, width=120, force_terminal=True, color_system=None)


def shown(what):
    out = io.StringIO()
    console(out).print(what)
    return [line.strip() for line in out.getvalue().splitlines()]


def row(lines, name):
    return next(line for line in lines if line.startswith(name)).split()


def test_a_row_a_client_and_a_line_for_the_world():
    late = world(late=("convlstm",), late_s=3.21)
    clients = (
        client("fig6", 0, restarts=2),
        client("conv3d", 1),
        client("convlstm", 2),
        client("new", 3, standing="starting", status=None),
        client("dead", 4, standing="down", reason="killed by SIGKILL"),
    )
    lines = shown(_table_of(state(seen=late, clients=clients)))
    for text in ("world 1, tick 70", "9.5 ticks/s", "collect", "waiting for convlstm (3.2 s)", "310 MB"):
        assert text in lines[0]
    assert row(lines, "fig6") == ["fig6", "0", "40/100", "2", "3", "1", "0.250", "-", "waiting", "2"]
    assert row(lines, "conv3d")[:2] == ["conv3d", "*"]
    assert row(lines, "convlstm")[-2] == "computing"
    assert row(lines, "new") == ["new", "3", "-", "-", "-", "-", "-", "-", "starting", "0"]
    assert "down: killed by SIGKILL" in next(line for line in lines if line.startswith("dead"))


def test_a_client_that_has_no_seat_yet_joins():
    lines = shown(_table_of(state(seen=world(members=("fig6", "conv3d")))))
    assert row(lines, "convlstm")[-2] == "joining"


def test_the_world_that_is_not_there():
    assert _head_of(state(standing="starting", seen=WorldStatusReport(stage="loading"))) == "the world is loading"
    assert _head_of(state(standing="down", restarts=2)) == "the world is down (started again 2 times)"
    assert "ending" in _head_of(state(stopping=True))


def test_who_is_waited_for_now():
    assert _waits_of(world()) == ""
    assert _waits_of(world(late=("convlstm",), late_s=0.1)) == ""
    assert _waits_of(world(late=("convlstm", "fig6"), late_s=2.0)) == "waiting for convlstm, fig6 (2.0 s)"
    assert _waits_of(world(late=NAMES, late_s=2.0)) == ""  # nobody has acted, so nobody waits


def test_who_is_slow_in_the_mean():
    def held(*seconds):
        return tuple(ClientBarrierDelay(name=name, seconds=s) for name, s in zip(NAMES, seconds, strict=True))

    assert _waits_of(world(held=held(1.0, 2.0, 7.0))) == "slowest client convlstm (70% of 10.0 s waiting)"
    assert _waits_of(world(held=held(3.0, 3.0, 4.0))) == ""
    assert _waits_of(world(held=held(0.0, 0.1, 0.2))) == ""
    assert _waits_of(world(late=("fig6",), late_s=2.0, held=held(0.0, 0.0, 9.0))).startswith("waiting for fig6")
    assert _waits_of(world(held=(ClientBarrierDelay(name="sole", seconds=9.0),))) == ""


def test_a_line_every_ten_seconds_where_there_is_no_terminal():
    out = io.StringIO()
    with LiveTable(Console(markup=False, file=out, width=80)) as table:
        for elapsed_s in range(26):
            table.show(state(elapsed_s=float(elapsed_s)))
    lines = out.getvalue().splitlines()
    assert [line.split()[0] for line in lines] == ["10", "20"]
    assert lines[0] == _line_of(state(elapsed_s=10.0))
    assert "fig6 40/100, KPI 1 0.250; conv3d 41/100" in lines[0]


def test_a_terminal_shows_the_newest_state():
    out = io.StringIO()
    with LiveTable(console(out)) as table:
        table.show(state(seen=world(tick=70)))
        table.show(state(seen=world(tick=71)))
    assert "tick 70" in out.getvalue()
    assert "tick 71" in out.getvalue()


class Terminal(io.StringIO):
    """A terminal that somebody closes."""

    gone = False

    def write(self, text):
        if self.gone:
            raise OSError(errno.EIO, "Input/output error")
        return super().write(text)


def test_a_terminal_that_is_gone_ends_nothing_also_at_the_end():
    out, usual = Terminal(), sys.stdout
    with LiveTable(console(out)) as table:
        table.show(state(seen=world(tick=70)))
        out.gone = True
        table.show(state(seen=world(tick=71)))
    assert "tick 70" in out.getvalue() and "tick 71" not in out.getvalue()
    assert sys.stdout is usual
