"""Make a town without a map: the same seed gives the same bytes, another seed another town."""

from __future__ import annotations

import logging
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from shapely.errors import GEOSException

from wcsim.core.seeding import derive, generator
from wcsim.errors import SumoError, TownError
from wcsim.towns.importing.demand import Way, build_ways, flows_text, vtypes_text
from wcsim.towns.importing.elevation import Heights, hill_over
from wcsim.towns.importing.folder_texts import sumocfg_text, town_toml_text
from wcsim.towns.importing.jam_trial import write_tried
from wcsim.towns.importing.lift import lift_own_net
from wcsim.towns.importing.map_marks import map_marks
from wcsim.towns.importing.parking import Parking, find_parking
from wcsim.towns.importing.work_folder import check_place, check_words, move_in_place, workplace
from wcsim.towns.making.drawn_map import draw_map
from wcsim.towns.making.named_streets import streets_of
from wcsim.towns.making.plain_net import draw_signals, write_net
from wcsim.towns.making.plan import draw_plan
from wcsim.towns.making.shaping import shape_plan
from wcsim.towns.making.wishes import KINDS, Wishes, check_wishes
from wcsim.towns.scenario.manifest import chair_ways, hashes_of
from wcsim.towns.scenario.town import Town, net_middle, open_town, read_town_file
from wcsim.towns.sumo.net import LaneKind, Net, read_net
from wcsim.towns.sumo.xml_io import without_comments, write_gzip
from wcsim.towns.walking.islands import share_of, walkable_parts

log = logging.getLogger("wcsim.towns")

Stage = Callable[[str], None]  # what begins now, in words
_ATTEMPTS = 10  # at streets that hang together
_GOOD_SHARE = 0.97  # of the walkable ground in one part
_LEAST_CROSSINGS = 6
_HILLS_M = (0.0, 0.0, 4.0, 10.0, 18.0, 30.0)
_GRADES = (0.04, 0.12)
_LAND_M = 100.0  # beyond the streets
SOURCE = "made by wcsim: streets by SUMO's netgenerate, no map"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Ground:
    """The streets of a town before anything stands in them."""

    net: Net
    path: Path
    kind: str


def make_town(
    folder: Path,
    seed: int,
    wishes: Wishes | None = None,
    *,
    name: str = "",
    overwrite: bool = False,
    stage: Stage = lambda told: None,
) -> Town:
    """Generate a town from a seed; it replaces a generated town in the folder that was not edited.

    Args:
        folder: Folder of the town.
        seed: Seed of the whole town, 0 to MOST_SEED.
        wishes: Properties that the seed does not choose.
        name: The town's name; by default that of its folder.
        overwrite: Also replace an imported or edited town.
        stage: Called with the name of each stage when it begins.

    Raises:
        TownError: seed, name or wishes cannot be used, or the folder holds something else or an edited town.
        SumoError: one of SUMO's tools failed.
    """
    wishes = wishes or Wishes()
    out = folder.resolve()
    name = name or out.name
    check_words(name, wishes.split)
    check_wishes(seed, wishes)
    check_place(out, overwrite=overwrite)
    if not overwrite:
        _check_made(out)
    with workplace(name, out) as work:
        stage("drawing the streets")
        ground = _ground(name, seed, wishes, work)
        stage("adding buildings, furniture, parked cars and routes")
        _fill(name, seed, wishes, ground, work, stage)
        move_in_place(work, out)
    return open_town(folder if (folder / f"{name}.sumocfg").is_file() else out)


def _check_made(out: Path) -> None:
    """Raise TownError when a folder holds a town that was imported."""
    if (out / "town.toml").is_file() and "town make" not in read_town_file(out / "town.toml").rebuild:
        raise TownError(
            f"{out} contains an imported town; choose another name or --out, or use --replace, which deletes it"
        )


def _ground(name: str, seed: int, wishes: Wishes, work: Path) -> _Ground:
    """Streets that hang together: some drawn ones do not, and others are drawn then. Raises TownError."""
    kind = wishes.kind or str(generator(seed, "making", "kind").choice(KINDS))
    for attempt in range(_ATTEMPTS):
        rng = generator(seed, "making", "streets", attempt)
        try:
            shaped = shape_plan(draw_plan(kind, wishes.size_m, derive(seed, "making", attempt), rng, work), rng)
            streets = streets_of(shaped, rng)
            path = write_net(name, shaped, streets, draw_signals(rng), work, rng)
            net = read_net(path)
            share = share_of(walkable_parts(net, chair_ways(cycle_paths=False)))
        except (SumoError, TownError, GEOSException) as error:  # GEOS fails at some junctions' outlines
            log.info("town %s, attempt %d: %s", name, attempt, error)
            continue
        if share >= _GOOD_SHARE and len(net.lanes(LaneKind.CROSSING)) >= _LEAST_CROSSINGS:
            return _Ground(net=_lifted(path, seed, wishes), path=path, kind=kind)
    raise TownError(
        f"town {name}: no connected {kind} streets of {wishes.size_m:g} m were found in {_ATTEMPTS} attempts; "
        "use another seed, or a larger size"
    )


def _lifted(path: Path, seed: int, wishes: Wishes) -> Net:
    """The net on its land, which is level or a few broad bumps."""
    rng = generator(seed, "making", "land")
    hill_m, grade = float(rng.choice(_HILLS_M)), float(rng.uniform(*_GRADES))
    hill_m = hill_m if wishes.hill_m is None else wishes.hill_m
    if hill_m > 0.0:
        points_m = np.concatenate([lane.points_m for edge in read_net(path).edges for lane in edge.lanes])
        low_m, high_m = points_m.min(axis=0) - _LAND_M, points_m.max(axis=0) + _LAND_M
        box_m = (float(low_m[0]), float(low_m[1]), float(high_m[0]), float(high_m[1]))
        lift_own_net(path, hill_over(hill_m, box_m, seed), Heights(hill_m=hill_m, max_grade=grade))
    return read_net(path)


def _fill(name: str, seed: int, wishes: Wishes, ground: _Ground, work: Path, stage: Stage) -> None:
    """Write all files of the town's folder."""
    poly, marks_path, left = draw_map(ground.net, work, generator(seed, "making", "map"))
    marks = map_marks(ground.net, poly, marks_path)
    parking = find_parking(ground.net, poly, wishes.parked, seed)
    ways = build_ways(ground.net, ground.path, work, seed) if wishes.traffic > 0.0 else ()
    routes, additional = f"{name}.rou.xml.gz", (f"{name}.add.xml", f"{name}.poly.xml.gz")
    (work / additional[0]).write_text(vtypes_text((*parking.areas, *marks.elements, *left)), encoding="utf-8")
    (work / f"{name}.sumocfg").write_text(sumocfg_text(name, seed, routes, additional), encoding="utf-8")
    for source, kind in ((ground.path, "net"), (poly, "poly")):
        write_gzip(work / f"{name}.{kind}.xml.gz", without_comments(source.read_bytes()))
        source.unlink()
    marks_path.unlink()
    stage("testing the traffic")
    write_tried(work / f"{name}.sumocfg", ways, lambda some: _flows(ground.net, some, seed, wishes, parking))
    text = town_toml_text(
        name=name,
        split=wishes.split,
        origin_m=net_middle(work / f"{name}.net.xml.gz"),
        source=SOURCE,
        rebuild=rebuild_command(name, seed, wishes),
        hashes=hashes_of(work, name),
    )
    (work / "town.toml").write_text(text, encoding="utf-8")


def _flows(net: Net, ways: tuple[Way, ...], seed: int, wishes: Wishes, parking: Parking) -> str:
    return flows_text(net, ways, seed, wishes.traffic, first=parking.vehicles)


def rebuild_command(name: str, seed: int, wishes: Wishes) -> str:
    """The command that makes the same town again, run in its folder."""
    words = [name, "--seed", str(seed), "--out", ".", "--split", wishes.split, "--size", f"{wishes.size_m:g}"]
    words += ["--kind", wishes.kind] if wishes.kind else []
    words += ["--traffic", f"{wishes.traffic:g}", "--parked", f"{wishes.parked:g}"]
    words += ["--hill", f"{wishes.hill_m:g}"] if wishes.hill_m is not None else []
    return shlex.join(["wcsim", "town", "make", *words])
