"""What a map would say of a made town, in the files that polyconvert would write of one."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import shapely
from shapely import Polygon

from wcsim.towns.making.blocks import Blocks, build_blocks
from wcsim.towns.making.dressing import Dressing, dress, park_things
from wcsim.towns.sumo.net import LaneKind, Net
from wcsim.types import F64

_KERBS = ("flush", "lowered", "rolled", "sloped", "raised")
_KERB_SHARES = (0.4, 0.35, 0.1, 0.05, 0.1)
_GARDEN_M2 = 400.0  # a garden that is smaller has no trees
_Pairs = list[tuple[str, str]]


def draw_map(net: Net, folder: Path, rng: np.random.Generator) -> tuple[Path, Path, tuple[str, ...]]:
    """Write made.poly.xml and made.ground.xml of a net into `folder`.

    Returns:
        Both files, and elements for the town's additional file: what stands exactly where it is placed.
    """
    blocks, dressing = build_blocks(net, rng), dress(net, rng)
    poly, ground = _Writer(), _Writer()
    _write_blocks(blocks, poly, ground, rng)
    for kind, xy_m in dressing.mapped:
        poly.point(kind, xy_m, [])
    _write_kerbs(net, poly, ground, rng)
    paths = folder / "made.poly.xml", folder / "made.ground.xml"
    for writer, path in zip((poly, ground), paths, strict=True):
        path.write_text(writer.text(), encoding="utf-8")
    return *paths, _left_things(dressing)


class _Writer:
    """Collects the elements of an additional file."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def point(self, kind: str, xy_m: F64, tags: _Pairs) -> None:
        """Add a point (2,)."""
        self._add("poi", kind, f'x="{xy_m[0]:.2f}" y="{xy_m[1]:.2f}" layer="1"', tags)

    def area(self, kind: str, outline: Polygon, tags: _Pairs) -> None:
        """Add an outline; its holes are left out."""
        self._shape(kind, shapely.get_coordinates(outline.exterior), tags, "1")

    def line(self, kind: str, points_m: F64) -> None:
        """Add a line (K, 2)."""
        self._shape(kind, points_m, [], "0")

    def text(self) -> str:
        """The file."""
        return "\n".join(["<additional>", *self._lines, "</additional>", ""])

    def _shape(self, kind: str, points_m: F64, tags: _Pairs, fill: str) -> None:
        shape = " ".join(f"{x:.2f},{y:.2f}" for x, y in points_m.tolist())
        self._add("poly", kind, f'fill="{fill}" layer="-1" shape="{shape}"', tags)

    def _add(self, tag: str, kind: str, more: str, tags: _Pairs) -> None:
        head = f'    <{tag} id="m{len(self._lines)}" type="{kind}" color="{_colour(kind)}" {more}'
        inner = "".join(f"<param key={quoteattr(key)} value={quoteattr(value)}/>" for key, value in tags)
        self._lines.append(f"{head}>{inner}</{tag}>" if inner else f"{head}/>")


def _colour(kind: str) -> str:
    group = kind.partition(".")[0]
    known = {"building": "0.85,0.80,0.75", "natural": "0.2,0.6,0.2", "landuse": "0.6,0.8,0.6", "leisure": "0.6,0.8,0.6"}
    return known.get(group, "0.5,0.5,0.5")


def _write_blocks(blocks: Blocks, poly: _Writer, ground: _Writer, rng: np.random.Generator) -> None:
    for house in blocks.houses:
        poly.area("building.yes", house.outline, [("building", "yes"), ("building:levels", str(house.levels))])
    used = shapely.union_all([*(house.outline for house in blocks.houses), *blocks.car_parks]).buffer(1.5, quad_segs=1)
    for kind, green in blocks.greens:
        poly.area(kind, green, [])
        free = green.difference(used)
        if free.area > _GARDEN_M2:
            for thing, xy_m in park_things(free, rng):
                poly.point(thing, xy_m, [])
    for square in blocks.squares:
        ground.area("place.square", square, [])
        for thing, xy_m in park_things(square, rng):
            poly.point(thing.replace("natural.shrub", "man_made.flagpole"), xy_m, [])
    for lot in blocks.car_parks:
        poly.area("amenity.parking", lot, [("parking", "surface")])
    for kind, line_m in blocks.hedges:
        poly.line(f"barrier.{kind}", line_m)


def _write_kerbs(net: Net, poly: _Writer, ground: _Writer, rng: np.random.Generator) -> None:
    """Paint and kerbs of all crossings: those at signals are painted, and their kerbs never stay high."""
    lit = {name for link in net.connections if link.tls_id for name in (link.start, link.end)}
    painted = rng.uniform(0.3, 1.0)
    for lane in net.lanes(LaneKind.CROSSING):
        if len(lane.points_m) < 2:
            continue
        middle = shapely.LineString(lane.points_m).interpolate(0.5, normalized=True)
        drawn = rng.random() < painted
        tags = [("crossing", "marked" if drawn or lane.edge_id in lit else "unmarked")]
        ground.point("highway.crossing", shapely.get_coordinates(middle)[0], tags)
        kerb = str(rng.choice(_KERBS, p=_KERB_SHARES))
        for end_m in (lane.points_m[0], lane.points_m[-1]):
            poly.point(f"kerb.{'lowered' if kerb == 'raised' and lane.edge_id in lit else kerb}", end_m, [])


def _left_things(dressing: Dressing) -> tuple[str, ...]:
    return tuple(
        f'<poi id="left.{number}" type="{kind}" x="{xy_m[0]:.2f}" y="{xy_m[1]:.2f}" angle="{angle_deg:.1f}"/>'
        for number, (kind, xy_m, angle_deg) in enumerate(dressing.placed)
    )
