import math

import numpy as np
import pytest

from tests.agents.driven import driven
from tests.agents.toy import ToyStreet, camera_rays, toy_camera
from tests.support.samples import ACTIONS, USUAL_OUTLINE
from wcsim.agents.perception.depth_image import viewing_rays
from wcsim.agents.policies.baselines import _CorridorWatch, _in_corridor, make_baseline_policy
from wcsim.agents.policy_api import BASELINES, UPPER_BOUND, VISIBLE_BOUND, SeesTruth
from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.config import CameraConfig, ChairConfig, RunConfig
from wcsim.errors import PolicyError
from wcsim.supervisor.observation import encode_depth
from wcsim.types import Joystick, Truth, Verdict

CAMERA = CameraConfig(width_px=80, height_px=60)
CONFIG = RunConfig(cameras=(CAMERA,))
WATCH = _CorridorWatch(CAMERA, ChairConfig(), USUAL_OUTLINE)
FORWARD = (0.0, 1.0)


def looking_at(surface, pitch_rad=0.0, camera=CAMERA):
    """Observation of `surface(x, y, z) -> solid`, by marching along each ray in 1 cm steps."""
    rays, eye = viewing_rays(camera), np.array(camera.p_BC_m)
    depth = np.full(len(rays), camera.range_m)
    open_rays = np.ones(len(rays), bool)
    for t in np.arange(0.1, 12.0, 0.01):
        p = eye + rays * t
        hit = open_rays & surface(*p.T)
        depth[hit], open_rays = t, open_rays & ~hit
    imu = np.array([0, 0, 0.25, 0, pitch_rad / (math.pi / 2)], np.float32)
    code = encode_depth(depth.astype(np.float32).reshape(camera.height_px, camera.width_px), camera.range_m)
    return {"depth": code[None], "imu": imu, "seg": np.zeros_like(code[None]), "joystick": np.zeros(2, np.float32)}


def ground(x, y, z):
    return z <= 0.0


def drop(x_m, depth_m):
    """A floor that ends in a step down across the way."""
    return lambda x, y, z: z <= np.where(x < x_m, 0.0, -depth_m)


def ramp(x_m, run, rise_m):
    """A ramp of one in `run` across the way, up or down by `rise_m`."""
    return lambda x, y, z: z <= np.sign(rise_m) * np.clip((x - x_m) / run, 0, abs(rise_m))


def box(x0, x1, y0, y1, z0, z1):
    return lambda x, y, z: ground(x, y, z) | ((x > x0) & (x < x1) & (y > y0) & (y < y1) & (z > z0) & (z < z1))


WALL = box(2.0, 3.0, -3, 3, 0, 3)


@pytest.mark.parametrize(
    "name, surface, blocked",
    [
        ("level ground", ground, False),
        ("a wall near", WALL, True),
        ("a wall far", box(6.0, 7.0, -3, 3, 0, 3), False),
        ("a post in the way", box(1.6, 1.8, -0.1, 0.1, 0, 1.0), True),
        ("a post beside the way", box(1.6, 1.8, 0.7, 0.9, 0, 1.0), False),
        ("a branch above", box(1.4, 2.0, -1, 1, 1.7, 1.9), False),
        ("a low thing that casters climb", box(1.6, 1.8, -0.5, 0.5, 0, 0.06), False),
        ("a bench", box(1.6, 2.0, -1, 1, 0.4, 0.5), True),
        ("a ramp up 1:12", ramp(1.0, 12, 0.15), False),
        ("a ramp down 1:12", ramp(1.0, 12, -0.15), False),
        ("steps down", drop(1.5, 0.6), True),
        ("a platform's edge", drop(1.8, 20.0), True),
        ("an edge beside the way", lambda x, y, z: z <= np.where(y < 0.7, 0.0, -20.0), False),
    ],
)
def test_what_blocks_the_way(name, surface, blocked):
    assert WATCH.blocked(looking_at(surface), *FORWARD) == blocked, name


def test_a_slope_under_the_chair_is_level_for_it():
    slope = math.radians(5)  # the body frame tilts with the chair, so the ground stays at z = 0 in it
    assert not WATCH.blocked(looking_at(ground, pitch_rad=slope), *FORWARD)
    # On the crest of the slope the ground ahead is level in the world and falls away in the body frame.
    crest = lambda x, y, z: z <= np.where(x < 0.8, 0.0, -(x - 0.8) * math.tan(slope))  # noqa: E731
    assert not WATCH.blocked(looking_at(crest, pitch_rad=slope), *FORWARD)


def test_slower_means_a_shorter_look_ahead():
    view = looking_at(WALL)
    assert WATCH.blocked(view, 0.0, 1.0)
    assert not WATCH.blocked(view, 0.0, 0.25)


def test_the_corridor_bends_with_the_joystick():
    left = looking_at(box(1.1, 1.4, 0.75, 1.1, 0, 1.2))
    assert WATCH.blocked(left, -0.6, 0.8)
    assert not WATCH.blocked(left, 0.0, 0.8)
    assert not WATCH.blocked(left, 0.6, 0.8)


def test_corridor_is_mirror_symmetric():
    g = np.random.default_rng(0)
    points = np.c_[g.uniform(-1, 5, 500), g.uniform(-3, 3, 500), np.zeros(500)]
    mirrored = points * [1, -1, 1]
    for turn in (0.0, 0.3, 1.5):
        left, right = ((points, turn), (mirrored, -turn))
        assert np.array_equal(*(_in_corridor(p, 1.0, w, 2.5, USUAL_OUTLINE) for p, w in (left, right)))


def test_two_derivations_of_the_viewing_rays_agree():
    assert np.allclose(viewing_rays(toy_camera()), camera_rays(toy_camera()))
    turned = viewing_rays(CameraConfig(width_px=80, height_px=60, yaw_deg=90.0, pitch_deg=0.0))
    assert np.allclose(turned.mean(axis=0), [0, 1, 0], atol=1e-9)


@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_drives(name):
    config = RunConfig(cameras=(toy_camera(),))
    policy = make_baseline_policy(name, config, seed=3)
    assert policy.name == name
    observation, _ = ToyStreet(toy_camera()).reset(seed=0)
    assert 0 <= policy.act(observation) < 81
    policy.reset()


def test_baselines_in_the_toy_street_rank_as_they_must():
    camera = toy_camera()
    config = RunConfig(cameras=(camera,), chair=ChairConfig(v_max_mps=1.6))
    rows = {
        name: driven(make_baseline_policy(name, config, seed=3), ToyStreet(camera, max_steps=200), 4, 200, seed=11)
        for name in BASELINES
    }
    assert rows["follow"].followed == pytest.approx(1.0)
    assert rows["follow"].crashes_own >= 3
    assert rows["stop"].crashes_own <= 1
    assert rows["stop"].speed_mps > 0.2
    assert rows["dwa"].crashes_own < rows["follow"].crashes_own  # the toy's chair is wider than the one it reckons with
    assert rows["dwa"].speed_mps > 0.2
    assert rows["dwa"].kpi1 < rows["zero"].kpi1
    assert rows["stop"].kpi1 < rows["zero"].kpi1
    assert rows["zero"].km == pytest.approx(0.0, abs=1e-6)
    assert rows["random"].kpi1 > 1.0


def test_random_is_seeded_and_stop_keeps_turning():
    randoms = [make_baseline_policy("random", CONFIG, seed=s) for s in (1, 1, 2)]
    drives = [[policy.act({}) for _ in range(9)] for policy in randoms]
    assert drives[0] == drives[1] != drives[2]
    view = looking_at(box(1.5, 3.0, -3, 3, 0, 3))
    for y, expected in ((0.8, (0.5, 0.0)), (-0.8, (0.5, -0.75))):
        action = make_baseline_policy("stop", CONFIG).act({**view, "joystick": np.array([0.5, y], np.float32)})
        assert tuple(ACTIONS.points[action]) == expected


def test_stop_warns_of_a_wall_that_it_sees_twice_and_of_none_that_flickers():
    ahead = {**looking_at(WALL), "joystick": np.array([0.0, 0.8], np.float32)}
    turning = {**ahead, "joystick": np.array([0.8, 0.0], np.float32)}
    policy, told = make_baseline_policy("stop", CONFIG), []
    for view in (ahead, turning, turning, ahead, ahead, turning, turning):
        policy.act(view)
        told.append(policy.warning)
    assert told == [False, False, False, False, True, False, False]
    for _ in range(2):
        policy.act(ahead)
    assert policy.warning
    policy.reset()
    assert not policy.warning


def test_an_unknown_baseline_is_refused():
    with pytest.raises(PolicyError, match="follow"):
        make_baseline_policy("expert", RunConfig())


def truth(first_s, **more):
    return Truth(intent=Joystick(0, 0), danger=True, first_s=first_s, clearance_m=1.0, progress_m=0.0, **more)


def test_the_oracle_takes_the_safe_action_nearest_to_the_stick():
    oracle = make_baseline_policy(UPPER_BOUND, CONFIG)
    assert isinstance(oracle, SeesTruth) and not isinstance(make_baseline_policy("dwa", CONFIG), SeesTruth)
    ahead = {"joystick": np.array([0.1, 0.9], np.float32)}

    def chosen(safe, first_s=1.0):
        oracle.see(truth(np.where(safe, np.inf, first_s)))
        return tuple(ACTIONS.points[oracle.act(ahead)])

    everything = np.ones(len(ACTIONS), bool)
    assert chosen(everything) == (0.0, 1.0)
    assert chosen(everything & (ACTIONS.points[:, 1] < 0.6)) == (0.0, 0.5)
    assert chosen(~everything) == (0.0, 0.0)  # all fail together: the gentlest
    backwards = 1.0 + (ACTIONS.points[:, 1] < -0.4)
    assert chosen(~everything, backwards) == (0.0, -0.5)  # those that fail last, gently
    assert chosen(~everything, np.where(np.arange(81) == 7, 1.05, 1.0)) == tuple(ACTIONS.points[7])
    with pytest.raises(PolicyError, match="see"):
        oracle.act(ahead)
    with pytest.raises(PolicyError, match=r"env\.truth"):
        oracle.see(None)


def test_the_oracle_that_sees_as_the_cameras_do_takes_its_own_part_of_the_truth():
    full, visible = (make_baseline_policy(name, CONFIG) for name in (UPPER_BOUND, VISIBLE_BOUND))
    assert isinstance(visible, SeesTruth) and parse_policy_name(VISIBLE_BOUND).kind == "baseline"
    assert (full.name, visible.name) == ("oracle", "oracle-visible")
    ahead = {"joystick": np.array([0.0, 1.0], np.float32)}
    everything, stand = np.full(81, np.inf), ACTIONS.nearest((0.0, 0.0))
    blocked = np.where(np.arange(81) == stand, np.inf, 1.0)  # by somebody whom no camera showed
    for oracle, chosen in ((full, stand), (visible, ACTIONS.nearest((0.0, 1.0)))):
        oracle.see(truth(blocked, visible=Verdict(danger=False, first_s=everything)))
        assert oracle.act(ahead) == chosen
    for nothing in (None, truth(blocked)):
        with pytest.raises(PolicyError, match=r"env\.truth_visible"):
            visible.see(nothing)
