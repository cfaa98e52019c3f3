"""The cache of built streets: one .npz file for each state of a town, written whole or not at all.

A street is stored as named arrays. Its file is read by position, so that copies of a process
(`os.fork`) do not move each other's place in it.
"""

import io
import os
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from wcsim.core.files import hold_file_lock, write_file_atomically
from wcsim.errors import DiskFullError
from wcsim.towns.cache.folder import cache_folder
from wcsim.towns.ground.tiles import Packed, TileStore
from wcsim.types import Relief, SignalHead, Street, WalkEdge, WalkGraph, WayKind
from wcsim.types.street import FLAT


def pack_street(
    tiles: Packed,
    walk: WalkGraph,
    relief: Relief,
    signal_heads: tuple[SignalHead, ...],
    net_origin_m: tuple[float, float, float],
) -> dict[str, np.ndarray]:
    """A street as named arrays; `tiles` are those of `pack_tiles`."""
    edges = walk.edges
    texts = [
        (edge.sumo_id, edge.kind.value, edge.tls_id, " ".join(map(str, edge.tls_links)))
        for edge in edges
    ]
    places = [(*head.p_W_m, head.yaw_rad, head.link, head.pedestrian) for head in signal_heads]
    return {
        **tiles,
        "relief_z_m": relief.z_m,
        "relief_place": np.array([*relief.origin_W_m, relief.cell_m]),
        "net_origin_m": np.array(net_origin_m, np.float64),
        "nodes_W_m": walk.nodes_W_m,
        "edge_points_W_m": np.concatenate(
            [edge.points_W_m for edge in edges] or [np.zeros((0, 2))]
        ),
        "edge_sizes": np.array([len(edge.points_W_m) for edge in edges], np.int64),
        "edge_numbers": np.array(
            [(edge.start, edge.end) for edge in edges], dtype=np.int64
        ).reshape(-1, 2),
        "edge_width_m": np.array([edge.width_m for edge in edges], np.float64),
        "edge_never_green": np.array([edge.never_green for edge in edges], np.bool_),
        "edge_texts": np.array(texts, np.str_).reshape(-1, 4),
        "head_tls": np.array([head.tls_id for head in signal_heads], np.str_),
        "head_places": np.array(places, np.float64).reshape(-1, 6),
    }


def unpack_street(packed: Packed) -> Street:
    """The inverse of `pack_street`. Raises KeyError or ValueError for arrays that are none."""
    (x_m, y_m, cell_m), (east_m, north_m, up_m) = (
        packed["relief_place"].tolist(),
        packed["net_origin_m"].tolist(),
    )
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
    edges = tuple(
        WalkEdge(
            sumo_id=sumo_id,
            kind=WayKind(kind),
            start=start,
            end=end,
            points_W_m=way,
            width_m=width_m,
            tls_id=tls_id,
            tls_links=tuple(map(int, links.split())),
            never_green=never_green,
        )
        for way, (start, end), width_m, (sumo_id, kind, tls_id, links), never_green in rows
    )
    heads = zip(packed["head_tls"].tolist(), packed["head_places"].tolist(), strict=True)
    return Street(
        tiles=store,
        grid=store,
        walk=WalkGraph(nodes_W_m=packed["nodes_W_m"], edges=edges),
        signal_heads=tuple(
            SignalHead(
                tls_id=name,
                link=int(link),
                p_W_m=np.array([x, y, z]),
                yaw_rad=yaw,
                pedestrian=bool(walks),
            )
            for name, (x, y, z, yaw, link, walks) in heads
        ),
        net_origin_m=(east_m, north_m, up_m),
    )


class _PreadFile(io.RawIOBase):
    """An open file for reading, at a place of its own: a descriptor's is shared by all copies."""

    def __init__(self, path: Path) -> None:
        """Raises OSError when it cannot be opened."""
        super().__init__()
        self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        self._size = os.fstat(self._fd).st_size
        self._at = 0

    def readable(self) -> bool:
        """It is."""
        return True

    def seekable(self) -> bool:
        """It is."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the place; returns it. Raises ValueError for one before the beginning."""
        at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        if at < 0:
            raise ValueError(f"place {at} in a file; expected 0 or more")
        self._at = at
        return at

    # In typeshed it takes any writable buffer.
    def readinto(self, buffer: bytearray | memoryview) -> int:  # type: ignore[override]
        """Read what fits, from the place on; 0 at the end."""
        count = os.preadv(self._fd, [buffer], self._at)
        self._at += count
        return count

    def close(self) -> None:
        """Give the file back; a second call does nothing."""
        if not self.closed:
            os.close(self._fd)
        super().close()


def cached_street(key: str, build: Callable[[], Packed]) -> Street:
    """The street cached under `key`, or a new one, which is cached where that is possible."""
    path = cache_folder() / f"street-{key}.npz"
    found = _read(path)
    if found is not None:
        return found
    # Worlds that start together build it once: another process may have done so meanwhile.
    with hold_file_lock(path.with_suffix(".lock")):
        found = _read(path)
        if found is not None:
            return found
        packed = build()
        with suppress(DiskFullError), write_file_atomically(path) as part:
            np.savez(part, allow_pickle=False, **packed)
    # It is read from the file, if there is one, so that only what is used is in memory.
    return _read(path) or unpack_street(packed)


def _read(path: Path) -> Street | None:
    """A street over an open file, from which its tiles are read later."""
    try:
        if not zipfile.is_zipfile(path):
            return None
        data = np.load(_PreadFile(path), allow_pickle=False)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    try:
        return unpack_street(data)
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
        data.close()
        return None
