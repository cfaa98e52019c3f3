"""Users at crossings with a light: who of them drives onto the road while it is red.

One chair comes to each crossing from the pavement, from both sides, and gets what its own user asks for, as with the
baseline `follow`. An approach ends when the footplate is over the kerb line by 0.3 m; the colour then counts. Whose
light turned red within a second before that, with the footplate beyond the line already, is counted apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from wcsim.bridge.ego.ego import Ego
from wcsim.bridge.ego.start_place import is_clear
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.errors import TownError
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.towns.scenario.town import Town
from wcsim.towns.walking.routes import Router
from wcsim.types import Events, Ground, Outline, SeatSpec, SignalState, StartSpec, Street, WayKind
from wcsim.users.crossing import CARRIAGEWAY, Crossing, crossings, is_red
from wcsim.users.route_line import Path
from wcsim.users.user import SimulatedUser

Colour = Literal["green", "turned", "red", "none"]
_CHAIRS = 6  # at work at the same time
ENDLESS = 1_000_000_000
RUN_UP_M, _LEAST_RUN_UP_M = 12.0, 6.0  # of pavement before the kerb
BEYOND_M = 6.0
NEAR_M = 30.0  # a pavement to start from or to go to begins so near to the crossing
ROOM_M = 4.0  # between a start and anybody else
APART_M = 30.0  # between the starts of two chairs, which else would wait at one kerb, one behind the other
OVER_M = 0.3  # less than this of the footplate over the kerb line is no entry
_ANSWER_S = 1.0  # who has passed the line at green and goes on at a red older than this could have stopped
ASIDE_M = 3.0  # who leaves the pavement farther from the crossing than this does not use it
LONGEST_S = 240.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossingPlace:
    """A crossing with a light and the way over it."""

    start: StartSpec
    crossing: Crossing


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossingApproach:
    """How one user came onto a crossing: the light at that moment, "none" when it never did.

    "turned" is a light that turned red between the footplate's passing of the kerb line and its being 0.3 m beyond.
    """

    town: str
    colour: Colour
    seconds: float
    at_W_m: tuple[float, float]


def _signalled(street: Street, outline: Outline) -> tuple[CrossingPlace, ...]:
    """The crossings of a town that have a light, from each side with enough pavement for a chair before it."""
    router = Router(street.walk)
    ends = [(tuple(e.points_W_m[0]), tuple(e.points_W_m[-1])) for e in street.walk.edges if e.kind is WayKind.SIDEWALK]
    middles = [tuple(e.points_W_m[len(e.points_W_m) // 2]) for e in street.walk.edges if e.kind is WayKind.SIDEWALK]

    def pavements(near: tuple[float, float]) -> list[tuple[float, float]]:
        found = [(min(math.dist(near, end) for end in two), at) for two, at in zip(ends, middles, strict=True)]
        return [at for far_m, at in sorted(found) if far_m < NEAR_M][:6]

    places = []
    for edge in street.walk.edges:
        if edge.kind is not WayKind.CROSSING or not edge.tls_id:
            continue
        a, b = tuple(edge.points_W_m[0]), tuple(edge.points_W_m[-1])
        for here, there in ((a, b), (b, a)):
            tries = (_place(street, router, s, g, here, outline) for s in pavements(here) for g in pavements(there))
            place = next((found for found in tries if found is not None), None)
            if place is not None:
                places.append(place)
    return tuple(places)


def _place(
    street: Street,
    router: Router,
    start_xy: tuple[float, float],
    goal_xy: tuple[float, float],
    kerb_xy: tuple[float, float],
    outline: Outline,
) -> CrossingPlace | None:
    """The way between two places when it leads first over the crossing that begins at a kerb."""
    route = router.route(start_xy, goal_xy)
    items = crossings(route, street.walk)
    if not items or not items[0].tls_id or math.dist(items[0].start_W_m, kerb_xy) > 1.0:
        return None
    first = items[0]
    path = Path(route)
    if first.start_m < _LEAST_RUN_UP_M or path.length_m < first.end_m + BEYOND_M:
        return None
    from_m = max(0.0, first.start_m - RUN_UP_M)
    xy, yaw_rad = path.at(from_m), path.heading(from_m)
    if not is_clear(street.grid, outline, np.array(xy), yaw_rad, 0.0, lambda _, __: ()):
        return None
    start = StartSpec(p_W_m=xy, yaw_rad=yaw_rad, goal_W_m=path.at(path.length_m))
    return CrossingPlace(start=start, crossing=first)


class _Watch:
    """One chair on its way to a crossing."""

    def __init__(self, seat: Ego, place: CrossingPlace, law_share: float) -> None:
        self.seat, self.place, self.ticks = seat, place, 0
        self._behind, self._passed_red, self._red_ticks = True, False, 0
        if not isinstance(seat.user, SimulatedUser):
            raise TypeError("a recorded joystick does not follow traffic rules")  # no bench asks for one
        seat.user.profile = replace(seat.user.profile, law_share=law_share)
        seat.user.follow(seat.route)

    def entered(self, ground: Ground, signals: Sequence[SignalState], tick_s: float) -> Colour:
        """At what light the footplate came onto the crossing, "none" when it is not there.

        It is there beyond the crossing's beginning and over the kerb, which may run aslant. Needs every tick.
        """
        over_kerb, over_m = self._footplate(ground)
        red = is_red(self.place.crossing, signals)
        self._red_ticks = self._red_ticks + 1 if red else 0
        if over_kerb and self._behind:
            self._passed_red = red
        self._behind = not over_kerb
        if not over_kerb or over_m <= OVER_M:
            return "none"
        if not red:
            return "green"
        return "red" if self._passed_red or self._red_ticks * tick_s > _ANSWER_S else "turned"

    def _footplate(self, ground: Ground) -> tuple[bool, float]:
        """Whether it is over the kerb at the crossing, and how far beyond the crossing's beginning."""
        plant, outline = self.seat.chair.state(), self.seat.chair.outline
        ahead_m = outline.middle_x_m + 0.5 * outline.length_m
        x = float(plant.p_WB_m[0]) + ahead_m * math.cos(plant.yaw_rad)
        y = float(plant.p_WB_m[1]) + ahead_m * math.sin(plant.yaw_rad)
        (x0, y0), (x1, y1) = self.place.crossing.start_W_m, self.place.crossing.end_W_m
        length_m = math.dist((x0, y0), (x1, y1))
        along_m = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length_m
        aside_m = abs((y - y0) * (x1 - x0) - (x - x0) * (y1 - y0)) / length_m
        there = along_m < length_m and aside_m < ASIDE_M
        return there and ground.class_here(x, y) in CARRIAGEWAY, along_m


def approach_crossings(
    town: Town,
    config: RunConfig,
    name: str,
    count: int,
    law_share: float,
    seed: int,
    progress: Callable[[str], object] = lambda text: None,
) -> list[CrossingApproach]:
    """Let users of profile `name` come to `count` crossings of a town that have a light, in its traffic.

    Args:
        town: Where.
        config: Of the world.
        name: Profile, with its exact parameters.
        count: Approaches; the town's crossings are taken in turn, each from both sides.
        law_share: In the place of the profile's.
        seed: Of the world, and of the crossings' order.
        progress: Hears of each approach that is over.

    Raises:
        ConfigError: The name is that of no profile.
        TownError: The town has no crossing with a light and a pavement before it.
    """
    done: list[CrossingApproach] = []
    tick_s = config.world.tick_s
    with World(town, config, (None,) * _CHAIRS, seed) as world:
        outline = plant_spec(config.chair).outline
        todo = _ordered(_signalled(world.street, outline), count, seed, town)
        watches: dict[int, _Watch] = {}
        while todo or watches:
            for seat in sorted(set(range(_CHAIRS)) - set(watches)):
                place = _next(todo, world, [watch.place for watch in watches.values()])
                if place is not None:
                    todo.remove(place)
                    world.admit(seat, SeatSpec(profile=name, max_steps=ENDLESS, start=place.start))
                    taken = next(s for s in world.seats if s.index == seat)
                    watches[seat] = _Watch(taken, place, law_share)
            snapshot = next(rollout(world)).after
            for client in snapshot.clients:
                watch = watches[client.seat]
                watch.ticks += 1
                seconds, events = watch.ticks * tick_s, client.events
                # After a crash the chair stands at its start again.
                colour = "none" if events.crashed else watch.entered(world.street.grid, snapshot.signals, tick_s)
                if colour == "none" and not _is_over(events, seconds):
                    continue
                at = watch.place.crossing.start_W_m
                done.append(CrossingApproach(town=town.name, colour=colour, seconds=seconds, at_W_m=at))
                told = f"{town.name}: {colour} after {seconds:.0f} s at ({at[0]:.1f}, {at[1]:.1f})"
                progress(f"{told} {_ending(events)}".rstrip())
                world.dismiss(client.seat)
                del watches[client.seat]
    return done


def _is_over(events: Events, seconds: float) -> bool:
    return seconds >= LONGEST_S or events.crashed or events.arrived or events.gave_up


def _ending(events: Events) -> str:
    """How an approach ended, "" when it did on the crossing or when its time was up."""
    return events.crash_reason or ("arrived" if events.arrived else "gave up" if events.gave_up else "")


def colours(found: Sequence[CrossingApproach]) -> dict[str, int]:
    """How many came onto the crossing, and at what light."""
    return {
        "approaches": len(found),
        "at green": sum(item.colour == "green" for item in found),
        "turned red on the kerb line": sum(item.colour == "turned" for item in found),
        "at red": sum(item.colour == "red" for item in found),
        "never": sum(item.colour == "none" for item in found),
    }


def _ordered(places: Sequence[CrossingPlace], count: int, seed: int, town: Town) -> list[CrossingPlace]:
    """`count` of the places in an order of their own, the same again when there are too few."""
    if not places:
        raise TownError(f"{town.name} has no crossing with a light and a pavement before it; name another town")
    order = seeding.generator(seed, "crossings").permutation(len(places)).tolist()
    return [places[order[i % len(order)]] for i in range(count)]


def _next(todo: Sequence[CrossingPlace], world: World, at_work: Sequence[CrossingPlace]) -> CrossingPlace | None:
    """The first place at whose start nobody is now, and to whose kerb no other chair is on its way."""
    taken = [actor.p_W_m[:2] for actor in world.snapshot.actors]
    taken += [seat.chair.state().p_WB_m[:2] for seat in world.seats]
    for place in todo:
        apart = all(math.dist(place.start.p_W_m, other.start.p_W_m) > APART_M for other in at_work)
        if apart and all(math.dist(place.start.p_W_m, at) > ROOM_M for at in taken):
            return place
    return None
