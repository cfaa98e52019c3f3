"""A way of a test is over a carriageway on its crossings alone, and has room to wait before each light."""

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from wcsim.agents.evaluation.suite.draw import _is_sound
from wcsim.types import ClassId, Outline, Route, WalkEdge, WalkGraph, WayKind

OUTLINE = Outline(length_m=1.1, width_m=0.6, height_m=1.4, middle_x_m=0.3)


def sound(pieces: Sequence[tuple[str, float, float]], roads: Sequence[tuple[float, float]]) -> bool:
    """A way along x of (light or "-" for pavement, start, end), over a ground with roads from x to x."""
    edges = tuple(
        WalkEdge(
            sumo_id=str(number),
            kind=WayKind.SIDEWALK if light == "-" else WayKind.CROSSING,
            start=number,
            end=number + 1,
            points_W_m=np.array([[start, 0.0], [end, 0.0]]),
            width_m=4.0,
            tls_id="" if light == "-" else light,
        )
        for number, (light, start, end) in enumerate(pieces)
    )
    xs = [start for _, start, _ in pieces] + [pieces[-1][2]]
    index = np.array([*range(len(edges)), len(edges) - 1], np.int32)
    route = Route(points_W_m=np.array([[x, 0.0] for x in xs]), arc_m=np.array(xs) - xs[0], edge_index=index)

    def class_here(x: float, _y: float) -> int:
        return ClassId.ROAD if any(start <= x <= end for start, end in roads) else ClassId.SIDEWALK

    street = SimpleNamespace(
        walk=WalkGraph(nodes_W_m=np.zeros((len(edges) + 1, 2)), edges=edges),
        grid=SimpleNamespace(class_here=class_here),
    )
    return _is_sound(street, route, OUTLINE)  # type: ignore[arg-type]


PLAIN = [("-", 0.0, 10.0), ("a", 10.0, 16.0), ("-", 16.0, 30.0)]


@pytest.mark.parametrize(
    "pieces, roads, expected",
    [
        (PLAIN, [(10.0, 16.0)], True),
        (PLAIN, [(9.3, 16.7)], True),  # kerbs that run aslant
        (PLAIN, [(8.0, 16.0)], False),
        (PLAIN, [(10.0, 16.0), (20.0, 22.0)], False),
        ([("-", 0.0, 30.0)], [(4.0, 8.0)], False),
        ([("-", 0.0, 5.0), ("a", 5.0, 9.0), ("-", 9.0, 10.3), ("b", 10.3, 14.0), ("-", 14.0, 20.0)], [], False),
        ([("-", 0.0, 5.0), ("a", 5.0, 9.0), ("-", 9.0, 10.6), ("b", 10.6, 14.0), ("-", 14.0, 20.0)], [], True),
        ([("-", 0.0, 5.0), ("a", 5.0, 9.0), ("-", 9.0, 9.2), ("", 9.2, 14.0), ("-", 14.0, 20.0)], [], True),
    ],
    ids=["plain", "aslant", "before-it", "beyond-it", "no-crossing", "short-refuge", "refuge", "no-light"],
)
def test_what_the_map_did_to_a_way_is_no_test_of_a_policy(pieces, roads, expected):
    assert sound(pieces, roads) is expected
