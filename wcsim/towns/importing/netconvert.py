"""From cleaned OpenStreetMap data to a SUMO net and polygons, with SUMO's own tools and cures for their crashes."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from wcsim.errors import SumoError
from wcsim.towns.osm.area import Box
from wcsim.towns.scenario.manifest import chair_ways
from wcsim.towns.sumo.tools import Limits, ToolRun, run_tool, sumo_home

log = logging.getLogger("wcsim.towns")

_TYPEMAPS = ("osmNetconvert.typ.xml", "osmNetconvertUrbanDe.typ.xml", "osmNetconvertBicycle.typ.xml")
_NETCONVERT = [
    "--sidewalks.guess",
    "--sidewalks.guess.max-speed",
    "22.3",  # 80 km/h: outside Europe a city's main streets are faster than SUMO's 50 km/h, and have pavements
    "--osm.sidewalks",
    "--crossings.guess",
    "--crossings.guess.speed-threshold",
    "18",
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
_LEFT_OUT = ("highway.steps", "highway.service", "highway.track")
_LIMITS = Limits(wall_s=120.0, cpu_s=120)
# What is left out when netconvert fails, mildest first: it crashes on some crossings, and on some joins of junctions.
_LADDER: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    ((), ()),
    (("--osm.crossings",), ()),
    (("--osm.crossings",), ("--ignore-errors",)),
    (("--osm.crossings", "--junctions.join"), ("--ignore-errors",)),
    (("--osm.crossings", "--junctions.join", "--roundabouts.guess", "--osm.bike-access"), ("--ignore-errors",)),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class NetOrder:
    """How a net is to be made."""

    name: str  # <name>.net.xml is written
    box: Box
    lefthand: bool
    keep_service: bool = False  # driveways and yards too, each with a crossing of its own
    chair_ways: tuple[str, ...] = chair_ways(cycle_paths=False)
    more: tuple[str, ...] = ()  # netconvert options


def convert_net(order: NetOrder, extract: str, folder: Path) -> Path:
    """Run netconvert on `extract` in `folder`, with fewer options when it fails. Raises SumoError."""
    options = _net_options(order, extract)
    first: ToolRun | None = None
    for left_out, added in _LADDER:
        run = run_tool("netconvert", [*(o for o in options if o not in left_out), *added], folder, _LIMITS)
        if not run.returncode:
            if first is not None:
                log.warning("town %s: %s; the net was built without %s", order.name, first.reason(), " ".join(left_out))
            return folder / f"{order.name}.net.xml"
        first = first or run
        if "No edges" in run.output or "No nodes" in run.output:
            break
    assert first is not None  # noqa: S101 - the ladder is not empty
    raise SumoError(f"no net could be built: {first.reason()}; check the extract and the bounding box")


def _net_options(order: NetOrder, extract: str) -> list[str]:
    maps = ",".join(str(sumo_home() / "data" / "typemap" / name) for name in _TYPEMAPS)
    left_out = _LEFT_OUT[:1] if order.keep_service else _LEFT_OUT
    options = ["--osm-files", extract, "--type-files", maps, *_NETCONVERT, "--osm.crossings"]
    options += ["--remove-edges.by-type", ",".join(left_out)]
    options += ["--keep-edges.in-geo-boundary", ",".join(map(str, order.box)), "-o", f"{order.name}.net.xml"]
    options += ["--lefthand"] * order.lefthand
    return [*options, *order.more]


def convert_polygons(name: str, extract: str, folder: Path, what: str = "poly") -> Path:
    """Run polyconvert on `extract` in `folder`, pruned to the net <name>.net.xml. Raises SumoError.

    Args:
        name: The town's.
        extract: OpenStreetMap data.
        folder: Where both are; <name>.<what>.xml is written.
        what: "poly" for what stands in a town, "ground" for squares and crossings.
    """
    types = Path(__file__).parent / f"{what}types.xml"
    options = ["--osm-files", extract, "--net-file", f"{name}.net.xml", "--type-file", str(types)]
    options += [*_POLYCONVERT, "-o", f"{name}.{what}.xml"]
    run = run_tool("polyconvert", options, folder, _LIMITS)
    if run.returncode:
        run = run_tool("polyconvert", [*options, "--ignore-errors"], folder, _LIMITS)
    if run.returncode:
        raise SumoError(f"buildings could not be read: {run.reason()}; check the extract")
    return folder / f"{name}.{what}.xml"
