import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.actors import actor
from tests.support.samples import KERB_M, strip_street
from wcsim.bridge.mirror import JUMP_M, in_reach, moves, on_ground, walked
from wcsim.scenes.run import _open_scene, play
from wcsim.towns.scene_folders.build import find_scene
from wcsim.types import ActorKind, ActorState


def moved(old, new):
    (move,) = moves({old.id: old}, (new,), dt_s=0.1)
    return move


def test_velocity_carries_the_old_pose_to_the_new_one():
    old = actor(x=3.0, y=1.0, yaw=3.0, speed=10.0)
    new = replace(old, p_W_m=np.array([2.0, 1.2, 0.0]), yaw_rad=-3.1)
    move = moved(old, new)
    assert np.allclose(move.actor.p_W_m + 0.1 * move.v_W_mps, new.p_W_m)
    assert move.yaw_rate_radps == pytest.approx((2 * math.pi - 6.1) / 0.1)


def test_a_newcomer_comes_from_where_its_speed_says():
    new = actor(x=10.0, speed=8.0)
    (move,) = moves({}, (new,), dt_s=0.1)
    assert move.actor.p_W_m[0] == pytest.approx(9.2)
    assert np.allclose(move.v_W_mps, [8.0, 0.0, 0.0])


def test_a_teleported_actor_does_not_sweep_through_the_street():
    old, new = actor(x=0.0), actor(x=40.0)
    move = moved(old, new)
    assert np.allclose(move.actor.p_W_m, new.p_W_m)
    assert not move.v_W_mps.any()


@pytest.mark.parametrize("speed", [0.0, 13.9])
def test_a_lane_change_in_one_tick_is_no_sweep_but_a_stumble_is(speed):
    old = actor(speed=speed)
    put_over = replace(old, p_W_m=np.array([0.1 * speed, 3.2, 0.0]))
    assert not moved(old, put_over).v_W_mps.any()
    aside = replace(old, p_W_m=np.array([0.1 * speed, 0.3, 0.0]))
    assert moved(old, aside).v_W_mps[1] == pytest.approx(3.0)


def test_who_is_turned_on_the_spot_does_not_sweep_with_its_length():
    old, new = actor(yaw=0.0), actor(yaw=1.2)
    move = moved(old, new)
    assert move.yaw_rate_radps == 0.0 and move.actor.yaw_rad == 1.2
    turn = moved(old, actor(yaw=0.04))
    assert turn.yaw_rate_radps == pytest.approx(0.4) and turn.dt_s == 0.1
    person = replace(actor(yaw=0.04), kind=ActorKind.PEDESTRIAN)
    assert moved(old, person).yaw_rate_radps == 0.0


def test_a_body_has_the_new_pitch_from_the_start_of_the_tick():
    old, new = actor(), replace(actor(), pitch_rad=0.05)
    assert moved(old, new).actor.pitch_rad == 0.05


@pytest.mark.parametrize("tick_s", [0.02, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("speed", [0.0, 5.0, 14.0, 30.0])
def test_who_drives_past_a_chair_within_a_tick_has_a_body_in_it(tick_s, speed):
    """However long a tick is: whoever was beside the chair at its end, in the middle or at its beginning."""
    chair = np.zeros((1, 2))
    for share in (0.0, 0.5, 1.0):
        past = actor(x=share * speed * tick_s, y=1.3, speed=speed)
        assert in_reach((past,), chair, tick_s) == (past,)
    far = actor(x=12.3 + max(0.0, tick_s - 0.1) * (speed + 5.0), y=1.3, speed=speed)
    assert in_reach((far,), chair, tick_s) == ()


def test_actors_that_have_left_are_not_moved():
    assert moves({"v:gone": actor(name="v:gone")}, (), dt_s=0.1) == ()


def test_actors_stand_on_the_ground_that_wheels_and_cameras_know():
    grid = strip_street().grid
    on_road, on_pavement = on_ground((actor(x=10.0, y=0.0), actor(x=10.0, y=5.5)), grid)
    assert on_road.p_W_m[2] == 0.0
    assert on_pavement.p_W_m[2] == pytest.approx(KERB_M)
    assert on_ground((), grid) == ()


def test_who_slides_aside_has_the_velocity_of_it_and_who_jumps_keeps_sumos():
    person = actor(name="p:a", kind=ActorKind.PEDESTRIAN)
    slid, jumped = (replace(person, p_W_m=np.array([0.0, y, 0.12])) for y in (0.08, 2.0 * JUMP_M))
    assert walked({"p:a": person}, (slid,), 0.1)[0].v_W_mps == pytest.approx([0.0, 0.8, 0.0])
    assert walked({"p:a": person}, (jumped,), 0.1) == (jumped,)
    assert walked({}, (slid,), 0.1) == (slid,), "who has just come near"
    car = actor(y=0.08)
    assert walked({"v:car": actor()}, (car,), 0.1) == (car,)


def test_people_go_where_their_velocity_leads_them_those_who_stepped_aside_too():
    people = aside = slid = 0
    with _open_scene(find_scene("rush-hour")) as (world, scene):
        before: dict[str, ActorState] = {}
        for step in play(world, scene):
            now = {one.id: one for one in step.after.actors if one.kind is ActorKind.PEDESTRIAN}
            for old, new in ((before[name], one) for name, one in now.items() if name in before):
                gone_m = (new.p_W_m - old.p_W_m)[:2]
                if math.hypot(*gone_m) > JUMP_M:
                    continue
                assert gone_m == pytest.approx(0.1 * new.v_W_mps[:2], abs=0.003), new.id
                moved = (new.deflect_m, old.deflect_m) != (0.0, 0.0)
                stands = any(blocked.actor_id == new.id for blocked in world._open.traffic.blocked())
                people, aside = people + 1, aside + moved
                slid += moved and stands and math.hypot(*gone_m) > 0.01
            before = now
    assert people > 1000 and aside > 50 and slid > 0, "who is held and goes back sideways is among them"
