"""A street as named arrays, as the cache keeps it, and back."""

from __future__ import annotations

import numpy as np

from wcsim.towns.ground.tiles import Packed, TileStore
from wcsim.types import F64, Relief, SignalHead, Street, WalkEdge, WalkGraph, WayKind
from wcsim.types.street import FLAT


def pack_street(
    tiles: Packed,
    walk: WalkGraph,
    relief: Relief,
    signal_heads: tuple[SignalHead, ...],
    net_origin_m: tuple[float, float, float],
) -> dict[str, np.ndarray]:
    """A street as named arrays; `tiles` are those of `pack_tiles`."""
    arrays = dict(tiles)
    arrays["relief_z_m"] = relief.z_m
    arrays["relief_place"] = np.array([*relief.origin_W_m, relief.cell_m])
    arrays["net_origin_m"] = np.array(net_origin_m, np.float64)
    arrays["nodes_W_m"] = walk.nodes_W_m
    arrays["edge_points_W_m"] = np.concatenate([edge.points_W_m for edge in walk.edges] or [np.zeros((0, 2))])
    arrays["edge_sizes"] = np.array([len(edge.points_W_m) for edge in walk.edges], dtype=np.int64)
    arrays["edge_numbers"] = np.array([(edge.start, edge.end) for edge in walk.edges], dtype=np.int64).reshape(-1, 2)
    arrays["edge_width_m"] = np.array([edge.width_m for edge in walk.edges], dtype=np.float64)
    arrays["edge_never_green"] = np.array([edge.never_green for edge in walk.edges], dtype=np.bool_)
    texts = [(edge.sumo_id, edge.kind.value, edge.tls_id, " ".join(map(str, edge.tls_links))) for edge in walk.edges]
    arrays["edge_texts"] = np.array(texts, dtype=np.str_).reshape(-1, 4)
    arrays["head_tls"] = np.array([head.tls_id for head in signal_heads], dtype=np.str_)
    places = [(*head.p_W_m, head.yaw_rad, head.link, head.pedestrian) for head in signal_heads]
    arrays["head_places"] = np.array(places, dtype=np.float64).reshape(-1, 6)
    return arrays


def street_of(packed: Packed) -> Street:
    """The inverse of `pack_street`. Raises KeyError or ValueError for arrays that are none."""
    (x_m, y_m, cell_m), (east_m, north_m, up_m) = packed["relief_place"].tolist(), packed["net_origin_m"].tolist()
    relief = Relief(origin_W_m=(x_m, y_m), cell_m=cell_m, z_m=packed["relief_z_m"])
    store = TileStore(packed, FLAT if relief.flat else relief)
    points = np.split(packed["edge_points_W_m"], np.cumsum(packed["edge_sizes"])[:-1])
    rows = zip(
        points,
        packed["edge_numbers"].tolist(),
        packed["edge_width_m"].tolist(),
        packed["edge_texts"].tolist(),
        packed["edge_never_green"].tolist(),
        strict=False,
    )
    edges = tuple(_edge(*row) for row in rows)
    heads = zip(packed["head_tls"].tolist(), packed["head_places"].tolist(), strict=True)
    return Street(
        tiles=store,
        grid=store,
        walk=WalkGraph(nodes_W_m=packed["nodes_W_m"], edges=edges),
        signal_heads=tuple(_head(name, place) for name, place in heads),
        net_origin_m=(east_m, north_m, up_m),
    )


def _head(tls_id: str, place: list[float]) -> SignalHead:
    return SignalHead(
        tls_id=tls_id, link=int(place[4]), p_W_m=np.array(place[:3]), yaw_rad=place[3], pedestrian=bool(place[5])
    )


def _edge(way: F64, ends: list[int], width_m: float, texts: list[str], never_green: bool) -> WalkEdge:
    return WalkEdge(
        sumo_id=texts[0],
        kind=WayKind(texts[1]),
        start=ends[0],
        end=ends[1],
        points_W_m=way,
        width_m=width_m,
        tls_id=texts[2],
        tls_links=tuple(int(number) for number in texts[3].split()),
        never_green=never_green,
    )
