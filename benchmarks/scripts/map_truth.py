"""`python -m benchmarks map_truth`: towns against the raw map they were made of, counted without the importer."""

from dataclasses import dataclass

from rich import box

from wcsim.cli.shared.common import Bounds, OutFile, split_nonempty_list, write_json
from wcsim.cli.shared.consoles import show_table
from wcsim.errors import TownError
from wcsim.towns.scenario.town import Town, find_town


@dataclass
class MapTruthOptions:
    """Count pavements, crossings, kerbs and squares that a town has otherwise than its map."""

    towns: str = "helsinki,monaco,manhattan"
    """Towns: each a town's name, its folder, or a .sumocfg file, separated by commas."""
    routes: int = 400
    """Ways on foot to draw in each town."""
    seed: int = 0
    """Seed of where they start and end."""
    json: OutFile = None
    """Write the counts to this file."""


def run(options: MapTruthOptions) -> int:
    """Count and print."""
    Bounds(1, 100_000).check("--routes", options.routes)
    towns = [find_town(name) for name in split_nonempty_list("--towns", options.towns)]
    counts = {town.name: _count(town, options) for town in towns}
    names = next(iter(counts.values()))
    rows = [[name, *(f"{round(each[name], 1):,.9g}" for each in counts.values())] for name in names]
    show_table(["", *counts], rows, box=box.SIMPLE_HEAD)
    if options.json is not None:
        write_json(options.json, counts)
    return 0


def _count(town: Town, options: MapTruthOptions) -> dict[str, float]:
    """All counts of a town, by what is counted."""
    import numpy as np
    import sumolib

    from benchmarks.map_truth import denied_pavements, mapped_places
    from benchmarks.map_truth.raw_map import read_raw_map
    from wcsim.towns.street import load_street

    maps = sorted((town.folder / "osm").glob("*.osm.xml.gz"))
    if len(maps) != 1:
        raise TownError(f"{town.folder}: has {len(maps)} files osm/*.osm.xml.gz, expected one: import it from a map")
    net = sumolib.net.readNet(str(town.net), withInternal=True)
    raw, street = read_raw_map(maps[0], net), load_street(town)
    origin_net_m = np.array(street.net_origin_m[:2])
    stretches = denied_pavements.judge_lanes(net, raw)
    crossings = mapped_places.Crossings(net)
    return {
        **denied_pavements.count_lanes(stretches, raw),
        **denied_pavements.count_routes(street.walk, origin_net_m, stretches, raw, options.routes, options.seed),
        **mapped_places.count_crossings(crossings, raw, street.grid, origin_net_m),
        **mapped_places.count_kerbs(crossings, raw, street.grid, origin_net_m),
        **mapped_places.count_squares(net, raw, street.grid, origin_net_m),
    }
