"""The cache of built streets: one .npz file for each state of a town, written whole or not at all."""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import shapely
import zstandard

from wcsim.towns.town import Town, content_hash
from wcsim.types import F64, U8, Street, StreetGrid, StreetMesh, WalkEdge, WalkGraph, WayKind

FORMAT = 1  # raise it when the file's layout changes; how a street is built counts by the source text itself
_MESH = ("vertices_W_m", "faces", "face_class", "chunk_vertices", "chunk_faces")
_RASTERS = ("height_cm", "ground_class", "clearance_dm")


def cache_folder() -> Path:
    """Where wcsim keeps what it can make again: $XDG_CACHE_HOME/wcsim or ~/.cache/wcsim."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if base else Path.home() / ".cache") / "wcsim"


def street_key(town: Town) -> str:
    """Name of a town's state: its SUMO files and what town.toml says of its ground."""
    file = town.file
    ground = f"{FORMAT} {file.origin_m} {file.kerb_height_m} {file.lowered_kerb_m} {file.chair_ways}"
    versions = f"{shapely.__version__} {shapely.geos_version_string} {np.__version__} {cv2.__version__}"
    return hashlib.sha256(f"{content_hash(town)} {ground} {versions} {_source_digest()}".encode()).hexdigest()[:32]


def _source_digest() -> str:
    """SHA-256 over the code of this package: a street built by other code is another street."""
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()


def cached_street(key: str, build: Callable[[], Street]) -> Street:
    """The street kept under `key`, or a new one, which is kept where that is possible."""
    path = cache_folder() / f"street-{key}.npz"
    found = _read(path)
    if found is not None:
        return found
    street = build()
    write_whole(path, lambda file: _save(file, street))
    return street


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


def _save(path: Path, street: Street) -> None:
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **_arrays(street))


def _read(path: Path) -> Street | None:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            return _street(data)
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, zstandard.ZstdError):
        return None


def _arrays(street: Street) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {name: getattr(street.mesh, name) for name in _MESH}
    packer = zstandard.ZstdCompressor(level=1)
    for name in _RASTERS:
        arrays[name] = np.frombuffer(packer.compress(getattr(street.grid, name).tobytes()), np.uint8)
    grid, walk = street.grid, street.walk
    arrays["grid_shape"] = np.array(grid.height_cm.shape)
    arrays["grid_place"] = np.array([*grid.origin_W_m, grid.cell_m, grid.z_base_m])
    arrays["nodes_W_m"] = walk.nodes_W_m
    arrays["edge_points_W_m"] = np.concatenate([edge.points_W_m for edge in walk.edges] or [np.zeros((0, 2))])
    arrays["edge_sizes"] = np.array([len(edge.points_W_m) for edge in walk.edges], dtype=np.int64)
    arrays["edge_numbers"] = np.array([(edge.start, edge.end) for edge in walk.edges], dtype=np.int64).reshape(-1, 2)
    arrays["edge_width_m"] = np.array([edge.width_m for edge in walk.edges], dtype=np.float64)
    texts = [(edge.sumo_id, edge.kind.value, edge.tls_id, " ".join(map(str, edge.tls_links))) for edge in walk.edges]
    arrays["edge_texts"] = np.array(texts, dtype=np.str_).reshape(-1, 4)
    return arrays


def _street(data: np.lib.npyio.NpzFile) -> Street:
    shape = tuple(int(n) for n in data["grid_shape"])
    x_m, y_m, cell_m, z_base_m = (float(value) for value in data["grid_place"])
    rasters: dict[str, U8] = {}
    unpacker = zstandard.ZstdDecompressor()
    for name in _RASTERS:
        rasters[name] = np.frombuffer(unpacker.decompress(data[name].tobytes()), np.uint8).reshape(shape)
    grid = StreetGrid(origin_W_m=(x_m, y_m), cell_m=cell_m, z_base_m=z_base_m, **rasters)
    points = np.split(data["edge_points_W_m"], np.cumsum(data["edge_sizes"])[:-1])
    rows = zip(
        points, data["edge_numbers"].tolist(), data["edge_width_m"].tolist(), data["edge_texts"].tolist(), strict=False
    )
    edges = tuple(_edge(way, ends, width_m, texts) for way, ends, width_m, texts in rows)
    mesh = StreetMesh(**{name: data[name] for name in _MESH})
    return Street(mesh=mesh, grid=grid, walk=WalkGraph(nodes_W_m=data["nodes_W_m"], edges=edges))


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
