"""Long vehicles bend: a tram, an articulated bus or a lorry with its trailer, in rigid pieces.

SUMO knows the front of a vehicle and one angle, that of the chord from its front to its rear. One
rigid box along that chord cuts a corner: a tram of 26 m in a curve of 20 m radius would sweep 4 m
over the pavement inside it. Here every joint lies on the way that the front has taken, so that
each piece is a chord of its own, at most 10 m long on rails.
"""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from wcsim.core import frames
from wcsim.types import F64, ActorKind, ActorLook, ActorState

_RIGID_M = {ActorKind.TRAM: 10.0, ActorKind.BUS: 15.5, ActorKind.TRUCK: 13.0}
"""The longest that is one rigid piece, by kind; other kinds never bend."""
_CARRIAGE_M = 27.0  # a railway carriage; what is longer than two trams is a train of these
_TRAIN_FROM_M = 60.0
_TRACTOR_SHARE = 0.36
_STEP_M = 0.2  # the way is stored in steps of this length
_JUMP_M = 6.0  # SUMO has teleported it: the way before is no way


def piece_lengths(kind: ActorKind, length_m: float) -> tuple[float, ...]:
    """Lengths of the rigid pieces from the front to the rear.

    >>> piece_lengths(ActorKind.TRAM, 26.0) == (26 / 3,) * 3
    True
    >>> piece_lengths(ActorKind.CAR, 26.0)
    (26.0,)
    """
    rigid_m = _RIGID_M.get(kind, math.inf)
    if length_m <= rigid_m:
        return (length_m,)
    if kind is ActorKind.TRUCK:
        tractor_m = min(_TRACTOR_SHARE * length_m, 7.0)
        rest_m = length_m - tractor_m
        count = math.ceil(rest_m / rigid_m)
        return (tractor_m, *(rest_m / count,) * count)
    count = math.ceil(length_m / (_CARRIAGE_M if length_m > _TRAIN_FROM_M else rigid_m))
    return (length_m / max(count, 2),) * max(count, 2)


class Articulation:
    """The ways of all long vehicles near a wheelchair."""

    def __init__(self) -> None:
        self._ways: dict[str, list[F64]] = {}  # by actor id: the front's places (3,), newest first

    def bent(self, actors: tuple[ActorState, ...]) -> tuple[ActorState, ...]:
        """The same actors, each long one as its pieces: the first has its id, the k-th id~k.

        A vehicle that was not near before is straight along SUMO's angle until it has moved on.
        """
        long = {a.id: a for a in actors if a.size_lwh_m[0] > _RIGID_M.get(a.kind, math.inf)}
        # Only of who is near: the way of one that was out of sight would have a gap in it.
        self._ways = {name: self._way(actor) for name, actor in sorted(long.items())}
        if not long:
            return actors
        return tuple(piece for a in actors for piece in (self._pieces(a) if a.id in long else (a,)))

    def _way(self, actor: ActorState) -> list[F64]:
        length_m = actor.size_lwh_m[0]
        front = frames.front_from_centre(actor.p_W_m, actor.yaw_rad, actor.pitch_rad, length_m)
        rear = front - (length_m + _STEP_M) * frames.forward_vector(actor.yaw_rad, actor.pitch_rad)
        way = self._ways.get(actor.id)
        if way is None or math.dist(front[:2], way[0][:2]) > _JUMP_M:
            return [front, front, rear]
        # The newest place moves until it is a step ahead.
        known = way if math.dist(front[:2], way[1][:2]) >= _STEP_M else way[1:]
        way = [front, *known]
        # What lies behind the rear is left out. An arc is longer than its chord.
        needed_m, way_m = 0.5 * math.pi * length_m + 2 * _STEP_M, 0.0
        for i, (a, b) in enumerate(pairwise(way)):
            way_m += math.dist(a, b)
            if way_m > needed_m:
                return way[: i + 2]
        return way

    def _pieces(self, actor: ActorState) -> tuple[ActorState, ...]:
        lengths = piece_lengths(actor.kind, actor.size_lwh_m[0])
        way = self._ways[actor.id]
        # A joint after each length, straight from joint to joint, as the pieces are rigid.
        joints, at = [way[0]], 0
        for length in lengths:
            at, place = _reach(way, at, joints[-1], length)
            joints.append(place)
        _, width_m, height_m = actor.size_lwh_m
        speed_mps = float(np.linalg.norm(actor.v_W_mps))
        pieces = []
        for k, (head, tail) in enumerate(pairwise(joints)):
            x, y, z = head - tail
            flat = math.hypot(x, y)
            yaw, pitch = actor.yaw_rad, actor.pitch_rad
            # A piece that stands upright has no direction of its own.
            if flat >= 1e-6:
                yaw, pitch = math.atan2(y, x), math.atan2(z, flat)
            look = ActorLook.REAR if k == len(lengths) - 1 else ActorLook.MIDDLE
            pieces.append(
                replace(
                    actor,
                    id=actor.id if k == 0 else f"{actor.id}~{k}",
                    p_W_m=0.5 * (head + tail),
                    yaw_rad=yaw,
                    pitch_rad=pitch,
                    v_W_mps=speed_mps * frames.forward_vector(yaw, pitch),
                    size_lwh_m=(lengths[k], width_m, height_m),
                    look=ActorLook.FRONT if k == 0 else look,
                    piece=k,
                )
            )
        return tuple(pieces)


def _reach(way: list[F64], first: int, start: F64, length: float) -> tuple[int, F64]:
    """Where the way, from segment `first` on, leaves the sphere of this radius around `start`."""
    for i in range(first, len(way) - 1):
        a, b = way[i], way[i + 1]
        if math.dist(b, start) < length:
            continue
        ab, sa = b - a, a - start
        p, q, r = float(ab @ ab), float(sa @ ab), float(sa @ sa) - length * length
        # The later of two solutions, where the way leaves the sphere. At a touch rounding may make
        # the root's argument negative.
        share = (-q + math.sqrt(max(q * q - p * r, 0.0))) / p if p > 0.0 else 0.0
        return i, a + min(max(share, 0.0), 1.0) * ab
    end = way[-1] - way[-2]
    end = end / max(float(np.linalg.norm(end)), 1e-9)
    # Straight on from the end of the way, until it is as far from the start as it must be.
    sa = way[-1] - start
    along = float(sa @ end)
    reach = -along + math.sqrt(max(along * along - float(sa @ sa) + length * length, 0.0))
    return len(way) - 2, way[-1] + max(reach, 0.0) * end
