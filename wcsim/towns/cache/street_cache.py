"""The cache of built streets: one .npz file for each state of a town, written whole or not at all."""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import shapely

from wcsim.core.reading import shown
from wcsim.towns.ground.tiles import Packed, TileStore
from wcsim.towns.scenario.town import Town, content_hash
from wcsim.types import F64, Relief, SignalHead, Street, WalkEdge, WalkGraph, WayKind
from wcsim.types.street import FLAT

FORMAT = 2  # raise it when the file's layout changes; how a street is built counts by the source text itself


def cache_folder() -> Path:
    """Where wcsim keeps what it can make again: $XDG_CACHE_HOME/wcsim or ~/.cache/wcsim."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if base else Path.home() / ".cache") / "wcsim"


def shown_cache() -> str:
    """The cache's folder for a message, with ~ for the home."""
    folder, home = str(cache_folder()), str(Path.home())
    return shown(f"~{folder[len(home):]}" if folder.startswith(f"{home}/") else folder)


def street_key(town: Town) -> str:
    """Name of a town's state: its SUMO files and what town.toml says of its ground."""
    file = town.file
    ground = f"{FORMAT} {file.origin_m} {file.kerb_height_m} {file.lowered_kerb_m} {file.chair_ways}"
    versions = f"{shapely.__version__} {shapely.geos_version_string} {np.__version__} {cv2.__version__}"
    still = content_hash(replace(town, routes=()))  # traffic leaves the street as it is
    return hashlib.sha256(f"{still} {ground} {versions} {_source_digest()}".encode()).hexdigest()[:32]


def _source_digest() -> str:
    """SHA-256 over the code that makes a street and says what it is: built by other code it is another street."""
    here = Path(__file__).parents[1]
    beside = (here.parent / name for name in ("types/street.py", "core/jit.py", "core/constants.py"))
    sources = [*sorted(here.rglob("*.py")), *beside]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()


def cached_street(key: str, build: Callable[[], Packed]) -> Street:
    """The street kept under `key`, or a new one, which is kept where that is possible."""
    path = cache_folder() / f"street-{key}.npz"
    found = _read(path)
    if found is not None:
        return found
    packed = build()
    write_whole(path, lambda file: _save(file, packed))
    return _read(path) or street_of(packed)  # from the file, if there is one, so that only what is used is in memory


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a cache file under another name and move it into place; a cache that cannot be written is no error."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=path.suffix)
        os.close(handle)
        temporary = Path(name)
        try:
            write(temporary)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError:
        return


def _save(path: Path, packed: Packed) -> None:
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **packed)


def _read(path: Path) -> Street | None:
    """A street over an open file, from which its tiles are read later."""
    try:
        if not zipfile.is_zipfile(path):
            return None
        data = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    try:
        return street_of(data)
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
        data.close()
        return None


def pack_street(
    tiles: Packed, walk: WalkGraph, relief: Relief, signal_heads: tuple[SignalHead, ...], net_z_m: float = 0.0
) -> dict[str, np.ndarray]:
    """A street as named arrays; `tiles` are those of `pack_tiles`."""
    arrays = dict(tiles)
    arrays["relief_z_m"] = relief.z_m
    arrays["relief_place"] = np.array([*relief.origin_W_m, relief.cell_m])
    arrays["net_z_m"] = np.array(net_z_m)
    arrays["nodes_W_m"] = walk.nodes_W_m
    arrays["edge_points_W_m"] = np.concatenate([edge.points_W_m for edge in walk.edges] or [np.zeros((0, 2))])
    arrays["edge_sizes"] = np.array([len(edge.points_W_m) for edge in walk.edges], dtype=np.int64)
    arrays["edge_numbers"] = np.array([(edge.start, edge.end) for edge in walk.edges], dtype=np.int64).reshape(-1, 2)
    arrays["edge_width_m"] = np.array([edge.width_m for edge in walk.edges], dtype=np.float64)
    texts = [(edge.sumo_id, edge.kind.value, edge.tls_id, " ".join(map(str, edge.tls_links))) for edge in walk.edges]
    arrays["edge_texts"] = np.array(texts, dtype=np.str_).reshape(-1, 4)
    arrays["head_tls"] = np.array([head.tls_id for head in signal_heads], dtype=np.str_)
    places = [(*head.p_W_m, head.yaw_rad, head.link, head.pedestrian) for head in signal_heads]
    arrays["head_places"] = np.array(places, dtype=np.float64).reshape(-1, 6)
    return arrays


def street_of(packed: Packed) -> Street:
    """The inverse of `pack_street`. Raises KeyError or ValueError for arrays that are none."""
    x_m, y_m, cell_m = (float(value) for value in packed["relief_place"])
    relief = Relief(origin_W_m=(x_m, y_m), cell_m=cell_m, z_m=packed["relief_z_m"])
    store = TileStore(packed, FLAT if relief.flat else relief)
    points = np.split(packed["edge_points_W_m"], np.cumsum(packed["edge_sizes"])[:-1])
    rows = zip(
        points,
        packed["edge_numbers"].tolist(),
        packed["edge_width_m"].tolist(),
        packed["edge_texts"].tolist(),
        strict=False,
    )
    edges = tuple(_edge(way, ends, width_m, texts) for way, ends, width_m, texts in rows)
    heads = zip(packed["head_tls"].tolist(), packed["head_places"].tolist(), strict=True)
    return Street(
        tiles=store,
        grid=store,
        walk=WalkGraph(nodes_W_m=packed["nodes_W_m"], edges=edges),
        signal_heads=tuple(_head(name, place) for name, place in heads),
        net_z_m=float(packed["net_z_m"]),
    )


def _head(tls_id: str, place: list[float]) -> SignalHead:
    return SignalHead(
        tls_id=tls_id, link=int(place[4]), p_W_m=np.array(place[:3]), yaw_rad=place[3], pedestrian=bool(place[5])
    )


def _edge(way: F64, ends: list[int], width_m: float, texts: list[str]) -> WalkEdge:
    return WalkEdge(
        sumo_id=texts[0],
        kind=WayKind(texts[1]),
        start=ends[0],
        end=ends[1],
        points_W_m=way,
        width_m=width_m,
        tls_id=texts[2],
        tls_links=tuple(int(number) for number in texts[3].split()),
    )
