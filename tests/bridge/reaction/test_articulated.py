"""Long vehicles follow their front in rigid pieces and don't cut corners."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.physics.rig import actor
from wcsim.bridge.reaction.articulated import Articulation, piece_lengths
from wcsim.core import frames
from wcsim.physics.renderer.instances import actor_instances
from wcsim.types import ActorKind, ActorLook, ActorState

RADIUS_M = 20.0
LENGTH_M = 26.0


def place(way_m: float) -> np.ndarray:
    """A track: 60 m east, then a left turn of 90 degrees, then north."""
    turn_m = 0.5 * math.pi * RADIUS_M
    if way_m < 60.0:
        return np.array([way_m, 0.0, 0.0])
    if way_m < 60.0 + turn_m:
        angle = (way_m - 60.0) / RADIUS_M
        return np.array([60.0 + RADIUS_M * math.sin(angle), RADIUS_M * (1.0 - math.cos(angle)), 0.0])
    return np.array([60.0 + RADIUS_M, RADIUS_M + way_m - 60.0 - turn_m, 0.0])


TRACK_M = np.array([place(way) for way in np.arange(0.0, 130.0, 0.05)])


def tram(way_m: float, speed: float = 5.0, kind=ActorKind.TRAM, length_m: float = LENGTH_M) -> ActorState:
    """As SUMO shows it: the angle is that of the chord from front to rear, the box lies behind the front."""
    front, rear = place(way_m), place(way_m - length_m)
    yaw = math.atan2(front[1] - rear[1], front[0] - rear[0])
    box = actor("v:tram", 0.0, 0.0, yaw, kind, (length_m, 2.4, 3.6))
    return replace(
        box,
        p_W_m=frames.front_from_centre(front, yaw, 0.0, -length_m),
        v_W_mps=speed * frames.forward_vector(yaw, 0.0),
    )


def beside_m(piece: ActorState) -> float:
    """How far the middle of a piece is from the track."""
    return float(np.linalg.norm(TRACK_M - piece.p_W_m, axis=1).min())


def test_a_tram_does_not_sweep_over_the_pavement_in_a_curve():
    bends, whole, pieces = Articulation(), 0.0, 0.0
    for way_m in np.arange(30.0, 125.0, 0.5):
        one = tram(way_m)
        whole = max(whole, beside_m(one))
        pieces = max(pieces, *(beside_m(piece) for piece in bends.bent((one,))))
    assert whole > 3.5, "one box cuts the corner by the height of a chord of 26 m"
    assert pieces < 0.55, "a chord of 8.7 m is 0.47 m high"


@given(st.floats(0.05, 1.4), st.sampled_from([ActorKind.TRAM, ActorKind.BUS, ActorKind.TRUCK]), st.floats(18.0, 60.0))
@example(1.0, ActorKind.BUS, 53.5)
@settings(max_examples=25)
def test_pieces_hang_together_and_the_first_has_sumo_s_front_and_id(step_m, kind, length_m):
    bends = Articulation()
    for way_m in np.arange(40.0, 40.0 + 80 * step_m, step_m):
        one = tram(way_m, kind=kind, length_m=length_m)
        pieces = bends.bent((one,))
    assert [piece.id for piece in pieces] == ["v:tram", *(f"v:tram~{k}" for k in range(1, len(pieces)))]
    assert [piece.piece for piece in pieces] == list(range(len(pieces)))
    assert sum(piece.size_lwh_m[0] for piece in pieces) == pytest.approx(length_m)
    ends = [place(way_m)]
    for piece in pieces:
        front = frames.front_from_centre(piece.p_W_m, piece.yaw_rad, piece.pitch_rad, piece.size_lwh_m[0])
        assert front == pytest.approx(ends[-1], abs=1e-6)
        ends.append(frames.front_from_centre(piece.p_W_m, piece.yaw_rad, piece.pitch_rad, -piece.size_lwh_m[0]))
    assert pieces[0].look is ActorLook.FRONT and pieces[-1].look is ActorLook.REAR
    assert len(set(actor_instances(pieces).colour_seed.tolist())) == 1, "all of one colour"


def test_the_same_tick_twice_is_the_same_picture():
    bends = Articulation()
    for way_m in np.arange(40.0, 80.0, 0.5):
        first = bends.bent((tram(way_m),))
    assert all(a == b for a, b in zip(first, bends.bent((tram(way_m),)), strict=True))


def test_short_ones_stay_as_they_are_and_a_teleported_one_is_straight_again():
    car = actor("v:car", 0.0, 0.0)
    bends = Articulation()
    assert bends.bent((car,)) == (car,)
    for way_m in np.arange(40.0, 75.0, 0.5):
        bends.bent((tram(way_m),))
    moved = replace(tram(70.0), p_W_m=np.array([500.0, 0.0, 0.0]))
    assert {round(piece.yaw_rad, 6) for piece in bends.bent((moved,))} == {round(moved.yaw_rad, 6)}
    bends.bent(())
    assert len({round(piece.yaw_rad, 6) for piece in bends.bent((tram(75.0),))}) == 1, "who left is forgotten"


def test_lengths_of_pieces():
    assert piece_lengths(ActorKind.BUS, 12.0) == (12.0,)
    assert piece_lengths(ActorKind.BUS, 18.0) == (9.0, 9.0)
    assert piece_lengths(ActorKind.TRUCK, 16.5) == pytest.approx((5.94, 10.56))
    assert len(piece_lengths(ActorKind.TRAM, 200.0)) == 8
    assert piece_lengths(ActorKind.OTHER, 70.0) == (70.0,)
