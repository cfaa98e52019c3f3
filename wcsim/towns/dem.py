"""Heights for a town: a GeoTIFF or a synthetic hill, made smooth enough that no street is too steep.

`lift.py` writes them into the net, from which SUMO and the street mesh take them.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from wcsim.errors import TownError
from wcsim.seeding import generator
from wcsim.towns.place import Box, grown, size_m
from wcsim.types import F64

CELL_M = 10.0
MARGIN_M = 400.0  # around the box: streets reach out of it, and smoothing needs neighbours
_PROJ_PLACES = ("PROJ_LIB", "PROJ_DATA")
_DONE = "WCSIM_MAX_GRADE"  # tag of a file that this module wrote: it is taken as it is
_WANTED = "expected a GeoTIFF of heights in metres with a coordinate system, as gdalwarp writes"


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


def make_dem(relief: Heights, box: Box, seed: int) -> Dem | None:
    """The heights of a town's area and its surroundings, None for a level town. Raises TownError."""
    if not 0.01 <= relief.max_grade <= 0.25:
        raise TownError(f"a largest grade of {relief.max_grade} is not possible; expected 0.01 to 0.25")
    area = grown(box, MARGIN_M)
    if relief.dem is not None:
        return _read(relief.dem, area, relief.max_grade)
    if relief.hill_m == 0.0:
        return None
    if not 0.0 < relief.hill_m <= 200.0:
        raise TownError(f"a hill of {relief.hill_m} m is not possible; expected more than 0 and at most 200 m")
    return Dem(height_m=_hill(relief.hill_m, _shape(area), seed), box=area)


def heights_at(dem: Dem, places: F64) -> F64:
    """Heights (n,) at longitudes and latitudes (n, 2), bilinear between the middles of the cells."""
    west, south, east, north = dem.box
    rows, cols = dem.height_m.shape
    col = np.clip((places[:, 0] - west) / (east - west) * cols - 0.5, 0.0, cols - 1.001)
    row = np.clip((north - places[:, 1]) / (north - south) * rows - 0.5, 0.0, rows - 1.001)
    c, r = np.floor(col).astype(np.intp), np.floor(row).astype(np.intp)
    u, v = col - c, row - r
    z = dem.height_m
    upper, lower = (1 - u) * z[r, c] + u * z[r, c + 1], (1 - u) * z[r + 1, c] + u * z[r + 1, c + 1]
    return np.asarray((1 - v) * upper + v * lower, np.float64)


def smoothed(dem: Dem, sigma_m: float) -> Dem:
    """The same land with hills and dips narrower than about `sigma_m` taken out."""
    sigma = sigma_m / CELL_M
    blurred = cv2.GaussianBlur(dem.height_m, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return replace(dem, height_m=np.asarray(blurred, np.float64))


def scaled(dem: Dem, factor: float) -> Dem:
    """The same land with all heights `factor` times as far from their mean."""
    mean_m = dem.height_m.mean()
    return replace(dem, height_m=mean_m + factor * (dem.height_m - mean_m))


def as_stored(dem: Dem) -> Dem:
    """The same land as a file holds it, so that a town made from the file is the same."""
    return replace(dem, height_m=np.round(dem.height_m, 3).astype(np.float32).astype(np.float64))


def _shape(area: Box) -> tuple[int, int]:
    wide_m, high_m = size_m(area)
    return max(8, round(high_m / CELL_M)), max(8, round(wide_m / CELL_M))


def _hill(height_m: float, shape: tuple[int, int], seed: int) -> F64:
    """A few broad bumps (rows, cols) between 0 and the given height."""
    rng = generator(seed, "hill")
    row, col = np.meshgrid(np.linspace(0.0, 1.0, shape[0]), np.linspace(0.0, 1.0, shape[1]), indexing="ij")
    field = np.zeros(shape)
    for _ in range(4):
        (y, x), wide, high = rng.uniform(0.2, 0.8, 2), rng.uniform(0.2, 0.35), rng.uniform(0.5, 1.0)
        field += high * np.exp(-((row - y) ** 2 + (col - x) ** 2) / (2.0 * wide**2))
    field -= field.min()
    return np.asarray(height_m * field / field.max())


@contextmanager
def own_projections() -> Iterator[None]:
    """Let rasterio find its own coordinate systems: libsumo, once loaded, points the process to SUMO's older ones."""
    from rasterio.env import PROJDataFinder

    found = PROJDataFinder().search_wheel()
    kept = {name: os.environ[name] for name in _PROJ_PLACES if name in os.environ}
    os.environ.update(dict.fromkeys(kept, found) if found else {})
    try:
        yield
    finally:
        os.environ.update(kept)


def _read(path: Path, area: Box, max_grade: float) -> Dem:
    import rasterio
    from rasterio.errors import RasterioError
    from rasterio.transform import from_bounds
    from rasterio.warp import Resampling, reproject, transform_bounds

    shape = _shape(area)
    found = np.full(shape, np.nan, np.float32)
    try:
        with own_projections(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of files without a place, which are refused below
            with rasterio.open(path) as file:
                if file.crs is None:
                    raise TownError(f"--dem {path}: has no coordinate system; {_WANTED}")
                if _gentle_enough(file.tags(), max_grade) and _covers(tuple(file.bounds), area):
                    return Dem(height_m=file.read(1).astype(np.float64), box=tuple(file.bounds), smooth=True)
                place = transform_bounds(file.crs, "EPSG:4326", *file.bounds)
                reproject(
                    rasterio.band(file, 1),
                    found,
                    dst_transform=from_bounds(*area, shape[1], shape[0]),
                    dst_crs="EPSG:4326",
                    dst_nodata=np.nan,
                    resampling=Resampling.bilinear,
                )
    except (RasterioError, OSError, ValueError) as error:
        raise TownError(f"--dem {path}: cannot be read ({error}); {_WANTED}") from None
    height_m = np.where(np.isfinite(found) & (np.abs(found) < 9000.0), found, np.nan).astype(np.float64)
    known = float(np.isfinite(height_m).mean())
    if known < 0.5:
        raise TownError(
            f"--dem {path}: knows the heights of {known:.0%} of the area; it covers {_told(place)} and the town needs "
            f"{_told(area)}: give one that covers the town"
        )
    return Dem(height_m=_filled(height_m), box=area)


def _gentle_enough(tags: dict[str, str], max_grade: float) -> bool:
    """True for a file that this module wrote, of land that needs no more smoothing."""
    try:
        return float(tags.get(_DONE, "inf")) <= max_grade
    except ValueError:
        return False


def _covers(place: Box, area: Box) -> bool:
    slack = 1e-6  # degrees
    return (
        place[0] <= area[0] + slack
        and place[1] <= area[1] + slack
        and place[2] >= area[2] - slack
        and place[3] >= area[3] - slack
    )


def _told(box: Box) -> str:
    return ",".join(f"{value:.4f}" for value in box)


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


def write_dem(dem: Dem, relief: Heights, path: Path) -> None:
    """Write heights as a GeoTIFF in longitude and latitude."""
    import rasterio
    from rasterio.transform import from_bounds

    rows, cols = dem.height_m.shape
    profile = {
        "driver": "GTiff",
        "width": cols,
        "height": rows,
        "count": 1,
        "dtype": "float32",
        "crs": "EPSG:4326",
        "transform": from_bounds(*dem.box, cols, rows),
        "compress": "deflate",
    }
    with own_projections(), rasterio.open(path, "w", **profile) as file:
        file.write(dem.height_m.astype(np.float32), 1)
        file.update_tags(**{_DONE: f"{relief.max_grade:g}"})
