"""Import a town from a map: read, clean, convert, add demand; the folder opens in sumo-gui.

Everything is made in a folder beside the target and moved into place at the end; the same order
gives the same bytes. A town's net is built without parts that cannot be reached on foot. SUMO's own
tools make it of cleaned data, with cures for their crashes.
"""

import logging
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence, Set
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree.ElementTree import Element

from wcsim.core.files import write_folder_atomically
from wcsim.core.reading import escape, join_names, read_module_toml
from wcsim.errors import SumoError, TownError, check_installed
from wcsim.towns.importing.demand import CLASSES, Way, build_ways, vtypes_text, write_demand
from wcsim.towns.importing.elevation import Heights, lift_net, make_dem
from wcsim.towns.importing.folder_texts import (
    check_place,
    check_words,
    town_toml_text,
    write_scenario,
)
from wcsim.towns.importing.map_marks import find_parking, map_marks
from wcsim.towns.importing.one_crossing import drop_crossings
from wcsim.towns.osm.clean import (
    LeftOut,
    count_inside,
    crossed_edges,
    cut_bridges,
    denied_crossings,
    denied_pavements,
    filter_osm,
    map_ways,
    strip_orphans,
)
from wcsim.towns.osm.read import Box, Extract, Side, read_extract, side_at
from wcsim.towns.osm.squares import cross_squares
from wcsim.towns.scenario.town import CYCLE_PATHS, Town, chair_ways, hash_files, open_town
from wcsim.towns.sumo.net import LaneKind, Net, read_net
from wcsim.towns.sumo.tools import Limits, ToolRun, by_file, run_tool, sumo_home
from wcsim.towns.sumo.xml_io import MAX_XML_BYTES, parse_root, read_bytes, write_gzip, xml_bytes
from wcsim.towns.walking.islands import (
    largest_share,
    osm_ways_by_edge,
    stray_footways,
    stray_ways,
    walkable_parts,
)

log = logging.getLogger("wcsim.towns")

_DATA = read_module_toml(__file__)
_LIMITS = Limits(wall_s=120.0, cpu_s=120)
_LEFT_OUT = ("highway.steps", "highway.service", "highway.track")
_MOST_PER_HOUR = 100_000
_CLEANED = "clean.osm.xml"
# Of the walkable ground in one part: below it roads on islands go too.
_GOOD_SHARE = 0.965
# Of the walkable area: a town is not cut down to less than this for the sake of the share.
_LEAST_LEFT = 0.3

Stage = Callable[[str], None]
"""Is called with what starts now, in words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOrder:
    """What to import and where to put it."""

    # .osm, .osm.xml, plain, .gz or .bz2, or .osm.pbf; .xodr, plain or .gz, for an OpenDRIVE map.
    map_file: Path
    opendrive: bool = False
    bbox: Box | None = None  # west, south, east, north; None: all of the extract
    name: str
    split: str  # "train" or "test"
    out: Path  # the town's folder
    lefthand: bool | None = None  # None: as the country does
    seed: int = 42
    traffic: float = 1.0  # how dense, against `demand.MIX` or `per_hour`; 0: none
    # Departures an hour by SUMO vehicle class.
    per_hour: Mapping[str, float] = field(default_factory=dict)
    parked: float = 0.7  # share of the mapped parking spaces that is taken
    relief: Heights = field(default_factory=Heights)
    keep_service: bool = False  # driveways and yards too, each with a crossing of its own
    cycle_paths: bool = False  # whether chairs drive on them
    source: str = ""
    overwrite: bool = False  # a town that was edited


@dataclass(frozen=True, slots=True, kw_only=True)
class _Imported:
    """A town that was made, and what was found on the way."""

    town: Town
    side: Side
    walkable_share: float  # of the walkable ground, in its largest part
    notes: tuple[str, ...] = ()  # what the town does not have that the map or the order has
    left_out: LeftOut = field(default_factory=LeftOut)
    counts: Mapping[str, int] = field(default_factory=dict)  # of parked cars, crossings and stops


def import_town(
    order: ImportOrder,
    meanwhile: Callable[[Town], object] | None = None,
    stage: Stage = lambda text: None,
) -> _Imported:
    """Build the town and move it to `order.out`; a town there is replaced if it was not edited.

    Args:
        order: What and where to.
        meanwhile: Is called with the town, before it is in place, while another core tries its
            demand.
        stage: Is called before anything that takes long.

    Raises:
        TownError: The order or the extract cannot be used, or the folder holds something else or
            edited files.
        SumoError: One of SUMO's tools failed.
    """
    given, order = order.out, replace(order, out=order.out.resolve())
    _check(order)
    stage(f"reading {order.map_file}")
    extract = read_extract(order.map_file, order.bbox)
    if order.lefthand is None:
        side = side_at(*extract.box.centre)
    else:
        side = Side(lefthand=order.lefthand, why="as ordered")
    order = replace(order, bbox=extract.box, lefthand=side.lefthand)
    try:
        with write_folder_atomically(order.out) as work:
            made = _build(order, extract, side, work, meanwhile, stage)
    except (TownError, SumoError) as error:
        raise type(error)(f"town {order.name}, made of {order.map_file}: {error}") from None
    # It may have been this very folder.
    place = given if (given / f"{order.name}.sumocfg").is_file() else order.out
    return replace(made, town=open_town(place))


def import_opendrive(order: ImportOrder, stage: Stage) -> tuple[Town, tuple[str, ...]]:
    """Build the town of an OpenDRIVE map as `import_town` does; notes say what it lacks of the map.

    The map's sidewalks and cycle lanes are lanes of the net. Beside other streets netconvert
    guesses pavements.

    Raises:
        TownError: The order or the map cannot be used, or the folder holds something else or edited
            files.
        SumoError: One of SUMO's tools failed.
    """
    order = replace(order, out=order.out.resolve())
    _check(order)
    name, data = order.name, read_bytes(order.map_file, MAX_XML_BYTES)
    root = parse_root(data, escape(order.map_file))
    if root.tag.rpartition("}")[2] != "OpenDRIVE":
        raise TownError(
            f"{order.map_file}: is not an OpenDRIVE map (root <{escape(root.tag, 40)}>); "
            "expected <OpenDRIVE>"
        )
    stage("building the net")
    try:
        with write_folder_atomically(order.out) as work:
            (work / "opendrive").mkdir()
            (work / "map.xodr").write_bytes(data)
            net = read_net(_convert_net(order, "map.xodr", work))
            (work / "map.xodr").unlink()
            write_gzip(work / "opendrive" / f"{name}.xodr.gz", data)
            stage("adding routes, and testing the traffic")
            net_path = work / f"{name}.net.xml"
            ways = build_ways(net, net_path, work, order.seed) if order.traffic > 0 else ()
            (work / f"{name}.poly.xml").write_text("<additional/>\n", encoding="utf-8")
            write_scenario(work, name, order.seed, vtypes_text())
            write_demand(work / f"{name}.sumocfg", net, ways, order.seed, order.traffic)
            unnamed = f"OpenDRIVE map {order.map_file.name}; ask its author for the licence"
            order = replace(order, source=order.source or unnamed)
            notice = _DATA["notice"].format(name=name, source=order.source)
            (work / "LICENSE-DATA").write_text(notice, encoding="utf-8")
            _write_manifest(order, work, net)
    except (TownError, SumoError) as error:
        raise type(error)(f"town {name}, made of {order.map_file}: {error}") from None

    # What the map has and the town has not.
    sideways = (lane for lane in root.iterfind(".//{*}lane") if lane.get("id") != "0")
    lanes = Counter(lane.get("type") for lane in sideways)
    left = {what: len(root.findall(path)) for path, what in _DATA["lost"].items()}
    left |= {
        f"{kind} lanes": number for kind, number in lanes.items() if kind not in _DATA["lanes"]
    }
    left_out = ", ".join(f"{kind} ({number})" for kind, number in left.items() if number)
    lights = len({link.tls_id for link in net.connections if link.tls_id})
    no_sidewalks = "; the map has no sidewalks, so all pavements are guessed"
    note = (
        f"left out of the map: {left_out or 'nothing'}; traffic lights, "
        f"with netconvert's programs: {lights}{'' if lanes['sidewalk'] else no_sidewalks}"
    )
    return open_town(order.out), (note,)


def _check(order: ImportOrder) -> None:
    check_words(order.name, order.split)
    if order.bbox is not None:
        order.bbox.check()
    for vclass, rate in order.per_hour.items():
        if vclass not in CLASSES:
            raise TownError(
                f"unknown traffic class {vclass!r}; expected some of: {', '.join(CLASSES)}"
            )
        if not 0.0 <= rate <= _MOST_PER_HOUR:
            raise TownError(
                f"{rate} departures an hour of class {vclass}; expected 0 to {_MOST_PER_HOUR}"
            )
    if order.relief.dem is not None or order.relief.hill_m:
        check_installed("--dem and --hill need rasterio", "dem", "rasterio", error=TownError)
    check_place(order.out, overwrite=order.overwrite)


@dataclass(frozen=True, slots=True, kw_only=True)
class _BuiltNet:
    """A net, and the share of its walkable ground that hangs together."""

    net: Net
    share: float
    bridges: tuple[str, ...]  # names of those left out, for they pass over other streets
    drawn: frozenset[str]  # the ways of the map that it has, by their ids without a sign
    # Of these, those with lanes for walkers, and the squares that ways were added over.
    walked: Set[str]


def _build(
    order: ImportOrder,
    extract: Extract,
    side: Side,
    work: Path,
    meanwhile: Callable[[Town], object] | None,
    stage: Stage,
) -> _Imported:
    # 1. Count what the map has, before anything is taken out of it.
    name, mapped = order.name, map_ways(extract.root, extract.box)
    crossings_mapped, stops_mapped = (
        count_inside(extract.root, extract.box, kind) for kind in ("crossing", "bus_stop")
    )
    # 2. Build the net; the land before, so that a useless file of heights costs no time.
    stage(f"building the net of {_size(extract.box)}")
    (work / "osm").mkdir()
    write_gzip(work / "osm" / f"{name}.osm.xml.gz", extract.xml())
    dem = make_dem(order.relief, extract.box, order.seed)
    built = _build_net(order, extract.root, work)
    left_out = LeftOut.of(mapped, built.drawn, built.walked)
    # 3. Read what else the extract has. It is not needed any more then.
    stage("adding buildings, trees, parked cars and routes")
    poly, ground = (_convert_polygons(name, work, what) for what in ("poly", "ground"))
    marks = map_marks(built.net, poly, ground)
    for path in (work / _CLEANED, ground):
        path.unlink()
    # 4. Put the town on its land, and furnish it. Its types are those of the routes to come.
    net_path = work / f"{name}.net.xml"
    if dem is not None:
        land = lift_net(net_path, dem, order.relief)
        land.write(order.relief.max_grade, work / f"{name}.dem.tif")
        built = replace(built, net=read_net(net_path))
    lots, cars = find_parking(built.net, poly, order.parked, order.seed)
    ways = build_ways(built.net, net_path, work, order.seed) if order.traffic > 0 else ()
    write_scenario(work, name, order.seed, vtypes_text((*lots, *marks.elements)))
    # 5. Write what stands beside the scenario, and no routes until the demand is there.
    write_gzip(work / f"{name}.rou.xml.gz", b"<routes/>")
    notice = _DATA["license"] + _DATA["heights_license"] * (order.relief.dem is not None)
    source = f"\nSource, as told at the import: {order.source}\n" * bool(order.source)
    (work / "LICENSE-DATA").write_text(notice.format(name=name) + source, encoding="utf-8")
    bbox = ",".join(map(str, order.bbox or ()))
    (work / "osm" / "bbox").write_text(f"{bbox}\n", encoding="utf-8")
    _write_manifest(order, work, built.net)
    # 6. Try the demand on another core, while the caller uses the town.
    stage("building the street and testing the traffic")
    with ThreadPoolExecutor(1) as pool:
        traffic = order.seed, order.traffic, order.per_hour, cars
        demand = pool.submit(write_demand, work / f"{name}.sumocfg", built.net, ways, *traffic)
        if meanwhile is not None:
            meanwhile(_unfinished(work, order))
        demand.result()
    _write_manifest(order, work, built.net)
    counts = {
        "parked": len(cars),
        "crossings_mapped": crossings_mapped,
        "crossings_unpainted": marks.unpainted,
        "stops_mapped": stops_mapped,
        "stops": marks.stops,
    }
    return _Imported(
        town=_unfinished(work, order),
        side=side,
        walkable_share=built.share,
        notes=_notes(order, extract, built, ways, left_out, counts),
        left_out=left_out,
        counts=counts,
    )


def _build_net(order: ImportOrder, root: Element, folder: Path) -> _BuiltNet:
    """Write <name>.net.xml and the cleaned extract that it was made of; `root` is changed.

    The order has the box and the side of the traffic.

    Raises:
        TownError: The area has no streets, or nothing that can be walked on.
        SumoError: netconvert failed.
    """
    place = folder / f"{order.name}.net.xml"
    # 1. Clean the extract.
    filter_osm(root, bool(order.lefthand))
    bridges = cut_bridges(root, order.keep_service)
    squares = cross_squares(root, order.keep_service)
    # 2. Convert it, without footways that lie on islands.
    net = _converted(order, root, folder)
    if stray := stray_footways(net, place):
        net = _converted(order, root, folder, stray)
    # 3. Where much ground is still on islands, their streets go too.
    parts = walkable_parts(net, chair_ways(order.cycle_paths))
    if largest_share(parts) < _GOOD_SHARE and (stray := stray_ways(net, place, parts)):
        everything = list(root)
        least_m2 = _LEAST_LEFT * sum(part.area for part in parts)
        try:
            smaller = _converted(order, root, folder, stray)
            left = walkable_parts(smaller, chair_ways(order.cycle_paths))
        except TownError:  # nothing is left
            left = []
        area_m2 = sum(part.area for part in left)
        if largest_share(left) > largest_share(parts) and area_m2 >= least_m2:
            log.info("town %s: %d ways on islands were left out", order.name, len(stray))
            net, parts = smaller, left
        else:
            # That is no gain, so the town stays whole.
            root[:] = everything
            net = _converted(order, root, folder)
    # 4. Find out which ways of the map it has.
    walkable = {
        edge.id for edge in net.edges if any(lane.permits("pedestrian") for lane in edge.lanes)
    }
    drawn = osm_ways_by_edge(place)
    return _BuiltNet(
        net=net,
        share=largest_share(parts),
        bridges=bridges,
        drawn=frozenset(way for made_of in drawn.values() for way in made_of),
        walked=squares.union(
            way for edge, made_of in drawn.items() if edge in walkable for way in made_of
        ),
    )


def _converted(
    order: ImportOrder, root: Element, folder: Path, dropped: frozenset[str] = frozenset()
) -> Net:
    root[:] = [
        item for item in root if item.tag != "way" or item.get("id", "").lstrip("-") not in dropped
    ]
    strip_orphans(root)
    (folder / _CLEANED).write_bytes(xml_bytes(root))
    config = folder / "edges.netccfg"
    # Streets with a crossing on them are not joined there.
    lists = {"geometry.remove.keep-edges.explicit": crossed_edges(root)}
    place = _convert_net(order, _CLEANED, folder, by_file(lists, config))
    # Which edges have guessed pavements that the map denies shows only in the net.
    lists["sidewalks.guess.exclude"] = denied_pavements(root, read_net(place), place)
    if lists["sidewalks.guess.exclude"]:
        _convert_net(order, _CLEANED, folder, by_file(lists, config))
    config.unlink()
    drop_crossings(place, denied_crossings(root))
    net = read_net(place)
    if not net.lanes(LaneKind.WALKINGAREA) and not net.lanes(LaneKind.SIDEWALK, LaneKind.SHARED):
        raise _without("pavements", order)
    return net


def _convert_net(order: ImportOrder, extract: str, folder: Path, more: Sequence[str] = ()) -> Path:
    """Run netconvert on `extract` in `folder`, with `more` options, and with fewer when it fails.

    Raises:
        TownError: The net would be empty.
        SumoError: netconvert failed.
    """
    place = folder / f"{order.name}.net.xml"
    options = [*_net_options(order, extract, place.name), *more]
    # 1. Run netconvert, with ever fewer of the options that make it fail on some maps.
    first: ToolRun | None = None
    for step in _DATA["ladder"]:
        without = step["without"].split()
        left = [option for option in options if option not in without]
        run = run_tool("netconvert", [*left, *step["with"].split()], folder, _LIMITS)
        if not run.returncode and b"<lane" in place.read_bytes():
            if first is not None and first.returncode:
                warning = "town %s: %s; the net was built without %s"
                log.warning(warning, order.name, first.reason(), " ".join(without))
            return place
        first = first or run
        empty = not first.returncode or "No edges" in run.output or "No nodes" in run.output
        if order.opendrive or (empty and run.returncode):
            break
    # 2. Refuse the map.
    assert first is not None  # noqa: S101 - the ladder is not empty
    if empty:
        raise _without("streets", order)
    raise SumoError(f"no net could be built: {first.reason()}; check the map and the bounding box")


def _net_options(order: ImportOrder, extract: str, out: str) -> list[str]:
    """The options with which netconvert makes the net `out` of an extract."""
    typemaps = _DATA["opendrive-typemap" if order.opendrive else "typemaps"].split()
    maps = ",".join(str(sumo_home() / "data" / "typemap" / name) for name in typemaps)
    if order.opendrive:
        maps += f",{Path(__file__).with_name('opendrive.typ.xml')}"
        options = ["--opendrive-files", extract, "--type-files", maps]
        return [*options, *_DATA["opendrive"].split(), "-o", out]
    left_out = _LEFT_OUT[:1] if order.keep_service else _LEFT_OUT
    bbox = ",".join(map(str, order.bbox or ()))
    options = ["--osm-files", extract, "--type-files", maps, *_DATA["netconvert"].split()]
    options += ["--remove-edges.by-type", ",".join(left_out)]
    options += ["--keep-edges.in-geo-boundary", bbox, "-o", out]
    return options + ["--lefthand"] * bool(order.lefthand)


def _without(what: str, order: ImportOrder) -> TownError:
    driveways = ", or add --keep-service for driveways and yards"
    more = "" if order.opendrive or order.keep_service else driveways
    return TownError(
        f"no net could be built: the area has no {what}; "
        f"choose a larger or another bounding box{more}"
    )


def _convert_polygons(name: str, folder: Path, what: str) -> Path:
    """Run polyconvert on the cleaned extract, pruned to the net <name>.net.xml. Raises SumoError.

    Args:
        name: The town's.
        folder: Where extract and net are; <name>.<what>.xml is written.
        what: "poly" for what stands in a town, "ground" for squares and crossings.
    """
    types = Path(__file__).parent / f"{what}types.xml"
    options = ["--osm-files", _CLEANED, "--net-file", f"{name}.net.xml", "--type-file", str(types)]
    options += [*_DATA["polyconvert"].split(), "-o", f"{name}.{what}.xml"]
    run = run_tool("polyconvert", options, folder, _LIMITS)
    if run.returncode:
        run = run_tool("polyconvert", [*options, "--ignore-errors"], folder, _LIMITS)
    if run.returncode:
        raise SumoError(f"buildings could not be read: {run.reason()}; check the extract")
    return folder / f"{name}.{what}.xml"


def _notes(
    order: ImportOrder,
    extract: Extract,
    built: _BuiltNet,
    ways: tuple[Way, ...],
    left_out: LeftOut,
    counts: Mapping[str, int],
) -> tuple[str, ...]:
    """What map or order have and the town has not, and what became of crossings and stops."""
    found = []
    if built.bridges:
        names = join_names(built.bridges, 8)
        found.append(f"left out: bridges over other streets, because a town has one level: {names}")
    found_for = {way.traffic.vclass for way in ways}
    ordered = [
        vclass for vclass, rate in order.per_hour.items() if rate > 0.0 and order.traffic > 0
    ]
    idle = [vclass for vclass in ordered if vclass not in found_for]
    found += [
        f"no traffic of class {vclass}: no street or track of this town allows it"
        for vclass in idle
    ]
    found += left_out.notes
    found.append(
        f"the map has {counts['crossings_mapped']} crossings, the net "
        f"{len(built.net.lanes(LaneKind.CROSSING))}: the others are guessed; "
        f"{counts['crossings_unpainted']} are unpainted (guessed or unmarked, and without a signal)"
    )
    if counts["stops_mapped"] or counts["stops"]:
        found.append(
            f"the map has {counts['stops_mapped']} bus stops, the town {counts['stops']}: "
            "only those beside a lane open to buses (bus stations need --keep-service)"
        )
    if counts["parked"]:
        found.append(f"{counts['parked']} parked cars never drive")
    if not extract.bounded:
        found.append(
            f"the extract has no bounds, so all of it ({_size(extract.box)}) was imported: "
            f"{extract.box.option}"
        )
    return tuple(found)


def _size(box: Box) -> str:
    wide_m, high_m = box.size_m
    return f"{wide_m / 1e3:.1f} x {high_m / 1e3:.1f} km"


def _unfinished(work: Path, order: ImportOrder) -> Town:
    """The town without its demand, which is still being tried."""
    town = open_town(work / f"{order.name}.sumocfg")
    return replace(town, routes=())


def _write_manifest(order: ImportOrder, work: Path, net: Net) -> None:
    low_m, high_m = net.corners_m()
    middle_m = 0.5 * (low_m + high_m)
    text = town_toml_text(
        name=order.name,
        split=order.split,
        origin_m=(round(float(middle_m[0])), round(float(middle_m[1]))),
        cycle_paths=order.cycle_paths,
        hashes=hash_files(work, order.name),
        source=order.source,
        attribution="" if order.opendrive else "(c) OpenStreetMap contributors, ODbL 1.0",
        rebuild=_rebuild_command(order),
    )
    (work / "town.toml").write_text(text, encoding="utf-8")


def _rebuild_command(order: ImportOrder) -> str:
    """The command that makes the same town again from what its folder holds, run in that folder."""
    words = ["--name", order.name, "--split", order.split]
    if order.opendrive:
        words += ["--opendrive", f"opendrive/{order.name}.xodr.gz"]
    else:
        words += ["--osm", f"osm/{order.name}.osm.xml.gz"]
    words += ["--out", ".", *([order.bbox.option] if order.bbox is not None else [])]
    words += [] if order.opendrive else ["--lefthand" if order.lefthand else "--righthand"]
    words += ["--seed", str(order.seed), "--traffic", f"{order.traffic:g}"]
    words += [] if order.opendrive else ["--parked", f"{order.parked:g}"]
    if order.per_hour:
        rates = ",".join(f"{vclass}={rate:g}" for vclass, rate in order.per_hour.items())
        words += ["--per-hour", rates]
    if order.relief.dem is not None:
        words += ["--dem", f"{order.name}.dem.tif"]
    if order.relief.hill_m:
        words += ["--hill", f"{order.relief.hill_m:g}"]
    if order.relief.dem is not None or order.relief.hill_m:
        words += ["--max-grade", f"{order.relief.max_grade:g}"]
    words += ["--keep-service"] * order.keep_service + [CYCLE_PATHS] * order.cycle_paths
    words += ["--source", order.source] if order.source else []
    return shlex.join(["wcsim", "town", "import", *words])
