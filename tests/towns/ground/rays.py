import numpy as np
import shapely

from wcsim.core.seeding import make_rng
from wcsim.towns.ground.tiles import CELL_M
from wcsim.types import F64, ClassId, Street

_SPOT_M = 0.002
_DRAWS = 50  # a net of a single street fills a small part of its surroundings
_ROUNDS = 5  # in which they are drawn: each reads all of the ground's rasters
_HEIGHT_SLACK_M = 0.011  # the grid holds whole centimetres
_STREET = (ClassId.ROAD, ClassId.RAIL_TRACK, ClassId.SIDEWALK, ClassId.CROSSWALK)
_GROUND = (*_STREET, ClassId.TERRAIN, ClassId.GROUND, ClassId.PARKING)


def mesh_faults(street: Street, rays: int = 3000) -> int:
    """How many rays straight down, on road and pavement, meet no face with the class and height of the grid."""
    grid, mesh = street.grid, street.mesh
    xy_m = _places(street, rays)
    faces = np.flatnonzero(np.isin(mesh.face_class, _GROUND))
    corners = mesh.vertices_W_m[mesh.faces[faces]].astype(np.float64)  # (F, 3, 3)
    tree = shapely.STRtree(shapely.polygons(corners[:, :, :2]))
    spots = shapely.box(*(xy_m - _SPOT_M).T, *(xy_m + _SPOT_M).T)  # on a border both sides are right
    ray, face = tree.query(spots, predicate="intersects")
    good = mesh.face_class[faces[face]] == grid.class_at(xy_m[ray])
    good &= np.abs(_height_on(corners[face], xy_m[ray]) - grid.height_at(xy_m[ray])) <= _HEIGHT_SLACK_M
    return len(xy_m) - len(np.unique(ray[good]))


def _places(street: Street, count: int) -> F64:
    """Middles (n, 2) of decimetre cells of road and pavement, up to `count` of them, drawn from all over the town."""
    corners = street.mesh.vertices_W_m[:, :2].astype(np.float64)
    low, high = corners.min(axis=0), corners.max(axis=0)
    rng, found, number = make_rng(0, "rays"), [np.zeros((0, 2))], 0
    for _ in range(_ROUNDS):
        drawn = np.concatenate([rng.uniform(low, high, (count, 2)) for _ in range(_DRAWS // _ROUNDS)])
        xy_m = np.floor(drawn / CELL_M) * CELL_M + 0.5 * CELL_M
        found.append(xy_m[np.isin(street.grid.class_at(xy_m), _STREET)])
        number += len(found[-1])
        if number >= count:
            break
    return np.concatenate(found)[:count]


def normals(corners: np.ndarray) -> np.ndarray:
    """Of triangles (n, 3, 3), as long as twice their area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def steepest(corners: np.ndarray) -> float:
    """The most that triangles (n, 3, 3) rise on a metre."""
    normal = normals(corners)
    return float((np.hypot(normal[:, 0], normal[:, 1]) / normal[:, 2]).max())


def _height_on(corners: np.ndarray, xy_m: np.ndarray) -> np.ndarray:
    """Height (n,) of planes through triangles (n, 3, 3) at points (n, 2)."""
    normal = normals(corners)
    offset = xy_m - corners[:, 0, :2]
    height: np.ndarray = corners[:, 0, 2] - (normal[:, :2] * offset).sum(axis=1) / normal[:, 2]
    return height
