"""When a chair presses the button of a crossing, and that it gets over the road in a world with SUMO in it."""

import math

import pytest

from tests.support.lit_road import CROSSING_LINKS, lit_road
from tests.support.samples import USUAL_OUTLINE, strip_street
from tests.support.worlds import follow, hashes, open_world, push
from tests.users.test_crossing import ROUTE, lit
from wcsim.bridge.ego.crossing_watch import CrossingButton
from wcsim.bridge.reaction.commands import GreenRequest
from wcsim.config import WorldConfig, resolve
from wcsim.types import SeatSpec, SignalState, StartSpec

HALF_M = 0.5 * USUAL_OUTLINE.length_m
AT_KERB_M = 11.5 - HALF_M - 0.3  # where a user waits for a crossing that begins at 11.5 m
RED = (SignalState(tls_id="t", colours="GrrG"),)
GREEN = (SignalState(tls_id="t", colours="rGGr"),)
STREET = lit(strip_street())


def button(**world) -> CrossingButton:
    return CrossingButton(ROUTE, STREET, HALF_M, WorldConfig(**world))


def asked(moments, **world):
    """Whether there is a request after each of (time, arc, speed, signals)."""
    here = button(**world)
    found = [here.see(arc_m, speed_mps, time_s, signals) for time_s, arc_m, speed_mps, signals in moments]
    assert {each for each in found if each is not None} <= {GreenRequest(tls_id="t", links=(1, 2))}
    return [each is not None for each in found]


def test_who_has_stood_at_a_red_light_for_some_time_asks_until_it_is_green():
    moments = [(t, AT_KERB_M, 0.0, RED) for t in (70.0, 71.0, 71.9, 72.0, 79.0)] + [(79.1, AT_KERB_M, 0.0, GREEN)]
    assert asked(moments) == [False, False, False, True, True, False]
    assert asked(moments, button=False) == [False] * 6


def test_who_drives_up_has_not_stood_yet_and_who_turns_after_the_press_has_asked():
    here = [(t, AT_KERB_M, speed, RED) for t, speed in ((0.0, 0.5), (1.5, 0.5), (3.0, 0.0), (3.5, 0.0), (5.0, 0.3))]
    assert asked(here) == [False, False, False, True, True]


@pytest.mark.parametrize(
    "arc_m, asks",
    [(AT_KERB_M - 6.0, False), (AT_KERB_M, True), (AT_KERB_M + 0.5, True), (13.0, False), (19.5, False)],
)
def test_the_button_is_at_the_kerb(arc_m, asks):
    assert asked([(0.0, arc_m, 0.0, RED), (5.0, arc_m, 0.0, RED)]) == [False, asks]


def test_who_left_has_to_stand_there_anew():
    far = (3.0, 2.0, 0.0, RED)
    assert asked([(0.0, AT_KERB_M, 0.0, RED), (2.5, AT_KERB_M, 0.0, RED), far, (3.1, AT_KERB_M, 0.0, RED)]) == [
        False, True, False, False,
    ]  # fmt: skip


def test_the_papers_world_has_no_button():
    assert resolve("quick", ()).world.button and not resolve("paper", ()).world.button


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    return lit_road(tmp_path_factory.mktemp("road")).folder


def spec(x_m=-9.0, y_m=4.9, yaw_rad=0.0) -> SeatSpec:
    """On the north pavement, with a way over the crossing at x = 0."""
    start = StartSpec(p_W_m=(x_m, y_m), yaw_rad=yaw_rad, goal_W_m=(12.0, -4.75))
    return SeatSpec(profile="competent", start=start)


def drive(road, seconds, *overrides, **place):
    """Events and whether the light was green of each tick, of a chair that obeys its user."""
    with open_world(road, *overrides, spec=spec(**place)) as world:
        seen = []
        for _ in range(round(10 * seconds)):
            snapshot = follow(world)
            (light,) = snapshot.signals
            seen.append((snapshot.clients[0].events, light.frees(CROSSING_LINKS)))
            if seen[-1][0].crossed:
                break
    return seen


def test_a_chair_that_waits_gets_green_and_crosses(road):
    seen = drive(road, 60.0)
    assert seen[-1][0].crossed and not any(events.entered_red for events, _ in seen)
    assert any(free for _, free in seen)


def test_without_the_button_it_waits_in_vain_and_stays_off_the_road(road):
    seen = drive(road, 25.0, "world.button=false")
    assert not any(free for _, free in seen)
    assert not any(events.crossed or events.on_carriageway for events, _ in seen)


def test_the_person_presses_whoever_drives_the_chair(road):
    """It stands at the kerb with the stick at rest; another one, farther off, asks for nothing."""
    for start, presses in (((-1.3, 4.2, math.atan2(-1.5, 2.0)), True), ((-6.0, 4.75, 0.0), False)):
        with open_world(road, spec=spec(*start)) as world:
            free = False
            for _ in range(120):
                push(world)
                free |= world.snapshot.signals[0].frees(CROSSING_LINKS)
            assert free == presses, start


def test_a_world_with_the_button_repeats_itself(road):
    with open_world(road, spec=spec()) as world:
        first = hashes(world, 150)
        world.rebuild(1)
        assert hashes(world, 150) == first
