"""Give a net its heights: every point of every shape lies on the land.

netconvert can read heights itself, but only asks for them at the nodes of a street: where it moves nodes together, or
cuts streets at junctions, grades of 1:2 come out of gentle hills. Here no piece of a net is steeper than the land.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from wcsim.errors import TownError
from wcsim.towns.ground.relief import steepest_run
from wcsim.towns.importing.elevation import Dem, Heights, as_stored, heights_at, own_projections, scaled, smoothed
from wcsim.towns.sumo.xml_io import read_root
from wcsim.types import F64

log = logging.getLogger("wcsim.towns")

PIECE_M = 8.0  # the longest piece of a shape: between its ends the land is taken to be straight
_SIGMAS_M = (15.0, 30.0, 60.0)  # of the smoothing, one after the other; what is still too steep is made lower


def lift_net(path: Path, dem: Dem, relief: Heights) -> Dem:
    """Write heights into a plain .net.xml, smoothed and lowered until no street is too steep; returns what was used.

    Raises TownError when the net does not say where on the globe it lies.
    """
    root = read_root(path)
    return _lifted(root, path, dem, relief, lambda points_m: _places(root, points_m, path))


def lift_own_net(path: Path, dem: Dem, relief: Heights) -> Dem:
    """The same where the land's box is in the net's own metres, for a net that lies nowhere on the globe."""
    return _lifted(read_root(path), path, dem, relief, lambda points_m: points_m)


def _lifted(root: Element, path: Path, dem: Dem, relief: Heights, places_of: Callable[[F64], F64]) -> Dem:
    """`places_of` turns points (n, 2) of the net into places of the land."""
    found = [(element, _points(element)) for element in root.iter() if element.get("shape")]
    ends = np.cumsum([len(points_m) for _, points_m in found])
    places = places_of(np.concatenate([points_m for _, points_m in found]))
    runs_m = [np.hypot(*np.diff(points_m, axis=0).T) for _, points_m in found]
    driven = [element.tag == "lane" for element, _ in found]

    def steepest(land: Dem) -> float:
        return steepest_run(np.split(heights_at(land, places), ends[:-1]), runs_m, driven)

    if relief.dem is None:  # the hill is as high as ordered where the streets are
        height_m = float(np.ptp(heights_at(smoothed(dem, _SIGMAS_M[0]), places)))
        dem = scaled(dem, relief.hill_m / max(height_m, 1e-3 * relief.hill_m))
    used = as_stored(_gentle(dem, relief, steepest))
    for (element, points_m), z_m in zip(found, np.split(heights_at(used, places), ends[:-1]), strict=True):
        rows = np.column_stack([points_m, z_m]).tolist()
        element.set("shape", " ".join(f"{x:.2f},{y:.2f},{z:.3f}" for x, y, z in rows))
    junctions = [element for element in root.iterfind("junction")]
    middles_m = np.array([[float(element.get("x", "0")), float(element.get("y", "0"))] for element in junctions])
    for element, z in zip(junctions, heights_at(used, places_of(middles_m)).tolist(), strict=True):
        element.set("z", f"{z:.3f}")
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return used


def _gentle(dem: Dem, relief: Heights, steepest: Callable[[Dem], float]) -> Dem:
    if dem.smooth:
        return dem
    land, grade = dem, 0.0
    for sigma_m in _SIGMAS_M:
        land = smoothed(dem, sigma_m)
        grade = steepest(land)
        if grade <= relief.max_grade:
            return land
    log.warning("the land has grades up to %.2f; its heights were scaled down to the largest grade", grade)
    return scaled(land, 0.99 * relief.max_grade / grade)


def _points(element: Element) -> F64:
    """Points (n, 2) of a shape; those of lanes no farther than PIECE_M from each other."""
    points_m = np.array([part.split(",")[:2] for part in element.attrib["shape"].split()], np.float64).reshape(-1, 2)
    if element.tag != "lane" or len(points_m) < 2:
        return points_m
    rows = [points_m[:1]]
    for start_m, end_m in pairwise(points_m):
        pieces = max(1, int(np.ceil(np.hypot(*(end_m - start_m)) / PIECE_M)))
        share = np.arange(1, pieces + 1)[:, None] / pieces
        rows.append(start_m + share * (end_m - start_m))
    return np.asarray(np.round(np.concatenate(rows), 2), np.float64)


def _places(root: Element, points_m: F64, path: Path) -> F64:
    """Longitudes and latitudes (n, 2) of points in net coordinates."""
    from rasterio.warp import transform

    location = root.find("location")
    projection = location.get("projParameter", "!") if location is not None else "!"
    if location is None or not projection.startswith("+proj"):
        raise TownError(f"{path.name}: has no geographic projection; expected a net made from OpenStreetMap data")
    offset_m = np.array(location.attrib["netOffset"].split(","), np.float64)
    x_m, y_m = (points_m - offset_m).T
    with own_projections():
        return np.column_stack(transform(projection, "EPSG:4326", x_m, y_m))
