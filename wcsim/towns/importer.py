"""Import a town from OpenStreetMap: prefilter, netconvert, polyconvert, demand, and a folder that opens in sumo-gui.

Everything is made in a folder beside the target and moved into place at the end; the same order gives the same bytes.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wcsim.errors import SumoError, TownError
from wcsim.towns.demand import Way, build_ways, flows_text, vtypes_text
from wcsim.towns.folder import license_text, sumocfg_text, town_toml_text
from wcsim.towns.netread import Net, read_net
from wcsim.towns.osmfilter import filter_osm
from wcsim.towns.tools import run_tool, sumo_home
from wcsim.towns.town import Town, open_town
from wcsim.towns.trial import ROUNDS, stuck_ways
from wcsim.towns.xmlio import content_digest, parse_root, read_bytes, without_comments, write_gzip

_TYPEMAPS = ("osmNetconvert.typ.xml", "osmNetconvertUrbanDe.typ.xml", "osmNetconvertBicycle.typ.xml")
_NETCONVERT = [
    "--sidewalks.guess",
    "--osm.sidewalks",
    "--crossings.guess",
    "--walkingareas",
    "--osm.bike-access",
    "--geometry.remove",
    "--junctions.join",
    "--junctions.corner-detail",
    "5",
    "--roundabouts.guess",
    "--tls.guess-signals",
    "--tls.discard-simple",
    "--tls.default-type",
    "actuated",
    "--no-turnarounds.tls",
    "--keep-edges.components",
    "1",
    "--remove-edges.isolated",
    "--proj.utm",
    "--output.street-names",
    "--output.original-names",
]
_POLYCONVERT = [
    "--osm.keep-full-type",
    "--osm.merge-relations",
    "1",
    "--all-attributes",
    "--discard",
    "--prune.in-net",
    "--prune.in-net.offsets",
    "40,40,40,40",
]
_SEGFAULT = -11  # how a child that died so is reported
_WAYS_LEFT_OUT = ("highway.steps", "highway.service", "highway.track")


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOrder:
    """What to import and where to put it."""

    osm: Path  # .osm, .osm.xml, plain or .gz
    bbox: tuple[float, float, float, float]  # west, south, east, north
    name: str
    split: str  # "train" or "test"
    out: Path  # the town's folder
    lefthand: bool = False
    seed: int = 42
    traffic: float = 1.0  # how dense, against `demand.MIX`
    keep_service: bool = False  # driveways and yards too, each with a crossing of its own
    source: str = ""
    options: tuple[str, ...] = field(default=())  # more netconvert options


def import_town(order: ImportOrder) -> Town:
    """Build the town and move it to `order.out`, replacing a town that is there.

    Raises:
        TownError: the order or the extract cannot be used, or the folder holds something else.
        SumoError: one of SUMO's tools failed.
    """
    _check(order)
    order.out.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=f".{order.name}-", dir=order.out.parent))
    try:
        _build(order, work)
        _move_in_place(work, order.out)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return open_town(order.out)


def _check(order: ImportOrder) -> None:
    west, south, east, north = order.bbox
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", order.name):
        raise TownError(f"a town cannot be named {order.name!r}; expected letters, digits, - and _")
    if order.split not in ("train", "test"):
        raise TownError(f"unknown split {order.split!r} of town {order.name}; expected train or test")
    if not (-180 <= west < east <= 180 and -85 <= south < north <= 85):
        raise TownError(f"bounding box {order.bbox} is not west,south,east,north in degrees")
    if order.osm.suffix == ".pbf":
        raise TownError(
            f"{order.osm}: SUMO reads XML only; convert it: osmium cat {order.osm.name} -o {order.name}.osm.gz"
        )
    if order.out.is_dir() and any(order.out.iterdir()) and not (order.out / "town.toml").is_file():
        raise TownError(f"{order.out} is not empty and not a town; give another folder, or empty it")


def _build(order: ImportOrder, work: Path) -> None:
    extract = read_bytes(order.osm)
    root = parse_root(extract, str(order.osm))
    if root.tag != "osm" or root.find("way") is None:
        raise TownError(f"{order.osm}: is not an OpenStreetMap extract (root <{root.tag}>); download an area as .osm")
    cleaned = work / "clean.osm.xml"
    cleaned.write_bytes(filter_osm(root).data)
    net = _convert_net(order, work)
    _convert_polygons(order, work)
    cleaned.unlink()
    for kind in ("net", "poly"):
        plain = work / f"{order.name}.{kind}.xml"
        write_gzip(work / f"{plain.name}.gz", without_comments(plain.read_bytes()))
    ways = build_ways(net, work / f"{order.name}.net.xml", work, order.seed)
    for kind in ("net", "poly"):
        (work / f"{order.name}.{kind}.xml").unlink()
    _write_folder(order, work, net, extract)
    _write_demand(order, work, net, ways)
    _write_manifest(order, work, net)


def _write_demand(order: ImportOrder, work: Path, net: Net, ways: tuple[Way, ...]) -> None:
    """Write the flows, without the walking ways on which people get stuck."""
    for trials_left in reversed(range(ROUNDS + 1)):
        if not ways:
            raise TownError(f"town {order.name}: no way through it can be routed; take a larger area")
        text = flows_text(net, ways, order.seed, order.traffic)
        write_gzip(work / f"{order.name}.rou.xml.gz", text.encode())
        stuck = stuck_ways(work / f"{order.name}.sumocfg", ways) if trials_left else ()
        if not stuck:
            return
        ways = tuple(way for way in ways if way not in stuck)


def _convert_net(order: ImportOrder, work: Path) -> Net:
    """Run netconvert; without --osm.crossings again when it crashes on one (netconvert 1.28 does on odd crossings)."""
    maps = ",".join(str(sumo_home() / "data" / "typemap" / name) for name in _TYPEMAPS)
    left_out = _WAYS_LEFT_OUT[:1] if order.keep_service else _WAYS_LEFT_OUT
    options = [
        "--osm-files",
        "clean.osm.xml",
        "--type-files",
        maps,
        *_NETCONVERT,
        "--remove-edges.by-type",
        ",".join(left_out),
    ]
    options += ["--keep-edges.in-geo-boundary", ",".join(map(str, order.bbox)), "-o", f"{order.name}.net.xml"]
    options += ["--lefthand"] * order.lefthand + list(order.options)
    run = run_tool("netconvert", [*options, "--osm.crossings"], work)
    if run.returncode == _SEGFAULT:
        run = run_tool("netconvert", options, work)
    if run.returncode:
        raise SumoError(
            f"town {order.name}: no net could be built: {run.reason()}; check the extract and the bounding box"
        )
    net = read_net(work / f"{order.name}.net.xml")
    if not any(edge.function == "walkingarea" for edge in net.edges):
        raise TownError(f"town {order.name}: the area has no pavements; choose a larger or another bounding box")
    return net


def _convert_polygons(order: ImportOrder, work: Path) -> None:
    types = Path(__file__).parent / "polytypes.xml"
    options = ["--osm-files", "clean.osm.xml", "--net-file", f"{order.name}.net.xml", "--type-file", str(types)]
    run = run_tool("polyconvert", [*options, *_POLYCONVERT, "-o", f"{order.name}.poly.xml"], work)
    if run.returncode:
        raise SumoError(f"town {order.name}: buildings could not be read: {run.reason()}; check the extract")


def _write_folder(order: ImportOrder, work: Path, net: Net, extract: bytes) -> None:
    name = order.name
    (work / f"{name}.add.xml").write_text(vtypes_text(), encoding="utf-8")
    routes, additional = f"{name}.rou.xml.gz", (f"{name}.add.xml", f"{name}.poly.xml.gz")
    (work / f"{name}.sumocfg").write_text(sumocfg_text(name, order.seed, routes, additional), encoding="utf-8")
    (work / "LICENSE-DATA").write_text(license_text(name), encoding="utf-8")
    (work / "osm").mkdir()
    write_gzip(work / "osm" / f"{name}.osm.xml.gz", extract)
    (work / "osm" / "bbox").write_text(",".join(map(str, order.bbox)) + "\n", encoding="utf-8")


def _write_manifest(order: ImportOrder, work: Path, net: Net) -> None:
    name = order.name
    corners_m = np.concatenate([lane.points_m for edge in net.edges for lane in edge.lanes])
    middle_m = 0.5 * (corners_m.min(axis=0) + corners_m.max(axis=0))
    hashes = {
        kind: content_digest(work / f"{name}.{kind}") for kind in ("net.xml.gz", "poly.xml.gz", "rou.xml.gz", "add.xml")
    }
    origin_m = (round(float(middle_m[0])), round(float(middle_m[1])))
    text = town_toml_text(
        name=name,
        split=order.split,
        origin_m=origin_m,
        source=order.source,
        attribution="(c) OpenStreetMap contributors, ODbL 1.0",
        hashes=hashes,
    )
    (work / "town.toml").write_text(text, encoding="utf-8")


def _move_in_place(work: Path, out: Path) -> None:
    work.chmod(0o755)
    if not out.exists():
        work.rename(out)
        return
    aside = work.with_name(work.name + "-old")
    out.rename(aside)
    try:
        work.rename(out)
    except OSError:
        aside.rename(out)
        raise
    shutil.rmtree(aside)
