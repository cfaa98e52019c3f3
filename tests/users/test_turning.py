"""Turning round beside kerbs and walls: where there is room, to which side, and never over an edge."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.samples import USUAL_OUTLINE, cell_middles, strip_street
from tests.users.actors import make_user
from tests.users.kinematics import Chair, Sim, polyline
from wcsim.types import StreetGrid
from wcsim.users.turning import AxlePose, plan_turn

STREET = strip_street()


def plan(y, yaw, error, grid=STREET.grid, x=15.0, backwards=True):
    return plan_turn(grid, USUAL_OUTLINE, AxlePose(x_m=x, y_m=y, yaw_rad=yaw), error, backwards)


def walled(high_y: float, to_x: float = 1e9) -> StreetGrid:
    """The street with walls along both sides of a strip, which opens at to_x."""
    grid = STREET.grid
    x, y = cell_middles(grid)
    gap_m = np.where(x < to_x, np.minimum(y - 4.9, high_y - y), 5.0)
    return replace(grid, clearance_dm=np.clip(gap_m * 10, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("error", [1.2, -1.2, 3.0, -3.0])
def test_with_room_the_turn_is_made_at_once_the_short_way(error):
    turn = plan(5.5, 0.3, error)
    assert turn.move_m == 0.0 and turn.turn_rad == pytest.approx(error)


def test_beside_a_kerb_the_front_swings_over_the_pavement():
    right_kerb = plan(4.42, 0.0, -3.0)  # eastwards, the kerb close to the right
    assert right_kerb.move_m == 0.0 and right_kerb.turn_rad == pytest.approx(math.tau - 3.0)
    assert plan(4.42, math.pi, 3.0).turn_rad == pytest.approx(3.0 - math.tau)


def test_in_a_passage_the_chair_goes_on_or_back_to_where_it_opens():
    closed = walled(6.1, to_x=16.0)
    assert plan(5.5, 0.0, 3.0, closed).move_m > 0.5
    assert plan(5.5, math.pi, 3.0, closed, x=15.2).move_m < -0.5
    assert plan(5.5, math.pi, 3.0, closed, x=15.2, backwards=False).move_m >= 0.0
    nowhere = plan(5.5, 0.0, 3.0, walled(6.1))
    assert abs(nowhere.turn_rad) <= 3.0


@pytest.mark.parametrize("y, yaw", [(4.45, 0.0), (4.45, math.pi), (4.8, 2.5), (4.7, -0.5)])
def test_a_user_that_turns_round_stays_on_the_pavement(y, yaw):
    to_x = 40.0 if math.cos(yaw) < 0 else 0.0
    sim = Sim(make_user(street=STREET), polyline((20.0, 5.2), (to_x, 5.2)), Chair(x=20.0, y=y, yaw=yaw))
    for _ in range(150):
        sim.tick()
        cos, sin = math.cos(sim.chair.yaw), math.sin(sim.chair.yaw)
        wheels = [sim.chair.y + ahead * sin + left * cos for ahead in (0.0, 0.5) for left in (-0.29, 0.29)]
        assert min(wheels) > 4.0
    assert abs(sim.chair.x - to_x) < 12.0


def held(name: str) -> Sim:
    """Somebody whose chair hangs on something after 4 s."""
    sim = Sim(make_user(name, street=STREET), polyline((0.0, 5.5), (40.0, 5.5)), Chair(x=5.0, y=5.5))
    sim.run(4.0)
    sim.frozen, sim.chair.v = True, 0.0
    return sim


@pytest.mark.parametrize("name", ["competent", "switch"])
def test_a_user_that_hangs_on_something_backs_up_before_giving_up(name):
    sim, intents = held(name), []
    while not sim.user.gave_up and sim.time_s < 60.0:
        sim.tick()
        intents.append(sim.user.intent.y)
    assert sim.time_s == pytest.approx(4.0 + 15.0, abs=1.5)
    assert (min(intents) < 0.0) == (name == "competent")  # four switches have no reverse


@pytest.mark.parametrize("name", ["competent", "inattentive", "ataxic", "slow"])
def test_a_user_whose_chair_stands_against_something_lets_go_for_a_while(name):
    sim, sticks = held(name), []
    hand = sim.user.profile.reaction_s + sim.user.profile.lag_s
    for _ in range(60):
        sim.tick()
        intent = sim.user.intent
        sticks.append(math.hypot(intent.x, intent.y))
    rests_s = [0.1 * tick for tick, stick in enumerate(sticks, 1) if stick == 0.0]
    # Felt after a second, and the stick follows through the hand.
    assert rests_s[0] == pytest.approx(1.0 + hand, abs=0.45)
    again_s = next(0.1 * tick for tick, stick in enumerate(sticks, 1) if stick > 0.0 and 0.1 * tick > rests_s[0])
    assert again_s == pytest.approx(2.5, abs=0.55)


def test_turning_in_a_hairpin_never_leads_back_to_its_first_leg():
    """Out on one crossing and back on the next: both legs are equally near to a chair that turns between them."""
    legs = polyline((-5.0, 5.5), (5.0, 5.5), (5.0, 5.7), (-5.0, 6.2))
    sim = Sim(make_user(street=STREET), legs, Chair(x=4.9, y=5.55, yaw=math.pi))
    sim.tick()
    reached_m = sim.user.route_progress_m
    assert reached_m > 9.5
    for yaw in np.linspace(math.pi, -math.pi, 30):
        sim.chair.yaw = float(yaw)
        sim.tick()
        assert sim.user.route_progress_m >= reached_m
        reached_m = sim.user.route_progress_m


def test_a_chair_turned_one_way_as_far_as_it_goes_never_turns_back():
    corner = walled(6.2)
    first = plan(5.5, 0.0, 2.0, corner)
    assert not first.complete
    stuck = AxlePose(x_m=15.0, y_m=5.5, yaw_rad=first.turn_rad)
    back = plan_turn(corner, USUAL_OUTLINE, stuck, -1.5)
    assert back.turn_rad < 0.0 and not back.move_m
    again = plan_turn(corner, USUAL_OUTLINE, stuck, -1.5, tried=1.0)
    assert again.turn_rad >= 0.0 or abs(again.move_m) > 0.3
