"""Who moves, and how: clusters of successive ticks in the odometric frame, nearest to nearest, an alpha-beta filter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wcsim.agents.perception.clusters import LEAST_X, LEAST_Y, MOST_X, MOST_Y, PIXELS, WALKERS, X, Y
from wcsim.types import F64, Bool

GATE_M = 0.8  # a cluster this far from where a track should be is another one
MOVES_MPS = 0.3  # slower is taken for standing
RUSHES_MPS = 1.6  # people on foot are slower, and step aside: where they are now is enough to know
_FASTEST_MPS = 15.0  # who is seen for the second time may have come as far as this since
_KEPT_S = 1.5  # a track that is not seen any more goes on for so long
_SURE_HITS = 3  # before that its speed is not known
_SMALL_M = (
    1.1  # what is smaller is seen whole, so its middle is a place; of a larger one only edges are
)
_ALPHA, _BETA = 0.4, 0.12  # of an old track; a young one learns faster


@dataclass(slots=True, kw_only=True)
class Mover:
    """One mover, in O."""

    p_O_m: F64  # (2,)
    v_O_mps: F64  # (2,)
    extent_O_m: F64  # (4,) least x, most x, least y, most y
    cells_O_m: F64  # (k, 2) its cells when it was seen last, moved on since
    walks: bool  # or rides; else it is a car, a bus
    hits: int = 1
    unseen_s: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether it surely moves."""
        return self.hits >= _SURE_HITS and MOVES_MPS < math.hypot(*self.v_O_mps) < _FASTEST_MPS

    @property
    def rushes(self) -> bool:
        """Whether it moves faster than those who make room for a chair."""
        return self.moves and math.hypot(*self.v_O_mps) > RUSHES_MPS


class Tracker:
    """The movers around one chair; `tick_s` is the time between two looks."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self.movers: list[Mover] = []

    def forget(self) -> None:
        """Know nobody."""
        self.movers = []

    def see(self, clusters: F64, cells_O_m: list[F64]) -> None:
        """Take in the clusters (m, 11) of a tick, see `clusters`, and the places of each one's cells (k, 2)."""
        for track in self.movers:
            _go_on(track, self._tick_s)
        known = list(self.movers)
        whose = _assign(known, clusters, max(GATE_M, _FASTEST_MPS * self._tick_s), self._tick_s)
        for index in np.argsort(-clusters[:, PIXELS], kind="stable").tolist():
            one, cells = clusters[index], cells_O_m[index]
            if index in whose:
                self._update(known[whose[index]], one, cells)
            else:
                self.movers.append(_new(one, cells))
        self.movers = [
            track
            for track in self.movers
            if track.unseen_s < _KEPT_S + 1e-9 and not self._chance(track)
        ]

    def _chance(self, track: Mover) -> bool:
        """Whether two places far apart, seen one after the other, were no track: the next look found nobody ahead."""
        far = math.hypot(*track.v_O_mps) * self._tick_s > GATE_M
        return far and track.hits < _SURE_HITS and track.unseen_s > 0.0

    def _update(self, track: Mover, one: F64, cells_O_m: F64) -> None:
        track.hits += 1
        track.unseen_s = 0.0
        n = track.hits
        alpha = max(_ALPHA, 2.0 * (2 * n - 1) / (n * (n + 1)))
        beta = max(_BETA, 6.0 / (n * (n + 1)))
        off_m = _innovation(track, one)
        track.p_O_m = track.p_O_m + alpha * off_m if _is_small(one) else one[[X, Y]].copy()
        track.v_O_mps = track.v_O_mps + beta / self._tick_s * off_m
        track.extent_O_m = one[[LEAST_X, MOST_X, LEAST_Y, MOST_Y]].copy()
        track.cells_O_m = cells_O_m
        track.walks = bool(_walks(one[None])[0])


def _assign(tracks: list[Mover], clusters: F64, reach_m: float, tick_s: float) -> dict[int, int]:
    """The number of each cluster's track, of those that are some track's: one each, the nearest first.

    Whoever is near where a track should be comes first. A track that was seen once, a tick ago, has no speed yet: what
    is then left over, of its kind and within `reach_m`, is taken for it.
    """
    if not tracks or not len(clusters):
        return {}
    places = np.array([track.p_O_m for track in tracks])
    away_m = np.hypot(
        places[:, None, 0] - clusters[None, :, X], places[:, None, 1] - clusters[None, :, Y]
    )
    whose = _nearest_first(away_m, GATE_M)
    away_m[list(whose.values())] = np.inf
    away_m[:, list(whose)] = np.inf
    newly = [track.hits == 1 and track.unseen_s < 1.5 * tick_s for track in tracks]
    kinds = np.array([track.walks for track in tracks])[:, None] == _walks(clusters)[None]
    away_m[~(np.array(newly)[:, None] & kinds)] = np.inf
    return whose | _nearest_first(away_m, reach_m)


def _nearest_first(away_m: F64, gate_m: float) -> dict[int, int]:
    """From column to row of a matrix of distances: pairs below `gate_m`, each row and column once."""
    rows, columns = np.nonzero(away_m < gate_m)
    taken: dict[int, int] = {}
    for pair in np.argsort(away_m[rows, columns], kind="stable").tolist():
        row, column = int(rows[pair]), int(columns[pair])
        if column not in taken and row not in taken.values():
            taken[column] = row
    return taken


def _walks(clusters: F64) -> Bool:
    """(m,) which clusters are mostly of those who walk or ride."""
    walking: Bool = 2.0 * clusters[:, WALKERS] > clusters[:, PIXELS]
    return walking


def _new(one: F64, cells_O_m: F64) -> Mover:
    extent = one[[LEAST_X, MOST_X, LEAST_Y, MOST_Y]].copy()
    walks = bool(_walks(one[None])[0])
    return Mover(
        p_O_m=one[[X, Y]].copy(),
        v_O_mps=np.zeros(2),
        extent_O_m=extent,
        cells_O_m=cells_O_m,
        walks=walks,
    )


def _go_on(track: Mover, dt_s: float) -> None:
    """Move a track on, with its speed however slow, to where it should be now."""
    track.unseen_s += dt_s
    move_m = track.v_O_mps * dt_s
    track.p_O_m = track.p_O_m + move_m
    track.extent_O_m = track.extent_O_m + np.repeat(move_m, 2)
    track.cells_O_m = track.cells_O_m + move_m


def _is_small(one: F64) -> bool:
    return bool(max(one[MOST_X] - one[LEAST_X], one[MOST_Y] - one[LEAST_Y]) < _SMALL_M)


def _innovation(track: Mover, one: F64) -> F64:
    """How far a cluster is from where its track should be, (2,): its middle, or the edge that is less off.

    Of a large thing more or less may be in view than before; an edge of the view does not move with it.
    """
    if _is_small(one):
        off: F64 = one[[X, Y]] - track.p_O_m
        return off
    edges = one[[LEAST_X, MOST_X, LEAST_Y, MOST_Y]] - track.extent_O_m
    pairs = edges.reshape(2, 2)
    least = np.where(np.abs(pairs[:, 0]) < np.abs(pairs[:, 1]), pairs[:, 0], pairs[:, 1])
    return np.where(pairs[:, 0] * pairs[:, 1] > 0.0, least, 0.0)
