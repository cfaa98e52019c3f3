"""Users at work in real worlds: the routes behind `python -m benchmarks users`.

One world holds a chair for each profile; everybody gets what the own user asks for, on the grid of actions, as the
baseline `follow` does. A route ends with an arrival, a crash, the user giving up, or the time that it may take.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.users.hand_habits import HandLog
from benchmarks.users.table import RouteLog, meet
from wcsim.bridge.ego.ego import Ego
from wcsim.bridge.world import World
from wcsim.config import RunConfig
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.towns.scenario.town import Town
from wcsim.types import ClientSnapshot, Command, Joystick, SeatSpec, Snapshot
from wcsim.users.profiles import UserProfile, find_builtin_profile
from wcsim.users.user import SimulatedUser

Outcome = Literal["arrived", "crashed", "gave up", "time"]
ENDLESS = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivenRoute:
    """One route that was driven."""

    town: str
    outcome: Outcome
    reason: str  # of a crash
    log: RouteLog
    driven_m: float
    free_steps: int  # steps without danger, 0 unless the truth was asked for
    end_W_m: tuple[float, float]


class _Watch:
    """Keeps what one seat does on its present route."""

    def __init__(self, seat: Ego) -> None:
        self.seat = seat
        self.routes: list[DrivenRoute] = []
        self.begin()

    def begin(self) -> None:
        """A new route."""
        self._user = self.seat.user
        self._intents = [self._user.intent]
        self._sticks: list[np.ndarray[tuple[int, int], np.dtype[np.float64]]] = []
        self._speeds: list[float] = []
        self._met: dict[str, bool] = {}
        self._free = 0

    @property
    def ticks(self) -> int:
        """Ticks of this route so far."""
        return len(self._speeds)

    def take(self, client: ClientSnapshot) -> None:
        """Keep one tick; the user may be the next one's already, when this one ended in a crash."""
        user = self._user
        self._sticks.append(user.sticks)
        self._speeds.append(float(client.plant.v_B_mps[0]))
        self._free += client.truth is not None and not client.truth.danger
        self._intents.append(user.intent)
        if isinstance(user, SimulatedUser) and user.witness is not None:
            meet(*user.witness, user.profile, self._met)

    def end(self, town: str, world: World, client: ClientSnapshot, outcome: Outcome) -> None:
        """File the route."""
        tick_s, substeps = world.config.world.tick_s, world.config.world.finest_substeps
        hand = HandLog(
            dt_s=tick_s / substeps,
            intents=np.array([(wish.x, wish.y) for wish in self._intents[:-1]]),
            sticks=np.array(self._sticks),
        )
        log = RouteLog(
            profile=self._profile(),
            tick_s=tick_s,
            hand=hand,
            speed_mps=np.array(self._speeds),
            v_max_mps=world.config.chair.v_max_mps,
            met=len(self._met),
            noticed=sum(self._met.values()),
        )
        x, y, _ = client.plant.p_WB_m.tolist()
        self.routes.append(
            DrivenRoute(
                town=town,
                outcome=outcome,
                reason=client.events.crash_reason,
                log=log,
                driven_m=tick_s * float(np.abs(log.speed_mps).sum()),
                free_steps=self._free,
                end_W_m=(x, y),
            )
        )

    def _profile(self) -> UserProfile:
        if not isinstance(self._user, SimulatedUser):
            raise TypeError("a recorded joystick has no profile")  # no bench asks for one
        return self._user.profile


def drive_routes(
    town: Town,
    config: RunConfig,
    names: Sequence[str],
    routes: int,
    longest_s: float,
    seed: int,
    truth: bool = False,
    progress: Callable[[str], object] = lambda text: None,
) -> dict[str, list[DrivenRoute]]:
    """Let a user of each profile in `names` drive `routes` routes in a town, all in one world.

    Args:
        town: Where.
        config: Its demand is that of the traffic.
        names: Profiles, one for each chair; a name may come several times.
        routes: For each chair.
        longest_s: A route is cut after this time.
        seed: Of the world.
        truth: Whether steps without danger are counted, which costs time.
        progress: Hears of each route that is done.

    Raises:
        ConfigError: A name is that of no profile.
    """
    for name in names:
        find_builtin_profile(name)
    points = action_set(config.env.actions)
    specs = tuple(SeatSpec(profile=name, max_steps=ENDLESS, truth=truth) for name in names)
    with World(town, config, specs, seed) as world:
        watches = [_Watch(seat) for seat in world.seats]
        while any(len(watch.routes) < routes for watch in watches):
            snapshot = world.tick(_followed(world.snapshot, points))
            for watch, client in zip(watches, snapshot.clients, strict=True):
                if len(watch.routes) >= routes:
                    continue
                watch.take(client)
                outcome = _outcome(client, watch.ticks * config.world.tick_s >= longest_s)
                if outcome is None:
                    continue
                watch.end(town.name, world, client, outcome)
                progress(f"{town.name}: {names[client.seat]} {_told(watch.routes[-1])}")
                if outcome != "crashed":  # after a crash the next episode has begun already
                    world.respawn(client.seat)
                watch.begin()
    found: dict[str, list[DrivenRoute]] = {name: [] for name in names}
    for name, watch in zip(names, watches, strict=True):
        found[name] += watch.routes
    return found


def _told(route: DrivenRoute) -> str:
    x, y = route.end_W_m
    return f"{route.outcome} after {len(route.log.speed_mps) * route.log.tick_s:.0f} s at ({x:.1f}, {y:.1f})"


def _outcome(client: ClientSnapshot, over: bool) -> Outcome | None:
    events = client.events
    if events.crashed:
        return "crashed"
    if events.arrived:
        return "arrived"
    if events.gave_up:
        return "gave up"
    return "time" if over else None


def _followed(snapshot: Snapshot, points: ActionSet) -> tuple[Command, ...]:
    """For every seat the action nearest to its user's stick."""
    commands = []
    for client in snapshot.clients:
        stick = (client.first or client).user
        x, y = points.points[points.nearest((stick.x, stick.y))].tolist()
        commands.append(Command(seat=client.seat, tick=snapshot.tick, joystick=Joystick(x, y)))
    return tuple(commands)
