"""Who could move is put together from pixels, and followed from tick to tick."""

import numpy as np
import pytest

from wcsim.agents.perception.clusters import (
    FEWEST_PX,
    LEAST_X,
    LEAST_Y,
    MOST_X,
    MOST_Y,
    PIXELS,
    WALKERS,
    X,
    Y,
    find_movable_clusters,
    make_class_mobility_table,
    mask_points_near_cells,
)
from wcsim.agents.perception.depth_image import CameraView
from wcsim.agents.perception.tracker import MoverTracker
from wcsim.config import CameraConfig
from wcsim.types import ClassId

FRONT = CameraConfig(width_px=80, height_px=60)
REAR = FRONT.model_copy(update={"yaw_deg": 180.0, "p_BC_m": (-0.3, 0.0, 1.0)})
UP = np.array([0.0, 0.0, 1.0])


def seen(*boxes, pose=(0.0, 0.0, 0.0), camera=FRONT):
    """Clusters and cells of upright boxes (class, x0, x1, y0, y1, height) in B on level ground, the nearest drawn."""
    view = CameraView(camera)
    depth = np.full(len(view.rays), 39.9)
    classes = np.full(len(view.rays), ClassId.BUILDING, np.uint8)
    for t in np.arange(12.0, 0.3, -0.02):
        x, y, z = (view.eye_B_m + view.rays * t).T
        for kind, x0, x1, y0, y1, height in boxes:
            hit = (x > x0) & (x < x1) & (y > y0) & (y < y1) & (z > 0.0) & (z < height)
            depth[hit], classes[hit] = t, kind
    picture = make_class_mobility_table()[classes].reshape(60, 80)
    view.depth_m = depth.astype(np.float32)
    return find_movable_clusters(picture, view, UP, np.array(pose, float))


def person(x, y, kind=ClassId.PERSON):
    return (kind, x, x + 0.3, y - 0.25, y + 0.25, 1.75)


def test_a_person_behind_is_a_cluster_of_the_rear_camera():
    (one,), cells, _ = seen(person(-4.3, 0.5), camera=REAR)
    assert (one[X], one[Y]) == pytest.approx((-4.0, 0.5), abs=0.2) and (cells[:, 0] < -3.5).all()
    assert not len(seen(person(-4.3, 0.5))[0])


def test_two_people_are_two_clusters_and_a_post_is_none():
    clusters, cells, owner = seen(person(3.0, -1.0), person(4.0, 1.5), (ClassId.POLE, 2.0, 2.2, 0.0, 0.2, 2.0))
    assert len(clusters) == 2
    by_side = clusters[np.argsort(clusters[:, Y])]
    assert by_side[:, [X, Y]] == pytest.approx(np.array([[3.0, -1.0], [4.0, 1.5]]), abs=0.15)
    assert (clusters[:, WALKERS] == clusters[:, PIXELS]).all()
    for number, one in enumerate(clusters):
        own = cells[owner == number]
        assert len(own) and np.abs(own - one[[X, Y]]).max() < 0.5
    assert mask_points_near_cells(np.array([[3.1, -1.1], [2.1, 0.1]]), cells).tolist() == [True, False]


def test_a_car_is_no_walker_and_a_pose_turns_places():
    (car,), _, _ = seen((ClassId.CAR, 3.0, 6.0, 0.5, 2.3, 1.5), pose=(10.0, 5.0, np.pi / 2))
    assert car[WALKERS] == 0
    assert 10.0 - 2.4 < car[LEAST_X] < car[MOST_X] < 10.0 - 0.4 and 8.0 - 0.1 < car[LEAST_Y] < car[MOST_Y] < 11.1


def test_a_class_that_is_painted_on_the_wall_behind_a_person_is_nobody():
    alone, _, _ = seen((ClassId.PERSON, 6.0, 6.2, -0.5, 0.5, 1.0))
    assert len(alone) == 1
    clusters, _, owner = seen(person(2.0, 0.0), (ClassId.PERSON, 6.0, 6.2, -0.9, 0.9, 1.0))
    assert len(clusters) == 1 and clusters[0, X] < 2.5 and (owner == -1).any()


def test_a_few_pixels_are_noise():
    clusters, _, _ = seen((ClassId.PERSON, 9.0, 9.2, 0.0, 0.2, 0.5))
    assert len(clusters) == 0 and FEWEST_PX > 1


def cluster(x, y, size=0.4, walks=True, length=None):
    one = np.zeros(11)
    half = 0.5 * (size if length is None else length)
    one[[X, Y]] = x, y
    one[[LEAST_X, MOST_X, LEAST_Y, MOST_Y]] = x - half, x + half, y - 0.5 * size, y + 0.5 * size
    one[[PIXELS, WALKERS]] = 40, 40 if walks else 0
    return one


def see(tracker, *places, **kind):
    """One tick in which clusters are seen at some places."""
    clusters = np.array([cluster(*at, **kind) for at in places]).reshape(-1, 11)
    tracker.update(clusters, [np.array([at]) for at in places])


def watched(ticks, *movers, noise_m=0.0, tracker=None):
    """A tracker that has seen movers (x, y, vx, vy) for some ticks."""
    tracker, rng = tracker or MoverTracker(0.1), np.random.default_rng(5)
    for tick in range(ticks):
        now = [np.array([x + vx * 0.1 * tick, y + vy * 0.1 * tick]) for x, y, vx, vy in movers]
        now = [at + rng.normal(0.0, noise_m, 2) if noise_m else at for at in now]
        see(tracker, *now)
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
        see(tracker)
    (track,) = tracker.movers
    assert track.p_O_m == pytest.approx([x, y - 1.0], abs=0.05) and track.moves
    assert track.cells_O_m[0] == pytest.approx(track.p_O_m, abs=0.1)
    for _ in range(10):
        see(tracker)
    assert tracker.movers == []


def test_a_long_thing_moves_when_both_its_ends_do():
    tracker = MoverTracker(0.1)
    for tick in range(15):
        front = 2.0 + 0.1 * tick * 2.0  # its rear is cut off by the border of the view
        see(tracker, (0.5 * front, 2.0), size=1.5, walks=False, length=front)
    assert np.hypot(*tracker.movers[0].v_O_mps) < 0.1  # one edge alone may be more of it
    for tick in range(15):
        see(tracker, (6.0 + 0.2 * tick, 2.0), size=1.5, walks=False, length=4.0)
    moving = [track for track in tracker.movers if track.moves]
    assert len(moving) == 1 and moving[0].v_O_mps == pytest.approx([2.0, 0.0], abs=0.2) and not moving[0].walks


@pytest.mark.parametrize("speed_mps", [8.5, 10.0, 13.9])
def test_a_car_as_fast_as_a_town_allows_is_known_to_rush(speed_mps):
    (track,) = watched(4, (5.0, -4.0, 0.0, speed_mps)).movers
    assert track.rushes and track.v_O_mps == pytest.approx([0.0, speed_mps], abs=0.1)
    tracker, told = MoverTracker(0.1), []
    for tick in range(round(90 / speed_mps)):
        rear = -4.0 + 0.1 * tick * speed_mps
        clusters, cells, owner = seen((ClassId.CAR, 5.0, 6.8, rear, rear + 4.3, 1.5))
        tracker.update(clusters, [cells[owner == number] for number in range(len(clusters))])
        told += [one.v_O_mps[1] for one in tracker.movers if one.rushes and one.unseen_s == 0.0]
    assert max(told) == pytest.approx(speed_mps, rel=0.25)  # of its ends one is often out of view


def test_people_who_pass_each_other_are_not_taken_for_one_who_rushes():
    side_by_side = [(3.0, 0.6 * place - 1.5, -1.0, 0.0) for place in range(6)]
    facing = [(0.5, 0.6 * place - 1.2, 1.0, 0.0) for place in range(5)]
    tracker = MoverTracker(0.1)
    for tick in range(20):
        see(tracker, *((x + vx * 0.1 * tick, y) for x, y, vx, _ in side_by_side + facing))
        assert not any(track.rushes for track in tracker.movers)
    assert len(tracker.movers) == 11
    assert sorted(round(float(track.v_O_mps[0]), 1) for track in tracker.movers) == [-1.0] * 6 + [1.0] * 5


@pytest.mark.parametrize("seen_share", [1.0, 0.9])
@pytest.mark.parametrize("gap_m", [0.5, 0.7, 1.0, 1.3])
def test_what_stands_in_a_row_stands_though_it_is_not_seen_each_time(gap_m, seen_share):
    rushing = 0
    for seed in range(8):
        rng, tracker = np.random.default_rng(seed), MoverTracker(0.1)
        for _ in range(30):
            now = [np.array([4.0, gap_m * place - 6.0]) for place in range(12) if rng.random() < seen_share]
            now = [at + rng.normal(0.0, 0.04, 2) for at in now]
            see(tracker, *now, walks=False)
            rushing += sum(track.rushes for track in tracker.movers)
    assert rushing == 0 or (seen_share < 1.0 and rushing / (8 * 30) < 0.5)  # of twelve; chance pairs, each for a second


def test_a_cluster_goes_to_its_own_track_and_not_to_that_of_a_larger_one_beside_it():
    tracker = MoverTracker(0.1)
    stands, comes = np.array([4.0, 0.0]), np.array([4.0, 0.9])
    see(tracker, stands)
    larger = cluster(*(comes - [0.0, 0.2]))
    larger[[PIXELS, WALKERS]] = 400, 400
    tracker.update(np.array([larger, cluster(*stands)]), [comes[None], stands[None]])
    assert [(track.hits, *track.p_O_m.round(1)) for track in tracker.movers] == [(2, 4.0, 0.0), (1, 4.0, 0.7)]


def test_who_is_far_from_where_another_was_is_one_who_rushes_only_when_the_next_look_says_so():
    tracker = MoverTracker(0.1)
    for at in ((4.0, 0.0), (4.0, 1.2), (4.0, 1.2)):
        see(tracker, at)
    (track,) = tracker.movers
    assert (track.hits, *track.v_O_mps) == (1, 0.0, 0.0)
