"""Who could move is put together from pixels, and followed from tick to tick."""

import numpy as np
import pytest

from wcsim.agents.policies.depth_check import viewing_rays
from wcsim.agents.policies.dynamic_window.clusters import (
    FEWEST_PX,
    LEAST_X,
    LEAST_Y,
    MOST_X,
    MOST_Y,
    PIXELS,
    WALKERS,
    beside_movers,
    find_clusters,
    kinds,
)
from wcsim.agents.policies.dynamic_window.clusters import X as AT_X
from wcsim.agents.policies.dynamic_window.clusters import Y as AT_Y
from wcsim.agents.policies.dynamic_window.tracker import Tracker
from wcsim.config import CameraConfig
from wcsim.types import ClassId

CAMERA = CameraConfig(width_px=80, height_px=60)
RAYS = np.ascontiguousarray(viewing_rays(CAMERA), np.float32)
EYE, UP = np.array(CAMERA.p_BC_m), np.array([0.0, 0.0, 1.0])


def seen(*boxes, pose=(0.0, 0.0, 0.0)):
    """Clusters and cells of upright boxes (class, x0, x1, y0, y1, height) in B on level ground, the nearest drawn."""
    depth = np.full(len(RAYS), 39.9)
    classes = np.full(len(RAYS), ClassId.BUILDING, np.uint8)
    for t in np.arange(12.0, 0.3, -0.02):
        x, y, z = (EYE + RAYS * t).T
        for kind, x0, x1, y0, y1, height in boxes:
            hit = (x > x0) & (x < x1) & (y > y0) & (y < y1) & (z > 0.0) & (z < height)
            depth[hit], classes[hit] = t, kind
    points, owner = np.empty((1024, 2)), np.empty(1024, np.int64)
    picture = kinds()[classes].reshape(60, 80)
    clusters, count = find_clusters(
        picture, depth.astype(np.float32), RAYS, EYE, 39.0, UP, np.array(pose, float), points, owner
    )
    return clusters, points[:count], owner[:count]


def person(x, y, kind=ClassId.PERSON):
    return (kind, x, x + 0.3, y - 0.25, y + 0.25, 1.75)


def test_two_people_are_two_clusters_and_a_post_is_none():
    clusters, cells, owner = seen(person(3.0, -1.0), person(4.0, 1.5), (ClassId.POLE, 2.0, 2.2, 0.0, 0.2, 2.0))
    assert len(clusters) == 2
    by_side = clusters[np.argsort(clusters[:, AT_Y])]
    assert by_side[:, [AT_X, AT_Y]] == pytest.approx(np.array([[3.0, -1.0], [4.0, 1.5]]), abs=0.15)
    assert (clusters[:, WALKERS] == clusters[:, PIXELS]).all()
    for number, one in enumerate(clusters):
        own = cells[owner == number]
        assert len(own) and np.abs(own - one[[AT_X, AT_Y]]).max() < 0.5
    assert beside_movers(np.array([[3.1, -1.1], [2.1, 0.1]]), cells).tolist() == [True, False]


def test_a_car_is_no_walker_and_a_pose_turns_places():
    (car,), _, _ = seen((ClassId.CAR, 3.0, 6.0, 0.5, 2.3, 1.5), pose=(10.0, 5.0, np.pi / 2))
    assert car[WALKERS] == 0
    assert 10.0 - 2.4 < car[LEAST_X] < car[MOST_X] < 10.0 - 0.4 and 8.0 - 0.1 < car[LEAST_Y] < car[MOST_Y] < 11.1


def test_a_class_that_is_painted_on_the_wall_behind_a_person_is_nobody():
    alone, _, _ = seen((ClassId.PERSON, 6.0, 6.2, -0.5, 0.5, 1.0))
    assert len(alone) == 1
    clusters, _, owner = seen(person(2.0, 0.0), (ClassId.PERSON, 6.0, 6.2, -0.9, 0.9, 1.0))
    assert len(clusters) == 1 and clusters[0, AT_X] < 2.5 and (owner == -1).any()


def test_a_few_pixels_are_noise():
    clusters, _, _ = seen((ClassId.PERSON, 9.0, 9.2, 0.0, 0.2, 0.5))
    assert len(clusters) == 0 and FEWEST_PX > 1


def cluster(x, y, size=0.4, walks=True, length=None):
    one = np.zeros(11)
    half = 0.5 * (size if length is None else length)
    one[[AT_X, AT_Y]] = x, y
    one[[LEAST_X, MOST_X, LEAST_Y, MOST_Y]] = x - half, x + half, y - 0.5 * size, y + 0.5 * size
    one[[PIXELS, WALKERS]] = 40, 40 if walks else 0
    return one


def watched(ticks, *movers, noise_m=0.0, tracker=None):
    """A tracker that has seen movers (x, y, vx, vy) for some ticks."""
    tracker, rng = tracker or Tracker(0.1), np.random.default_rng(5)
    for tick in range(ticks):
        now = [np.array([x + vx * 0.1 * tick, y + vy * 0.1 * tick]) for x, y, vx, vy in movers]
        now = [at + rng.normal(0.0, noise_m, 2) if noise_m else at for at in now]
        tracker.see(np.array([cluster(*at) for at in now]).reshape(-1, 11), [at[None] for at in now])
    return tracker


def test_a_walkers_speed_is_known_after_a_few_ticks_and_lasts_through_noise():
    (track,) = watched(4, (4.0, 0.5, -1.2, 0.3)).movers
    assert track.v_O_mps == pytest.approx([-1.2, 0.3], abs=0.05) and track.moves
    (noisy,) = watched(30, (4.0, 0.5, -1.2, 0.3), noise_m=0.04).movers
    assert noisy.v_O_mps == pytest.approx([-1.2, 0.3], abs=0.2)
    (stands,) = watched(30, (4.0, 0.5, 0.0, 0.0), noise_m=0.04).movers
    assert not stands.moves
    (young,) = watched(2, (4.0, 0.5, -1.2, 0.3)).movers
    assert not young.moves


def test_two_who_cross_each_others_way_keep_their_speeds():
    tracks = watched(10, (3.0, -1.0, 0.0, 1.2), (4.0, 1.0, 0.0, -1.2)).movers
    assert sorted(round(float(track.v_O_mps[1]), 1) for track in tracks) == [-1.2, 1.2]


def test_who_is_not_seen_any_more_goes_on_for_a_while():
    tracker = watched(10, (3.0, 1.0, 0.0, -1.0))
    x, y = tracker.movers[0].p_O_m
    for _ in range(10):
        tracker.see(np.zeros((0, 11)), [])
    (track,) = tracker.movers
    assert track.p_O_m == pytest.approx([x, y - 1.0], abs=0.05) and track.moves
    assert track.cells_O_m[0] == pytest.approx(track.p_O_m, abs=0.1)
    for _ in range(10):
        tracker.see(np.zeros((0, 11)), [])
    assert tracker.movers == []


def test_a_long_thing_moves_when_both_its_ends_do():
    tracker = Tracker(0.1)
    for tick in range(15):
        front = 2.0 + 0.1 * tick * 2.0  # its rear is cut off by the border of the view
        one = cluster(0.5 * front, 2.0, size=1.5, walks=False, length=front)
        tracker.see(one[None], [one[None, [AT_X, AT_Y]]])
    assert np.hypot(*tracker.movers[0].v_O_mps) < 0.1  # one edge alone may be more of it
    for tick in range(15):
        one = cluster(6.0 + 0.2 * tick, 2.0, size=1.5, walks=False, length=4.0)
        tracker.see(one[None], [one[None, [AT_X, AT_Y]]])
    moving = [track for track in tracker.movers if track.moves]
    assert len(moving) == 1 and moving[0].v_O_mps == pytest.approx([2.0, 0.0], abs=0.2) and not moving[0].walks
