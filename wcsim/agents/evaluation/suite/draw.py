"""Draws the episodes of a list in any town: ways along pavements, and attempts at its crossings.

A way is over carriageways on crossings alone, with room to wait before each of their lights.
netconvert lays walking areas of crowded junctions over lanes, and some refuges are shorter than a
chair: what is counted there says something about the map and nothing about a policy.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from wcsim.bridge.ego.start_place import is_clear
from wcsim.bridge.reaction.commands import ROADWAY
from wcsim.config import RunConfig
from wcsim.config.suite import Part, SuiteBlock, SuiteEpisode
from wcsim.core import seeding
from wcsim.errors import TownError
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.towns.walking.routes import Router
from wcsim.types import F64, Outline, Route, Street
from wcsim.users.crossing import KERB_GAP_M, find_route_crossings
from wcsim.users.profiles import UserProfile
from wcsim.users.recordings.recorded_user import find_user

BESIDE_M: Final = 1.0  # of road in one go beside the crossings: a kerb that runs aslant
_STEP_M: Final = 0.25
SEATS: Final = 6  # in a block, at most
APART_M: Final = 60.0  # the ways of a block's chairs keep so far from one another: they do not meet
_TRIES: Final = 400
_FROM_REST_S: Final = 2.0
_SLACK: Final = 3.0  # an episode lasts so many times its reference, and a minute for lights
_WAITS_S: Final = 60.0
XY = tuple[float, float]
Way = tuple[SuiteEpisode, Route]


def _is_sound(street: Street, route: Route, outline: Outline) -> bool:
    """Whether a test may send a chair of this outline along a route."""
    over = find_route_crossings(route, street.walk)
    # A chair that waits before a light needs room between it and the crossing before.
    room_m = outline.length_m + KERB_GAP_M
    if any(
        then.tls_id and then.start_m - before.end_m <= room_m for before, then in pairwise(over)
    ):
        return False
    # The longest stretch of carriageway on it that is on none of its crossings.
    arc_m = np.arange(0.0, route.arc_m[-1], _STEP_M)
    x_m, y_m = (
        np.interp(arc_m, route.arc_m, route.points_W_m[:, axis]).tolist() for axis in (0, 1)
    )
    longest = now = 0
    for at_m, x, y in zip(arc_m.tolist(), x_m, y_m, strict=True):
        crossed = any(item.start_m <= at_m <= item.end_m for item in over)
        now = 0 if crossed or street.grid.class_here(x, y) not in ROADWAY else now + 1
        longest = max(longest, now)
    return longest * _STEP_M <= BESIDE_M


class DrawPlace:
    """A town to draw in.

    Args:
        name: What is drawn depends on it.
        street: The town's.
        config: Of the chair.
        listed: What a list calls the town; by default its name.
    """

    def __init__(self, name: str, street: Street, config: RunConfig, listed: str = "") -> None:
        """Raises TownError when the town has no ways."""
        self.name, self.listed, self.street, self.config = name, listed or name, street, config
        self.router, self.outline = Router(street.walk), plant_spec(config.chair).outline


@dataclass(frozen=True, slots=True, kw_only=True)
class WaySpec:
    """What the episodes of a part are like."""

    part: Part
    profiles: tuple[str, ...]  # in turn
    way_m: tuple[float, float] = (60.0, 160.0)
    crossing_share: float = 0.5


def free_blocks(place: DrawPlace, spec: WaySpec, blocks: int, seed: int) -> list[SuiteBlock]:
    """Blocks of ways along the town's pavements.

    Raises TownError when the town is too small for one.
    """
    made = []
    for number in range(blocks):
        rng = seeding.make_rng(seed, "suite", place.name, spec.part, number)
        user = spec.profiles[number % len(spec.profiles)]
        # The first ways, up to SEATS, that keep APART_M from one another; their points
        # (n, 2) are a metre apart.
        episodes: list[SuiteEpisode] = []
        lines: list[F64] = []
        for episode, route in _ways(place, spec, user, rng):
            points_m = route.points_W_m
            if all(np.hypot(*(points_m[:, None] - other_m).T).min() > APART_M for other_m in lines):
                episodes.append(episode)
                lines.append(points_m)
                if len(episodes) == SEATS:
                    break
        if not episodes:
            raise TownError(
                f"{place.name}: no route of {spec.way_m[0]:g} m was found; expected a larger town"
            )
        made.append(
            SuiteBlock(
                part=spec.part,
                town=place.listed,
                seed=seeding.derive_seed(seed, "block", place.name, spec.part, number),
                episodes=tuple(episodes),
            )
        )
    return made


def _ways(place: DrawPlace, spec: WaySpec, user: str, rng: np.random.Generator) -> Iterator[Way]:
    """Sound ways.

    Whether one leads over a crossing is drawn before it is, so that the share stays as wanted.
    """
    over = float(rng.random() < spec.crossing_share)
    for _ in range(_TRIES):
        start, yaw_rad = place.router.random_start(rng)
        # Nothing that stands may be in the way; who moves is not there yet.
        if not is_clear(
            place.street.grid,
            place.outline,
            np.array(start),
            yaw_rad,
            0.0,
            lambda _p_W_m, _reach_m: (),
        ):
            continue
        goal = place.router.random_goal(rng, start, *spec.way_m, over)
        episode, route = _episode(place, start, yaw_rad, goal, user)
        # some go round another corner
        long_enough = 0.5 * spec.way_m[0] <= episode.route_m <= 2.0 * spec.way_m[1]
        if long_enough and _is_sound(place.street, route, place.outline):
            yield episode, route
            over = float(rng.random() < spec.crossing_share)


def _episode(place: DrawPlace, start: XY, yaw_rad: float, goal: XY, user: str) -> Way:
    start = (round(start[0], 3), round(start[1], 3))
    goal = (round(goal[0], 3), round(goal[1], 3))
    route = place.router.route(start, goal)
    reference_s = _reference_time_s(route, user, place.config)
    tick_s = place.config.world.tick_s
    episode = SuiteEpisode(
        start_m=start,
        heading_rad=round(yaw_rad, 4),
        goal_m=goal,
        profile=user,
        max_steps=round((_SLACK * reference_s + _WAITS_S) / tick_s),
        route_m=round(float(route.arc_m[-1]), 3),
        reference_s=round(reference_s, 2),
    )
    return episode, route


def _reference_time_s(route: Route, user: str, config: RunConfig) -> float:
    """The time of a way with nothing to hinder it: at the speed that its user likes, from rest."""
    person = find_user(user)
    share = person.speed_share if isinstance(person, UserProfile) else 1.0
    return _FROM_REST_S + float(route.arc_m[-1]) / (share * config.chair.v_max_mps)
