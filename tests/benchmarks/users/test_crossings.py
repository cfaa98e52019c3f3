"""What counts as driving onto a crossing at red, and that chairs under test do not wait at one kerb."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.users.crossings import CrossingApproach, CrossingPlace, _next, _Watch, colours
from tests.support.samples import USUAL_OUTLINE, strip_street
from tests.users.actors import make_user
from tests.users.kinematics import plant
from tests.users.test_crossing import ROUTE, lit
from wcsim.types import SignalState, StartSpec
from wcsim.users.crossing import Crossing

STREET = strip_street()
FOOT_M = USUAL_OUTLINE.middle_x_m + 0.5 * USUAL_OUTLINE.length_m
ROAD = Crossing(start_m=11.5, end_m=19.5, start_W_m=(40.0, 4.0), end_W_m=(40.0, -4.0), tls_id="t", tls_links=(1, 2))


def place(x_m: float = 32.0) -> CrossingPlace:
    return CrossingPlace(start=StartSpec(p_W_m=(x_m, 5.5), yaw_rad=0.0, goal_W_m=(48.0, -5.5)), crossing=ROAD)


def colour(beyond_m, reds) -> str:
    """What an approach comes to in which the footplate is so far beyond the kerb, tick by tick, at these lights."""
    chair = SimpleNamespace(outline=USUAL_OUTLINE, y_m=0.0)
    chair.state = lambda: plant(40.0, chair.y_m, -0.5 * np.pi)
    watch = _Watch(SimpleNamespace(chair=chair, user=make_user(street=lit(STREET)), route=ROUTE), place(), 1.0)
    for foot_m, red in zip(beyond_m, reds, strict=True):
        chair.y_m = 4.0 - foot_m + FOOT_M
        found = watch.entered(STREET.grid, (SignalState(tls_id="t", colours="GrrG" if red else "rGGr"),), 0.1)
        if found != "none":
            return found
    return "none"


OVER = [-0.2, -0.05, 0.1, 0.25, 0.4]


@pytest.mark.parametrize(
    ("beyond_m", "reds", "found"),
    [
        (OVER, [0, 0, 0, 0, 0], "green"),
        (OVER, [1, 1, 1, 1, 1], "red"),
        (OVER, [0, 0, 1, 1, 1], "red"),  # as it passes the line
        (OVER, [0, 0, 0, 1, 1], "turned"),
        (OVER[:4], [1, 1, 1, 1], "none"),
        ([-0.2, 0.1, *[0.2] * 11, 0.4], [0, 0, *[1] * 12], "red"),  # stands on the line, and goes on at red
        ([-0.2, 0.1, 0.2, 0.4], [1, 1, 0, 0], "green"),  # rolled onto the line, and waited there
        ([-0.2, 0.1, -0.2, 0.1, 0.4], [0, 0, 0, 1, 1], "red"),  # the last passing counts
    ],
)
def test_the_light_at_which_the_footplate_comes_over_the_kerb(beyond_m, reds, found):
    assert colour(beyond_m, reds) == found


def test_the_next_place_is_away_from_where_another_chair_is_at_work():
    world = SimpleNamespace(snapshot=SimpleNamespace(actors=()), seats=())
    near, far = place(20.0), place(70.0)
    assert _next([near, far], world, []) is near
    assert _next([near, far], world, [place(32.0)]) is far
    assert _next([near], world, [place(32.0)]) is None


def test_the_count_leaves_nobody_out():
    seen = [("green", 5.0), ("turned", 9.0), ("red", 8.0), ("none", 20.0), ("green", 150.0)]
    found = colours([CrossingApproach(town="a", colour=c, seconds=s, at_W_m=(0.0, 0.0)) for c, s in seen])
    assert list(found.values()) == [5, 2, 1, 1, 1]
