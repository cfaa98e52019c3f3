"""A running world and its clients on one screen: their progress, and who delays it."""

from contextlib import suppress
from typing import Self

from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from wcsim.core.closing import ClosingContextBase
from wcsim.core.reading import pluralize
from wcsim.server.launch.states import (
    ClientProcessState,
    ClientStatusReport,
    LaunchProcessStates,
    WorldStatusReport,
)

PAYS = "acts/learns/waits %"
_LINE_S = 10.0  # between two lines where there is no terminal
_WAITS_S = 0.5  # who is waited for is shown when it takes so long ...
_SLOW_SHARE = 0.5  # ... or when one client causes so much of all waiting ...
_ENOUGH_S = 1.0  # ... once that is worth a word


class LiveTable(ClosingContextBase):
    """Shows `LaunchProcessStates`: a table on a terminal, elsewhere a line every ten seconds."""

    def __init__(self, console: Console | None = None) -> None:
        """Show on a console, by default that of stderr."""
        self.console = (
            Console(stderr=True, highlight=False, emoji=False, markup=False)
            if console is None
            else console
        )
        self._live = Live(console=self.console, auto_refresh=False, transient=True)
        self._lined_s = 0.0
        self._nobody_reads = False

    def show(self, state: LaunchProcessStates) -> None:
        """Print the status; a terminal that is gone must not end the program."""
        try:
            if not self._nobody_reads:
                self._say(state)
        except (OSError, SystemExit):  # rich ends a program whose output is not read
            self._nobody_reads = True

    def _say(self, state: LaunchProcessStates) -> None:
        if self.console.is_terminal:
            self._live.update(_table_of(state), refresh=True)
        elif state.elapsed_s - self._lined_s >= _LINE_S:
            self._lined_s = state.elapsed_s
            self.console.print(_line_of(state), soft_wrap=True)

    def __enter__(self) -> Self:
        if self.console.is_terminal:
            self._live.start()
        return self

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self.console.is_terminal:
            with suppress(OSError, SystemExit):  # as in `show`
                self._live.stop()


def _table_of(state: LaunchProcessStates) -> RenderableType:
    """A head line and a row for each client."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for title in (
        "client",
        "chair",
        "step",
        "phase",
        "episodes",
        "crashes",
        "KPI 1",
        PAYS,
        "state",
        "restarts",
    ):
        table.add_column(
            title, justify="left" if title in ("client", "state") else "right", no_wrap=True
        )
    for client in state.clients:
        table.add_row(*_row(client, state.world))
    return Group(Text(_head_of(state), no_wrap=True, overflow="ellipsis"), table)


def _line_of(state: LaunchProcessStates) -> str:
    """Everything in one line, for log files."""
    clients = "; ".join(_brief(client) for client in state.clients)
    return f"{state.elapsed_s:.0f} s: {_head_of(state)}{' | ' if clients else ''}{clients}"


def _head_of(state: LaunchProcessStates) -> str:
    """The world, and for whom it waits."""
    world = state.world
    if world is None or state.world_standing != "running":
        again = (
            f" (started again {pluralize(state.world_restarts, 'time')})"
            if state.world_restarts
            else ""
        )
        is_so = "loading" if state.world_standing == "starting" else state.world_standing
        return f"the world is {is_so}{again}"
    parts = [
        f"world {world.epoch}, tick {world.tick}",
        f"{world.ticks_per_s:.1f} ticks/s",
        f"{world.step_ms:.1f} ms a tick",
        "ending" if state.stopping else world.stage,
        _waits_of(world),
        f"{world.rss_mb:.0f} MB",
    ]
    return ", ".join(part for part in parts if part)


def _waits_of(world: WorldStatusReport) -> str:
    """Whom all wait for: now if that is long, else in the mean if one stands out, else ""."""
    if world.late and world.late_s >= _WAITS_S and len(world.late) < max(2, len(world.members)):
        return f"waiting for {', '.join(world.late)} ({world.late_s:.1f} s)"
    slowest = max(world.held, key=lambda held: held.seconds, default=None)
    all_s = sum(held.seconds for held in world.held)
    if (
        slowest is None
        or len(world.held) < 2
        or all_s < _ENOUGH_S
        or slowest.seconds < _SLOW_SHARE * all_s
    ):
        return ""
    return f"slowest client {slowest.name} ({slowest.seconds / all_s:.0%} of {all_s:.1f} s waiting)"


def _row(client: ClientProcessState, world: WorldStatusReport | None) -> tuple[str, ...]:
    status = client.status
    master = world is not None and bool(world.master) and world.master == client.name
    cells = ("-",) * 6
    if status is not None:
        kpi1 = "-" if status.kpi1 is None else f"{status.kpi1:.3f}"
        progress = f"{status.step}/{status.total_steps}"
        cells = (
            progress,
            str(status.phase),
            str(status.episodes),
            str(status.crashes),
            kpi1,
            _pays_of(status),
        )
    return (
        f"{client.name}{' *' if master else ''}",
        str(client.seat),
        *cells,
        _standing(client, world),
        str(client.restarts),
    )


def _pays_of(status: ClientStatusReport) -> str:
    """What share of its time a client spends on acting, learning and waiting, in percent.

    >>> times = {"inference_s": 1.0, "learning_s": 6.0, "simulation_s": 2.0, "barrier_s": 2.0}
    >>> client = ClientStatusReport(name="a", overlap_s=1.0, **times)
    >>> _pays_of(client)
    '10/60/30'
    """
    waits_s = max(0.0, status.simulation_s + status.barrier_s - status.overlap_s)
    parts_s = (status.inference_s, status.learning_s, waits_s)
    all_s = sum(parts_s)
    return "/".join(f"{100.0 * part_s / all_s:.0f}" for part_s in parts_s) if all_s > 0.0 else "-"


def _standing(client: ClientProcessState, world: WorldStatusReport | None) -> str:
    if client.standing == "running" and world is not None:
        if client.name not in world.members:
            return "joining"
        return "computing" if client.name in world.late else "waiting"
    return f"down: {client.reason}" if client.standing == "down" else client.standing


def _brief(client: ClientProcessState) -> str:
    status = client.status
    far = "" if status is None else f" {status.step}/{status.total_steps}"
    kpi1 = "" if status is None or status.kpi1 is None else f", KPI 1 {status.kpi1:.3f}"
    again = f", {pluralize(client.restarts, 'restart')}" if client.restarts else ""
    standing = "" if client.standing == "running" else f" ({client.standing})"
    return f"{client.name}{far}{kpi1}{again}{standing}"
