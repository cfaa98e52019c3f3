"""How movers move: clusters of successive ticks, paired by distance; an alpha-beta filter in O."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.agents.perception.clusters import LEAST_X, LEAST_Y, MOST_X, MOST_Y, PIXELS, WALKERS, X, Y
from wcsim.types import F64, Bool

# A cluster this far from where a track should be is another one.
_GATE_M: Final = 0.8
_STANDING_MPS: Final = 0.3  # slower is taken for standing
# People on foot are slower, and step aside: for them the place of now is enough.
_RUSHING_MPS: Final = 1.6
# Bound of a mover's way between its first and second tick.
_FASTEST_MPS: Final = 15.0
_LOST_S: Final = 1.5  # a track goes on for so long without being seen
_SURE_HITS: Final = 3  # before that its speed is not known
# A smaller cluster is seen whole, so its middle is a place; of a larger one only edges are.
_SMALL_M: Final = 1.1
# Gains for an old track; a young one learns faster.
_ALPHA: Final = 0.4
_BETA: Final = 0.12
_EXTENT: Final = [LEAST_X, MOST_X, LEAST_Y, MOST_Y]


@dataclass(slots=True, kw_only=True)
class TrackedMover:
    """One mover, in O."""

    p_O_m: F64  # (2,)
    v_O_mps: F64  # (2,)
    extent_O_m: F64  # (4,) least x, most x, least y, most y
    cells_O_m: F64  # (k, 2) its cells when it was seen last, moved on since
    walks: bool  # or rides; else it is a vehicle
    hits: int = 1
    unseen_s: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether it surely moves."""
        speed_mps = math.hypot(*self.v_O_mps)
        return self.hits >= _SURE_HITS and _STANDING_MPS < speed_mps < _FASTEST_MPS

    @property
    def rushes(self) -> bool:
        """Whether it moves faster than people who make room for a chair."""
        return self.moves and math.hypot(*self.v_O_mps) > _RUSHING_MPS


class MoverTracker:
    """The movers around one chair; `tick_s` is the time between two looks."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self.movers: list[TrackedMover] = []

    def forget(self) -> None:
        """Know no mover."""
        self.movers = []

    def update(self, clusters: F64, cells_O_m: list[F64]) -> None:
        """Take the clusters (m, 11) of a tick, see `clusters`, and the cells (k, 2) of each."""
        # 1. Predict, with each track's speed however slow.
        for track in self.movers:
            move_m = track.v_O_mps * self._tick_s
            track.unseen_s += self._tick_s
            track.p_O_m = track.p_O_m + move_m
            track.extent_O_m = track.extent_O_m + np.repeat(move_m, 2)
            track.cells_O_m = track.cells_O_m + move_m
        # 2. Correct the tracks that are seen, and start new ones, the largest first.
        known = list(self.movers)
        reach_m = max(_GATE_M, _FASTEST_MPS * self._tick_s)
        track_of = _assign(known, clusters, reach_m, self._tick_s)
        for index in np.argsort(-clusters[:, PIXELS], kind="stable").tolist():
            one, cells = clusters[index], cells_O_m[index]
            if index in track_of:
                self._correct(known[track_of[index]], one, cells)
            else:
                self.movers.append(
                    TrackedMover(
                        p_O_m=one[[X, Y]].copy(),
                        v_O_mps=np.zeros(2),
                        extent_O_m=one[_EXTENT].copy(),
                        cells_O_m=cells,
                        walks=bool(_walks(one[None])[0]),
                    )
                )
        # 3. Drop the lost ones.
        self.movers = [
            track
            for track in self.movers
            if track.unseen_s < _LOST_S + 1e-9 and not self._is_chance(track)
        ]

    def _is_chance(self, track: TrackedMover) -> bool:
        """Whether its two places far apart were no track, as the next tick shows none ahead."""
        far = math.hypot(*track.v_O_mps) * self._tick_s > _GATE_M
        return far and track.hits < _SURE_HITS and track.unseen_s > 0.0

    def _correct(self, track: TrackedMover, one: F64, cells_O_m: F64) -> None:
        """One step of the filter, with the gains of a least-squares line through the first hits."""
        track.hits += 1
        track.unseen_s = 0.0
        n = track.hits
        alpha = max(_ALPHA, 2.0 * (2 * n - 1) / (n * (n + 1)))
        beta = max(_BETA, 6.0 / (n * (n + 1)))
        off_m = _innovation(track, one)
        track.p_O_m = track.p_O_m + alpha * off_m if _is_small(one) else one[[X, Y]].copy()
        track.v_O_mps = track.v_O_mps + beta / self._tick_s * off_m
        track.extent_O_m = one[_EXTENT].copy()
        track.cells_O_m = cells_O_m
        track.walks = bool(_walks(one[None])[0])


def _assign(
    tracks: list[TrackedMover], clusters: F64, reach_m: float, tick_s: float
) -> dict[int, int]:
    """From a cluster's number to its track's, each at most once, the nearest pairs first.

    A cluster near where a track should be goes first. A track that was seen once, a tick ago, has
    no speed yet: it gets what is left over of its kind within `reach_m`.
    """
    if not tracks or not len(clusters):
        return {}
    places = np.array([track.p_O_m for track in tracks])
    away_m = np.hypot(
        places[:, None, 0] - clusters[None, :, X], places[:, None, 1] - clusters[None, :, Y]
    )
    track_of = _nearest_first(away_m, _GATE_M)
    away_m[list(track_of.values())] = np.inf
    away_m[:, list(track_of)] = np.inf
    newly = [track.hits == 1 and track.unseen_s < 1.5 * tick_s for track in tracks]
    kinds = np.array([track.walks for track in tracks])[:, None] == _walks(clusters)[None]
    away_m[~(np.array(newly)[:, None] & kinds)] = np.inf
    return track_of | _nearest_first(away_m, reach_m)


def _nearest_first(away_m: F64, gate_m: float) -> dict[int, int]:
    """From column to row of a matrix of distances, each at most once, below `gate_m`."""
    rows, columns = np.nonzero(away_m < gate_m)
    taken: dict[int, int] = {}
    for pair in np.argsort(away_m[rows, columns], kind="stable").tolist():
        row, column = int(rows[pair]), int(columns[pair])
        if column not in taken and row not in taken.values():
            taken[column] = row
    return taken


def _walks(clusters: F64) -> Bool:
    """(m,) which clusters are mostly people who walk or ride."""
    return 2.0 * clusters[:, WALKERS] > clusters[:, PIXELS]


def _is_small(one: F64) -> bool:
    return bool(max(one[MOST_X] - one[LEAST_X], one[MOST_Y] - one[LEAST_Y]) < _SMALL_M)


def _innovation(track: TrackedMover, one: F64) -> F64:
    """How far a cluster is from where its track should be, (2,): its middle, or the nearer edge.

    More or less of a large thing may be in view than before; an edge of the view does not move
    with it.
    """
    if _is_small(one):
        return one[[X, Y]] - track.p_O_m
    pairs = (one[_EXTENT] - track.extent_O_m).reshape(2, 2)
    least = np.where(np.abs(pairs[:, 0]) < np.abs(pairs[:, 1]), pairs[:, 0], pairs[:, 1])
    return np.where(pairs[:, 0] * pairs[:, 1] > 0.0, least, 0.0)
