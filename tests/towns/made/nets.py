"""Nets of all kinds for tests, written by hand or by netgenerate, and what must hold on the ground of any of them."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import shapely

from tests.towns.conftest import tool_output
from tests.towns.ground.rays import steepest
from wcsim.towns.ground.kerb_heights import STEEPEST, make_kerbing
from wcsim.towns.ground.mesh import LOW_CLASSES, _GroundMesh, build_ground, kerb_walls
from wcsim.towns.ground.plane_geometry import cross_z
from wcsim.towns.ground.surfaces import lane_area, make_surfaces
from wcsim.towns.sumo.net import WALK_KINDS, Lane, LaneKind, Net, read_net
from wcsim.types import F64
from wcsim.types.street import FLAT, ClassId, Relief

WAYS = ("sidewalk", "crossing", "shared")
WALK = 'allow="pedestrian"'
DRIVE = 'disallow="pedestrian"'
PAVED = ("--sidewalks.guess", "--crossings.guess", "--walkingareas", "--default.speed", "13.8")


def lane(shape: str, allow: str = DRIVE, width: str = "") -> str:
    """A <lane> without id; "@" is the place of its edge's id."""
    size = f' width="{width}"' if width else ""
    return f'<lane id="@" index="#" {allow} speed="13.9" length="10" shape="{shape}"{size}/>'


def edge(name: str, *lanes: str, function: str = "normal") -> str:
    """An <edge> with its lanes."""
    inner = "".join(text.replace("@", f"{name}_{i}").replace("#", str(i)) for i, text in enumerate(lanes))
    ends = 'from="a" to="b" ' if function == "normal" else ""
    return f'<edge id="{name}" {ends}function="{function}">{inner}</edge>'


def street(name: str = "s", y: float = 0.0, length: float = 60.0) -> str:
    """A carriageway of two lanes with a pavement on its right."""
    rows = ((y - 3.0, WALK, "2.0"), (y, DRIVE, "3.2"), (y + 3.2, DRIVE, "3.2"))
    return edge(name, *(lane(f"0,{at} {length},{at}", allow, width) for at, allow, width in rows))


def write_net(folder: Path, *parts: str) -> Net:
    """The net of these elements, read back."""
    path = folder / "odd.net.xml"
    path.write_text("<net>" + "".join(parts) + "</net>")
    return read_net(path)


def generated(folder: Path, *options: str) -> Net:
    """What netgenerate makes of its options."""
    tool_output("netgenerate", [*options, "-o", "made.net.xml"], folder)
    return read_net(folder / "made.net.xml")


def hilly(net: Path, out: Path, height_m: Callable[[float, float], float]) -> Path:
    """The same net with every shape lifted to a land of this height."""

    return moved(net, out, lambda x, y: f"{x:.2f},{y:.2f},{height_m(x, y):.2f}")


def moved(net: Path, out: Path, place: Callable[[float, float], str]) -> Path:
    """The same net with these places in every shape."""

    def shape(match: re.Match[str]) -> str:
        places = [tuple(float(v) for v in part.split(",")[:2]) for part in match[1].split()]
        return ' shape="' + " ".join(place(x, y) for x, y in places) + '"'

    text, count = re.subn(r' shape="([^"]+)"', shape, net.read_text())
    assert count
    out.write_text(text)
    return out


def spiral() -> str:
    """A ramp that winds up over itself three times."""
    at = [2.0 * math.pi * k / 24 for k in range(24 * 3 + 1)]
    places = [f"{18.0 * math.cos(a):.2f},{18.0 * math.sin(a):.2f},{5.0 * a / 2 / math.pi:.2f}" for a in at]
    return edge("spiral", lane(" ".join(places)))


def ground_of(net: Net, relief: Relief = FLAT) -> _GroundMesh:
    """The ground of a net with kerbs of 12 cm."""
    surfaces = make_surfaces(net, WAYS)
    return build_ground(surfaces, make_kerbing(surfaces, 0.12, 0.0), relief)


def assert_sound(net: Net, relief: Relief = FLAT) -> None:
    """No hole, no overlap, no ramp too steep, and a ray down on any way meets the class that belongs there."""
    ground = ground_of(net, relief)
    corners = ground.vertices_W_m[ground.faces]
    area_m2 = 0.5 * cross_z(corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2])
    hull = make_surfaces(net, WAYS).hull
    assert area_m2.min() > 0.0 and abs(area_m2.sum() / hull.area - 1.0) < 5e-5
    assert shapely.distance(hull.boundary, shapely.points(open_ends(ground))).max() < 0.5
    raised = corners[~ground.low]
    if len(raised):
        assert steepest(raised) <= 1.03 * STEEPEST
    driven = [way for way in net.lanes(LaneKind.MOTOR, LaneKind.RAIL) if not way.internal]
    crossings = net.lanes(LaneKind.CROSSING)
    walked = [way for way in net.lanes(*WALK_KINDS, LaneKind.WALKINGAREA) if not way.internal]
    assert np.isin(_classes(ground, _along(driven)), LOW_CLASSES).all()
    roads = shapely.union_all([lane_area(way) for way in driven + crossings])
    points_m = _along(walked)
    own = points_m[~shapely.dwithin(roads, shapely.points(points_m), 0.4)] if len(points_m) else points_m
    assert (_classes(ground, own) == ClassId.SIDEWALK).mean() > 0.999 if len(own) else True
    zebra_m = _along(crossings)
    assert (_classes(ground, zebra_m) == ClassId.CROSSWALK).mean() > 0.99 if len(zebra_m) else True


def open_ends(ground: _GroundMesh) -> F64:
    """Ends (n, 2) of edges that belong to one face or kerb alone, or to more than two."""
    corners = np.concatenate([ground.vertices_W_m[ground.faces], kerb_walls(ground)[0]]).reshape(-1, 3)
    points_m, number = np.unique(np.rint(corners * 1e5).astype(np.int64), axis=0, return_inverse=True)
    faces = number.reshape(-1, 3)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    there, back = edges @ (len(points_m), 1), edges @ (1, len(points_m))
    assert len(np.unique(there)) == len(there)  # counter-clockwise everywhere, nothing twice
    ends: F64 = points_m[edges[~np.isin(there, back)].reshape(-1), :2] / 1e5
    return ends


def _along(ways: list[Lane]) -> F64:
    """Points (n, 2) along centre lines, and one in each part of a walking area."""
    found: list[F64] = [np.zeros((0, 2))]
    for way in ways:
        if way.kind is LaneKind.WALKINGAREA:
            parts = [part for part in shapely.get_parts(lane_area(way)) if part.area > 0.5]
            found += [shapely.get_coordinates(part.representative_point()) for part in parts]
        elif len(way.points_m) > 1:
            line = shapely.LineString(way.points_m)
            found.append(shapely.get_coordinates(line.interpolate(np.arange(0.25, line.length - 0.2, 1.7))))
    return np.concatenate(found)


def _classes(ground: _GroundMesh, points_m: F64) -> np.ndarray:
    """Class (n,) of the face below each point, -1 over a hole."""
    faces = shapely.STRtree(shapely.polygons(ground.vertices_W_m[ground.faces][:, :, :2]))
    point, face = faces.query(shapely.points(points_m), predicate="intersects")
    classes = np.full(len(points_m), -1)
    classes[point] = ground.face_class[face]
    return classes
