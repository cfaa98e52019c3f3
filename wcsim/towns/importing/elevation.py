"""Heights for a town: a GeoTIFF or a synthetic hill, so smooth that no street is too steep.

They are written into the net, from which SUMO and the street mesh take them: every point of every
shape lies on the land. netconvert can read heights itself, but only asks for them at the nodes of a
street: where it moves nodes together, or cuts streets at junctions, grades of 1:2 come out of
gentle hills. Here no piece of a net is steeper than the land.
"""

from __future__ import annotations

import logging
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import cv2
import numpy as np

from wcsim.core.reading import HEIGHTS, escape, read_bytes
from wcsim.core.seeding import make_rng
from wcsim.errors import TownError
from wcsim.towns.ground.relief import steepest_run
from wcsim.towns.osm.read import Box
from wcsim.towns.sumo.xml_io import read_root
from wcsim.types import F64

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

log = logging.getLogger("wcsim.towns")

CELL_M = 10.0
MARGIN_M = 400.0  # around the box: streets reach out of it, and smoothing needs neighbours
PIECE_M = 8.0  # the longest piece of a shape: between its ends the land is taken to be straight
_HIGHEST_M = 9000.0
# Of the smoothing, one after the other; what is still too steep is made lower.
_SIGMAS_M = (15.0, 30.0, 60.0)
_PROJ_PLACES = ("PROJ_LIB", "PROJ_DATA")
_DONE = "WCSIM_MAX_GRADE"  # tag of a file that this module wrote: it is taken as it is
_MAX_CELLS = 200_000_000
_MAX_OWN_CELLS = 10_000_000  # of a file that is taken as it is
_MAX_BLOCK_CELLS = 16_777_216  # 4096 x 4096: a block is unpacked whole for each of its cells
_MAX_BANDS = 8
_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_GRIDS = re.compile(r"(?i:grids|catalog|init|file)\s*=(?!\s*@?null\b)")
_EXPECTED = "expected a GeoTIFF of heights in metres with a coordinate system, as gdalwarp writes"


@dataclass(frozen=True, slots=True, kw_only=True)
class Heights:
    """Where the heights of a town come from; it is level when neither is given."""

    dem: Path | None = None  # GeoTIFF in any coordinate system
    hill_m: float = 0.0  # height of a synthetic hill
    max_grade: float = 0.12  # rise over run that no street exceeds


@dataclass(frozen=True, slots=True, kw_only=True)
class Dem:
    """Heights over an area."""

    height_m: F64  # (rows, cols), north first
    box: Box  # outer edges
    smooth: bool = False  # nothing is to be done to it

    @classmethod
    def hill(cls, height_m: float, box_m: Box, seed: int) -> Dem:
        """A made-up hill over a net's own metres, for a net that lies nowhere on the globe."""
        west, south, east, north = box_m
        shape = max(8, round((north - south) / CELL_M)), max(8, round((east - west) / CELL_M))
        return cls(height_m=_hill(height_m, shape, seed), box=box_m)

    def write(self, max_grade: float, path: Path) -> None:
        """Write the heights, gentle enough for a grade, as a GeoTIFF in longitude and latitude."""
        import rasterio
        from rasterio.transform import from_bounds

        rows, cols = self.height_m.shape
        profile = {
            "driver": "GTiff",
            "width": cols,
            "height": rows,
            "count": 1,
            "dtype": "float32",
            "crs": "EPSG:4326",
            "transform": from_bounds(*self.box, cols, rows),
            "compress": "deflate",
        }
        with _own_projections(), rasterio.open(path, "w", **profile) as file:
            file.write(self.height_m.astype(np.float32), 1)
            file.update_tags(**{_DONE: f"{max_grade:g}"})


def make_dem(relief: Heights, box: Box, seed: int) -> Dem | None:
    """The heights of a town and its surroundings, None for a level town. Raises TownError."""
    area = box.grown(MARGIN_M)
    if relief.dem is not None:
        return _read(relief.dem, area, relief.max_grade)
    if relief.hill_m == 0.0:
        return None
    return Dem(height_m=_hill(relief.hill_m, _shape(area), seed), box=area)


def lift_net(path: Path, dem: Dem, relief: Heights, *, on_globe: bool = True) -> Dem:
    """Write heights into a plain .net.xml, so smooth and low that no street is too steep.

    Args:
        path: The net.
        dem: The land.
        relief: How it is smoothed.
        on_globe: False where the land's box is in the net's own metres.

    Returns:
        The heights that were written.

    Raises:
        TownError: The net has no place on the globe, and needs one.
    """
    root = read_root(path)

    def places_of(points_m: F64) -> F64:
        return _globe_places(root, points_m, path) if on_globe else points_m

    # 1. Find the shapes, and where they lie on the land.
    found = [(element, _points(element)) for element in root.iter() if element.get("shape")]
    ends = np.cumsum([len(points_m) for _, points_m in found])
    places = places_of(np.concatenate([points_m for _, points_m in found]))
    runs_m = [np.hypot(*np.diff(points_m, axis=0).T) for _, points_m in found]
    driven = [element.tag == "lane" for element, _ in found]

    def steepest(land: Dem) -> float:
        return steepest_run(np.split(_heights_at(land, places), ends[:-1]), runs_m, driven)

    # 2. Make the land gentle. A hill is as high as ordered where the streets are.
    if relief.dem is None:
        height_m = float(np.ptp(_heights_at(_smoothed(dem, _SIGMAS_M[0]), places)))
        dem = _scaled(dem, relief.hill_m / max(height_m, 1e-3 * relief.hill_m))
    gentle = _gentle(dem, relief, steepest)
    # It is as a file holds it, so that a town made from the file is the same.
    rounded_m = np.round(gentle.height_m, 3).astype(np.float32)
    used = replace(gentle, height_m=rounded_m.astype(np.float64))
    # 3. Write the heights, of the shapes and of the junctions.
    heights_m = np.split(_heights_at(used, places), ends[:-1])
    for (element, points_m), z_m in zip(found, heights_m, strict=True):
        rows = np.column_stack([points_m, z_m]).tolist()
        element.set("shape", " ".join(f"{x:.2f},{y:.2f},{z:.3f}" for x, y, z in rows))
    junctions = [element for element in root.iterfind("junction")]
    middles_m = np.array(
        [[float(element.get("x", "0")), float(element.get("y", "0"))] for element in junctions]
    )
    levels_m = _heights_at(used, places_of(middles_m)).tolist()
    for element, z_m in zip(junctions, levels_m, strict=True):
        element.set("z", f"{z_m:.3f}")
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return used


def _read(path: Path, area: Box, max_grade: float) -> Dem:
    import rasterio
    from rasterio.transform import from_bounds
    from rasterio.warp import Resampling, reproject, transform_bounds

    shape = _shape(area)
    found = np.full(shape, np.nan, np.float32)
    try:
        with _own_projections(), _quiet(), _opened(path) as file:
            _require_usable(path, file)
            own = _read_own(path, file, area, max_grade)
            if own is not None:
                return own
            place = transform_bounds(file.crs, "EPSG:4326", *file.bounds)
            reproject(
                rasterio.band(file, 1),
                found,
                dst_transform=from_bounds(*area, shape[1], shape[0]),
                dst_crs="EPSG:4326",
                dst_nodata=np.nan,
                resampling=Resampling.bilinear,
            )
    except TownError:
        raise
    except Exception as error:  # GDAL's errors have no base in common
        why = escape(" ".join(str(error).split()), 300)
        raise TownError(f"--dem {path}: cannot be read ({why}); {_EXPECTED}") from None
    is_height = np.isfinite(found) & (np.abs(found) < _HIGHEST_M)
    height_m = np.where(is_height, found, np.nan).astype(np.float64)
    known = float(np.isfinite(height_m).mean())
    if known < 0.5:
        raise TownError(
            f"--dem {path}: has heights for {known:.0%} of the area; it covers {_box_text(place)}, "
            f"the town needs {_box_text(area)}: use a file that covers the town"
        )
    return Dem(height_m=_filled(height_m), box=area)


@contextmanager
def _own_projections() -> Iterator[None]:
    """Let rasterio find its own coordinate systems.

    libsumo, once loaded, points the process to SUMO's older ones.
    """
    from rasterio.env import PROJDataFinder

    found = PROJDataFinder().search_wheel()
    own = {name: os.environ[name] for name in _PROJ_PLACES if name in os.environ}
    os.environ.update(dict.fromkeys(own, found) if found else {})
    try:
        yield
    finally:
        os.environ.update(own)


@contextmanager
def _quiet() -> Iterator[None]:
    """Let nothing be printed of a broken file but the one error.

    GDAL quotes its bytes, which may be no text.
    """
    unraisable, raised = sys.unraisablehook, sys.excepthook
    # It is called where rasterio cannot put such words into its log.
    sys.unraisablehook = lambda _: None
    sys.excepthook = lambda *_: None
    try:
        with warnings.catch_warnings():
            # They are of files without a place, which `_require_usable` refuses.
            warnings.simplefilter("ignore")
            yield
    finally:
        sys.unraisablehook, sys.excepthook = unraisable, raised


@contextmanager
def _opened(path: Path) -> Iterator[DatasetReader]:
    """A GeoTIFF out of memory, where no file beside it can be taken for a part of it."""
    from rasterio import Env
    from rasterio.io import MemoryFile

    data = read_bytes(path, HEIGHTS)
    if not data.startswith(_MAGIC):
        why = "it does not begin as a TIFF file does"
        raise TownError(f"--dem {path}: cannot be read ({why}); {_EXPECTED}")
    alone = Env(GDAL_PAM_ENABLED="NO", GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR")
    with alone, MemoryFile(data) as memory, memory.open(driver="GTiff") as file:
        yield file


def _require_usable(path: Path, file: DatasetReader) -> None:
    """Raise TownError for a grid that is too large, or whose place another file would say."""
    cells = file.width * file.height
    block = max(rows * cols for rows, cols in file.block_shapes)
    if file.count > _MAX_BANDS or cells > _MAX_CELLS or block > _MAX_BLOCK_CELLS:
        raise TownError(
            f"--dem {path}: has {file.width} x {file.height} cells in {file.count} bands, "
            f"{block} in a block; expected at most {_MAX_CELLS} cells, {_MAX_BANDS} bands, "
            f"{_MAX_BLOCK_CELLS} in a block: cut it with gdalwarp -te"
        )
    if np.dtype(file.dtypes[0]).kind not in "iuf":
        raise TownError(f"--dem {path}: holds cells of {file.dtypes[0]}; {_EXPECTED}")
    if file.crs is None:
        raise TownError(f"--dem {path}: has no coordinate system; {_EXPECTED}")
    if _GRIDS.search(file.crs.to_wkt()):
        raise TownError(f"--dem {path}: its coordinate system names a file; {_EXPECTED}")


def _read_own(path: Path, file: DatasetReader, area: Box, max_grade: float) -> Dem | None:
    """The heights of a file that this module wrote, or that says so, as they are.

    None of other files, of land that is too steep, or where they do not cover the area.
    """
    place, slack = Box(*file.bounds), 1e-6  # degrees
    low = area.west + slack, area.south + slack
    high = area.east - slack, area.north - slack
    try:
        is_gentle = float(file.tags().get(_DONE, "inf")) <= max_grade
    except ValueError:
        return None
    if not is_gentle or not place.holds(low) or not place.holds(high):
        return None
    if file.width * file.height > _MAX_OWN_CELLS or min(file.width, file.height) < 2:
        raise TownError(
            f"--dem {path}: has {file.width} x {file.height} cells; "
            f"expected 2 x 2 to {_MAX_OWN_CELLS} in all"
        )
    height_m = file.read(1).astype(np.float64)
    if not (np.abs(height_m) < _HIGHEST_M).all():
        raise TownError(f"--dem {path}: holds heights that are not numbers; {_EXPECTED}")
    return Dem(height_m=height_m, box=place, smooth=True)


def _box_text(box: Box) -> str:
    return ",".join(f"{value:.4f}" for value in box)


def _shape(area: Box) -> tuple[int, int]:
    wide_m, high_m = area.size_m
    return max(8, round(high_m / CELL_M)), max(8, round(wide_m / CELL_M))


def _hill(height_m: float, shape: tuple[int, int], seed: int) -> F64:
    """A few broad bumps (rows, cols) between 0 and the given height."""
    rng = make_rng(seed, "hill")
    rows, cols = (np.linspace(0.0, 1.0, count) for count in shape)
    row, col = np.meshgrid(rows, cols, indexing="ij")
    field = np.zeros(shape)
    for _ in range(4):
        y, x = rng.uniform(0.2, 0.8, 2)
        wide, high = rng.uniform(0.2, 0.35), rng.uniform(0.5, 1.0)
        field += high * np.exp(-((row - y) ** 2 + (col - x) ** 2) / (2.0 * wide**2))
    field -= field.min()
    return np.asarray(height_m * field / field.max())


def _filled(height_m: F64) -> F64:
    """Holes filled from their surroundings, step by step outwards."""
    known = np.isfinite(height_m)
    filled = np.where(known, height_m, 0.0)
    while not known.all():
        weight = cv2.blur(known.astype(np.float64), (3, 3), borderType=cv2.BORDER_CONSTANT)
        total_m = cv2.blur(np.where(known, filled, 0.0), (3, 3), borderType=cv2.BORDER_CONSTANT)
        mean_m = total_m / np.maximum(weight, 1e-9)
        fresh = ~known & (weight > 1e-9)
        filled[fresh] = mean_m[fresh]
        known |= fresh
    return filled


def _points(element: Element) -> F64:
    """Points (n, 2) of a shape; those of lanes no farther than PIECE_M from each other."""
    parts = [part.split(",")[:2] for part in element.attrib["shape"].split()]
    points_m = np.array(parts, np.float64).reshape(-1, 2)
    if element.tag != "lane" or len(points_m) < 2:
        return points_m
    rows = [points_m[:1]]
    for start_m, end_m in pairwise(points_m):
        pieces = max(1, int(np.ceil(np.hypot(*(end_m - start_m)) / PIECE_M)))
        share = np.arange(1, pieces + 1)[:, None] / pieces
        rows.append(start_m + share * (end_m - start_m))
    return np.asarray(np.round(np.concatenate(rows), 2), np.float64)


def _globe_places(root: Element, points_m: F64, path: Path) -> F64:
    """Longitudes and latitudes (n, 2) of points in the metres of a net. Raises TownError."""
    from rasterio.warp import transform

    location = root.find("location")
    projection = location.get("projParameter", "!") if location is not None else "!"
    if location is None or not projection.startswith("+proj"):
        raise TownError(
            f"{path.name}: has no geographic projection; "
            "expected a net made from OpenStreetMap data"
        )
    offset_m = np.array(location.attrib["netOffset"].split(","), np.float64)
    x_m, y_m = (points_m - offset_m).T
    with _own_projections():
        return np.column_stack(transform(projection, "EPSG:4326", x_m, y_m))


def _heights_at(dem: Dem, places: F64) -> F64:
    """Heights (n,) at longitudes and latitudes (n, 2), bilinear between middles of cells."""
    west, south, east, north = dem.box
    rows, cols = dem.height_m.shape
    col = np.clip((places[:, 0] - west) / (east - west) * cols - 0.5, 0.0, cols - 1.001)
    row = np.clip((north - places[:, 1]) / (north - south) * rows - 0.5, 0.0, rows - 1.001)
    c, r = np.floor(col).astype(np.intp), np.floor(row).astype(np.intp)
    u, v = col - c, row - r
    z = dem.height_m
    upper = (1 - u) * z[r, c] + u * z[r, c + 1]
    lower = (1 - u) * z[r + 1, c] + u * z[r + 1, c + 1]
    return np.asarray((1 - v) * upper + v * lower, np.float64)


def _gentle(dem: Dem, relief: Heights, steepest: Callable[[Dem], float]) -> Dem:
    """The land smoothed until no street is too steep, or else scaled down."""
    if dem.smooth:
        return dem
    land, grade = dem, 0.0
    for sigma_m in _SIGMAS_M:
        land = _smoothed(dem, sigma_m)
        grade = steepest(land)
        if grade <= relief.max_grade:
            return land
    warning = "the land has grades up to %.2f; its heights were scaled down to the largest grade"
    log.warning(warning, grade)
    return _scaled(land, 0.99 * relief.max_grade / grade)


def _smoothed(dem: Dem, sigma_m: float) -> Dem:
    """The same land with hills and dips narrower than about `sigma_m` taken out."""
    sigma = sigma_m / CELL_M
    blurred = cv2.GaussianBlur(dem.height_m, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return replace(dem, height_m=np.asarray(blurred, np.float64))


def _scaled(dem: Dem, factor: float) -> Dem:
    """The same land with all heights `factor` times as far from their mean."""
    mean_m = dem.height_m.mean()
    return replace(dem, height_m=mean_m + factor * (dem.height_m - mean_m))
