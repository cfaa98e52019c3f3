"""The wheelchair on its wheels: standing, driving, turning, stopping, kerbs, drops, the same bytes again."""

import dataclasses
import hashlib
import math

import numpy as np
import pytest

from tests.physics.rig import FORWARD, NEUTRAL, actor, fan_street, flat_street, rig, step_street, tiled_street
from tests.support.samples import KERB_M, strip_street
from tests.support.typed import python_says
from wcsim.config import ChairConfig, ImuConfig
from wcsim.config.plant import list_plants
from wcsim.core.joystick import compute_yaw_rate_limit
from wcsim.errors import ConfigError, PhysicsError
from wcsim.physics.engine import PARK_Z_M, SUSPECT_N, Engine
from wcsim.physics.kinematic_bodies import BodyMove, BodyPool
from wcsim.physics.wheelchair.drive_controller import stopping_distance_m
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.physics.wheelchair.wheelchair import Wheelchair
from wcsim.types import ActorKind, ClassId, Joystick

START_TICKS = 30  # after these a chair cruises
EACH_PLANT = pytest.mark.parametrize("plant", list_plants())


@pytest.fixture
def each(plant):
    """A chair of each plant on a flat street."""
    with rig(plant=plant) as made:
        yield made


@EACH_PLANT
def test_stands_within_5_mm_of_where_it_was_placed(each):
    ride = each.place(1.0, 2.0, yaw=0.7).drive(NEUTRAL, 10)
    state = each.chair.state()
    assert np.abs(state.p_WB_m - (1.0, 2.0, 0.0)).max() < 0.005
    assert abs(state.yaw_rad - 0.7) < 1e-3
    assert max(map(abs, (state.roll_rad, state.pitch_rad))) < 1e-3
    assert ride.peaks().max() < 3.0  # putting it down is no bump
    assert not ride.contacts


def test_stands_on_a_pavement_and_after_a_long_wait_still_obeys():
    with rig(strip_street().mesh) as r:
        r.place(10.0, 5.5, KERB_M).drive(NEUTRAL, 60)
        assert abs(r.chair.state().p_WB_m[2] - KERB_M) < 0.005
        ride = r.drive(FORWARD, 20)
    assert ride.speed[-1] > 1.0


@EACH_PLANT
def test_drives_straight_at_the_speed_asked_for(each):
    ride = each.place(-6.0).drive(FORWARD, 90)
    way = np.array(ride.p_m)
    assert way[-1][0] - way[0][0] > 10.0
    assert np.abs(way[:, 1]).max() < 0.05
    assert np.mean(ride.speed[START_TICKS:]) == pytest.approx(1.67, rel=0.03)
    assert not ride.contacts


@EACH_PLANT
@pytest.mark.parametrize("x, y", [(1.0, 0.0), (-1.0, 0.0), (0.6, 0.5)])
def test_turns_at_the_rate_asked_for(each, x, y, plant):
    ride = each.drive(Joystick(x, y), 50)
    stick = (math.hypot(x, y) - 0.08) / 0.92 / math.hypot(x, y)
    speed = 1.67 * y * stick
    rate = -x * stick * compute_yaw_rate_limit(speed, each.config.yaw_rate_max_radps, each.config.yaw_slowdown_s_per_m)
    assert np.mean(ride.yaw_rate[START_TICKS:]) == pytest.approx(rate, rel=0.03)
    assert np.mean(ride.speed[START_TICKS:]) == pytest.approx(speed, rel=0.03, abs=0.02)


def test_its_drive_tells_what_it_asks_for(on_flat):
    on_flat.place(-6.0)
    assert on_flat.chair.drive_accel_mps2() == 0.0
    on_flat.drive(FORWARD, 5)
    assert on_flat.chair.drive_accel_mps2() == pytest.approx(ChairConfig().accel_mps2, abs=0.01)
    on_flat.drive(FORWARD, 60)
    assert abs(on_flat.chair.drive_accel_mps2()) < 0.05
    on_flat.drive(NEUTRAL, 5)
    assert on_flat.chair.drive_accel_mps2() == pytest.approx(-ChairConfig().decel_mps2, abs=0.01)
    assert on_flat.place(0.0).chair.drive_accel_mps2() == 0.0


def test_reverses_straight_at_its_share_of_the_speed(on_flat):
    ride = on_flat.drive(Joystick(0.0, -1.0), 90)
    assert np.mean(ride.speed[60:]) == pytest.approx(-0.4 * 1.67, rel=0.03)
    assert abs(ride.end.yaw_rad) < 0.15  # the casters swing round on the way


@EACH_PLANT
def test_stops_in_the_distance_that_its_limits_give(each):
    start = each.place(-6.0).drive(FORWARD, 40).p_m[-1][0]
    ride = each.drive(NEUTRAL, 30)
    expected = stopping_distance_m(1.67, each.config.decel_mps2, each.config.jerk_mps3)
    assert ride.p_m[-1][0] - start == pytest.approx(expected, rel=0.10)
    assert abs(ride.speed[-1]) < 1e-3


@pytest.mark.parametrize("plant", ["mwd", "rwd"])  # which may be driven so fast
def test_climbs_straight_where_its_motors_give_all_they_can(plant):
    flat, rise = step_street(0.0), math.tan(math.radians(12.0))
    points = flat.vertices_W_m + np.outer(flat.vertices_W_m[:, 0], (0.0, 0.0, rise))
    street = dataclasses.replace(flat, vertices_W_m=points.astype(np.float32))
    with rig(street, plant=plant, v_max_mps=2.78) as r:
        ride = r.place(-15.0, 0.0, -15.0 * rise).drive(FORWARD, 60)
    # With all they have its wheels are at the edge of their grip: mwd ends at 2.15 on one kind of CPU, 2.4 on others.
    assert 2.0 < ride.speed[-1] < 2.7
    assert abs(ride.end.yaw_rad) < math.radians(4.0)


def reach_m(spec, rise_m: float) -> float:
    """How far ahead of the drive axle a kerb of a height meets the first trailing caster."""
    pair = max(spec.casters, key=lambda item: item.swivel_x_m)
    above = max(pair.radius_m - rise_m, 0.0)
    return pair.swivel_x_m - pair.trail_m + math.sqrt(pair.radius_m**2 - above**2)


DECLARED = {name: plant_spec(ChairConfig(plant=name)).climbs for name in list_plants()}
CLIMBS = [(name, rise, 0.0) for name, climbs in DECLARED.items() for rise in climbs.standstill_m]
CLIMBS += [(name, rise, 0.5) for name, climbs in DECLARED.items() for rise in climbs.run_up_m]
REFUSES = [(name, rise, run) for name, climbs in DECLARED.items() for rise in climbs.refused_m for run in (0.0, 0.5)]


def ride_at_kerb(plant, rise_m: float, run_up_m: float, ticks: int):
    """A ride that begins so far before its first trailing caster meets a kerb."""
    with rig(step_street(rise_m), plant=plant) as r:
        start = 3.0 - reach_m(r.chair.spec, rise_m) - 0.002 - run_up_m
        return r.place(start).drive(FORWARD, ticks)


@pytest.mark.parametrize("plant, rise_m, run_up_m", CLIMBS)
def test_climbs_the_kerbs_that_its_file_declares(plant, rise_m, run_up_m):
    ride = ride_at_kerb(plant, rise_m, run_up_m, 45)
    assert ride.end.p_WB_m[0] > 3.8
    assert ride.end.p_WB_m[2] == pytest.approx(rise_m, abs=0.006)
    assert "building" not in ride.kinds()


@pytest.mark.parametrize("plant, rise_m, run_up_m", REFUSES)
def test_is_stopped_by_the_kerbs_that_its_file_declares(plant, rise_m, run_up_m):
    ride = ride_at_kerb(plant, rise_m, run_up_m, 40)
    assert ride.end.p_WB_m[0] < 2.7
    assert abs(ride.end.p_WB_m[2]) < 0.02
    if run_up_m:
        assert {(c.kind, c.part) for c in ride.contacts} & {("kerb", "footplate"), ("ground", "footplate")}


def test_a_wall_at_full_speed_is_a_crash_of_its_own_making():
    with rig(step_street(2.0, wall=ClassId.BUILDING)) as r:
        ride = r.drive(FORWARD, 40)
    assert ride.peaks().max() > 40.0
    hit = next(contact for contact in ride.contacts if contact.kind == "building")
    assert hit.part == "footplate" and hit.cause == "own" and hit.impulse_Ns > 50.0


def test_a_40_mm_kerb_at_walking_speed_lies_in_the_window_of_the_penalty():
    with rig(step_street(0.04), v_max_mps=1.0) as r:
        ride = r.place(1.0).drive(FORWARD, 45)
    assert 20.0 < ride.peaks(10).max() < 40.0


@pytest.mark.parametrize("yaw_deg, start", [(0, (1.5, 0.0)), (45, (1.5, -1.5)), (80, (2.0, -9.0))])
def test_driving_off_a_kerb_does_not_tip_it(yaw_deg, start):
    with rig(step_street(-0.12), v_max_mps=1.0) as r:
        ride = r.place(*start, yaw=math.radians(yaw_deg)).drive(FORWARD, 75)
    assert np.degrees(np.abs(ride.tilt)).max() < 25.0
    assert ride.end.p_WB_m[2] == pytest.approx(-0.12, abs=0.005)
    assert abs(ride.end.roll_rad) < 0.02 and abs(ride.end.pitch_rad) < 0.02


@pytest.mark.parametrize("street", [tiled_street(0.5), tiled_street(2.0), fan_street(300)], ids=["0.5m", "2m", "fan"])
def test_flat_ground_rides_smoothly_however_it_is_cut_into_triangles(street):
    with rig(street) as r:
        ride = r.place(-2.5).drive(FORWARD, 150)
    felt = np.array(ride.lowpass[START_TICKS * 24 :])
    assert math.sqrt((felt**2).sum(axis=1).mean()) < 0.35
    assert np.abs(felt).max() < 3.0
    assert np.abs(np.array(ride.p_m)[:, 2]).max() < 0.002


@EACH_PLANT
def test_cruising_on_two_large_triangles_is_felt_by_no_axis(each):
    ride = each.place(-15.0).drive(FORWARD, 120)
    felt = np.array(ride.lowpass[START_TICKS * 24 :])
    assert np.sqrt((felt**2).mean(axis=0)).max() < 0.05
    assert np.abs(felt).max() < 1.0  # once, where it rolls over the line between them


def test_the_sample_street_rides_smoothly_down_a_lowered_kerb_and_up_again():
    with rig(strip_street().mesh) as r:
        ride = r.place(40.0, 6.2, KERB_M, -math.pi / 2).drive(FORWARD, 90)
    felt = np.array(ride.lowpass[START_TICKS * 24 :])
    assert ride.p_m[-1][1] < -5.0  # on the other pavement
    assert min(p[2] for p in ride.p_m) < 0.005
    assert ride.p_m[-1][2] == pytest.approx(KERB_M, abs=0.006)
    assert np.abs(felt).max() < 10.0
    assert not ride.contacts


@EACH_PLANT
def test_a_parked_chair_stays_out_of_the_way_and_comes_back(each):
    each.drive(FORWARD, 5)
    each.chair.park()
    each.drive(FORWARD, 5)
    for _ in range(240):
        each.engine.step()
    each.chair._read()
    assert each.chair.parked and each.chair.state().p_WB_m[2] == pytest.approx(PARK_Z_M)  # it does not fall
    each.place(2.0).drive(FORWARD, 10)
    assert each.chair.state().p_WB_m[2] == pytest.approx(0.0, abs=0.005)
    assert each.chair.state().v_B_mps[0] > 0.5


def require_asked(engine: Engine, *chairs: Wheelchair) -> list[bool]:
    """Which chairs touch more than ground by their feet, told one by one; `touched` must say the same."""
    more = [
        any(
            point[9] > SUSPECT_N or point[2] not in engine.rolling_ids or point[3] not in chair._body.part
            for point in engine.bullet.getContactPoints(bodyA=chair.body_id)
        )
        for chair in chairs
    ]
    assert [chair.body_id in engine.touched() for chair in chairs] == more
    return more


def test_two_chairs_collide(engine):
    engine.add_street(flat_street())
    chairs = [Wheelchair(engine, ChairConfig(), ImuConfig(), seat) for seat in range(2)]
    chairs[0].place(np.array([0.0, 0.0, 0.0]), 0.0)
    chairs[1].place(np.array([4.0, 0.0, 0.0]), math.pi)
    touched: list[set[tuple[str, str, str]]] = [set(), set()]
    for _ in range(30):
        chairs[0].command(FORWARD)
        for _ in range(24):
            for chair in chairs:
                chair.before_step()
            engine.step()
            require_asked(engine, *chairs)
            for chair in chairs:
                chair.after_step()
        for chair, found in zip(chairs, touched, strict=True):
            chair.end_tick(None)
            found |= {(contact.kind, contact.actor_id, contact.cause) for contact in chair.contacts()}
    assert touched[0] == {("wheelchair", "w:1", "own")}
    assert touched[1] == {("wheelchair", "w:0", "other")}


def test_only_who_has_more_than_feet_on_the_ground_is_asked_for_contacts():
    found = []
    with rig(step_street(0.12), v_max_mps=1.67) as r:
        r.chair.command(FORWARD)
        for _ in range(720):
            r.step()
            found += require_asked(r.engine, r.chair)
    assert 0 < sum(found) < 360


@pytest.mark.parametrize("start_m", [-3.5, -3.488, -3.476])  # where within a substep the car arrives
@pytest.mark.parametrize("yaw", [0.0, 0.7, math.pi / 2, math.pi, 4.19, 4.71])
def test_a_car_pushes_the_chair_and_does_not_sink_into_it(on_flat, yaw, start_m):
    deepest = fastest = 0.0
    pool = BodyPool(on_flat.engine)
    on_flat.place(yaw=yaw)
    for tick in range(8):
        car = actor("car", 0.8 * tick + start_m, 0.0)
        pool.place([BodyMove(actor=car, v_W_mps=np.array([8.0, 0.0, 0.0]), yaw_rate_radps=0.0)])
        for _ in range(24):
            on_flat.step()
            require_asked(on_flat.engine, on_flat.chair)
            body, bullet = pool.body_of("car"), on_flat.engine.bullet
            points = bullet.getContactPoints(on_flat.chair.body_id, body)
            deepest = min([deepest, *[point[8] for point in points]])
        on_flat.chair.end_tick(None)
        fastest = max(fastest, float(np.hypot(*on_flat.chair.state().v_B_mps[:2])))
        for contact in on_flat.chair.contacts():
            if contact.kind == "car":
                assert contact.cause == "other" and contact.actor_id == "car"
    assert -0.05 < deepest < 0.0  # the car moves 3.3 cm in a substep, a caster of the turning chair comes against it
    assert fastest > 6.0


def test_who_drives_into_a_standing_person_is_the_cause(on_flat):
    pool = BodyPool(on_flat.engine)
    person = actor("p", 2.5, 0.0, kind=ActorKind.PEDESTRIAN, size=(0.25, 0.5, 1.75))
    move = BodyMove(actor=person, v_W_mps=np.zeros(3), yaw_rate_radps=0.0)
    ride = on_flat.drive(FORWARD, 30, before_tick=lambda _: pool.place([move]))
    assert {(c.kind, c.cause, c.actor_id) for c in ride.contacts} == {("pedestrian", "own", "p")}


def drive_and_hash() -> str:
    """A drive over a kerb and into a wall, as a hash of every state."""
    digest = hashlib.sha256()
    with rig(strip_street().mesh) as r:
        r.place(20.0, 1.5, yaw=0.6)
        for stick in (FORWARD, Joystick(0.4, 0.8), NEUTRAL):
            for _ in range(20):
                r.drive(stick, 1)
                state, imu = r.chair.state(), r.chair.imu()
                for part in (state.p_WB_m, state.q_WB, state.v_B_mps, state.w_B_radps, state.wheel_radps):
                    digest.update(part.tobytes())
                digest.update(imu.accel_peak_mps2.tobytes() + imu.accel_mean_mps2.tobytes())
    return digest.hexdigest()


def test_the_same_calls_give_the_same_bytes_in_one_process_and_in_two():
    here = drive_and_hash()
    assert drive_and_hash() == here
    code = "from tests.physics.wheelchair.test_wheelchair import drive_and_hash; print(drive_and_hash())"
    assert python_says(code).split()[-1] == here


def test_an_episode_does_not_depend_on_the_one_before():
    def positions(before: bool) -> list[np.ndarray]:
        with rig() as r:
            if before:
                r.drive(Joystick(0.5, 0.5), 15)
            return r.place(1.0, 1.0, yaw=0.3).drive(FORWARD, 15).p_m

    assert np.array_equal(positions(True), positions(False))


def test_refuses_an_unknown_plant_and_numbers_that_are_not_finite(on_flat):
    with pytest.raises(PhysicsError, match="not finite"):
        on_flat.chair.place(np.array([0.0, math.nan, 0.0]), 0.0)
    with pytest.raises(PhysicsError, match="joystick"):
        on_flat.chair.command(Joystick(math.inf, 0.0))
    with pytest.raises(ConfigError, match="rwd"):
        Wheelchair(on_flat.engine, ChairConfig(plant="hover"), ImuConfig(), seat=1)
