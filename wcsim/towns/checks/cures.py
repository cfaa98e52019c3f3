"""Commands that cure what is wrong with a town, as they can be typed, with the files' places.

What is to be done by hand stands before the command, which goes on to the end of its line.
"""

import math
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

from wcsim.core.own_folder import create_temporary_folder
from wcsim.errors import SumoError, TownError
from wcsim.towns.osm.read import Box
from wcsim.towns.scenario.files import with_included
from wcsim.towns.scenario.options import read_configuration
from wcsim.towns.scenario.town import Town, own_work
from wcsim.towns.sumo.net import WALK_KINDS, LaneKind, net_of, read_net
from wcsim.towns.sumo.tools import Limits, by_file, run_tool, sumo_home
from wcsim.towns.sumo.xml_io import parse_root, read_bytes, read_root, without_comments

_HOUR_S = 3600.0
_ROUTED = "better.rou.xml"
FOR_ROUTES = frozenset(
    (
        "vType", "vTypeDistribution", "route", "routeDistribution", "taz", "tazs",
        "busStop", "trainStop", "containerStop", "chargingStation", "parkingArea"
    )
)  # fmt: skip
"""Elements of additional files that a demand needs to be routed."""
DEADLY = "calibrator"  # duarouter 1.28 dies of one that has flows
ENOUGH_SHARE = 0.95  # of the walkable area, in one part
PAVED_LATER = "the check of the paved copy says how to add them"
_WIDER = 0.3  # of a box's size, on each of its sides
FASTEST_MPS = 13.9  # 50 km/h: faster streets get no pavement by default
_SLOWEST_MPS = 1.0  # of streets that get one
_LIMITS = Limits(wall_s=300.0, cpu_s=280)


class Cures:
    """The commands that cure one town."""

    def __init__(self, town: Town) -> None:
        self._town = town
        self._sumocfg, self._net = _path(town.sumocfg), _path(town.net)
        self._outside = " --allow-outside" if town.border is None else ""

    def pave(self, out: Path | None = None) -> str:
        """The command that adds pavements to a scenario, tried on its net, or why there is none."""
        net = read_net(self._town.net)
        share, limit_mps = self.paved_share(FASTEST_MPS), FASTEST_MPS
        # Fast streets are paved only where the ways on foot do not hang together without them.
        fastest_mps = max(net.speeds_mps.values(), default=0.0)
        if share < ENOUGH_SHARE and fastest_mps > FASTEST_MPS:
            more = self.paved_share(fastest_mps)
            if more > share:
                share, limit_mps = more, fastest_mps
        if not share and fastest_mps:
            return f"netconvert finds no place for pavements in it; draw them: {self.netedit()}"
        if not share:
            return "no street is open to cars, so no pavement can be added; choose another scenario"
        # Not where an earlier try lies.
        place = out or Path(f"{self._town.name}-paved")
        while place.exists():
            place = place.with_name(f"{place.name}-2")
        what = "crossings and walking areas" if net.paved_streets else "pavements and crossings"
        return f"add {what}: {self.pave_into(place, limit_mps)}"

    def paved_share(self, fastest_mps: float) -> float:
        """The walkable share in one part after `town pave`; 0 where it adds nothing to walk on."""
        # It loads what builds streets, which --help must not.
        from wcsim.towns.walking.islands import largest_share, walkable_parts

        try:
            data = self.add_pavements(self._town.net, fastest_mps)
            net = net_of(parse_root(data, "the paved net"), "the paved net")
        except (SumoError, TownError):
            return 0.0
        kinds = *WALK_KINDS, LaneKind.WALKINGAREA, LaneKind.CROSSING
        before, after = (len(each.lanes(*kinds)) for each in (read_net(self._town.net), net))
        joined = after > before and net.lanes(LaneKind.WALKINGAREA)
        return largest_share(walkable_parts(net, self._town.file.chair_ways)) if joined else 0.0

    @staticmethod
    def add_pavements(path: Path, fastest_mps: float) -> bytes:
        """A net with pavements beside streets of up to `fastest_mps`, crossings and walking areas.

        Raises:
            TownError: It is not a net.
            SumoError: netconvert failed.
        """
        # Tracks, paths and closed streets get no pavement.
        bare = [edge.id for edge in read_net(path).streets if not edge.has(LaneKind.MOTOR)]
        with create_temporary_folder() as folder:
            given, made = folder / "given.net.xml", folder / "made.net.xml"
            given.write_bytes(read_bytes(path))
            options = ["-s", given.name, "-o", made.name]
            options += ["--sidewalks.guess", "--crossings.guess", "--walkingareas"]
            options += ["--sidewalks.guess.min-speed", str(_SLOWEST_MPS)]
            options += ["--sidewalks.guess.max-speed", str(fastest_mps)]
            options += ["--crossings.guess.speed-threshold", str(fastest_mps)]
            # Crossings lie on internal links, and netconvert gives none to a net without them.
            options += ["--offset.disable-normalization", "--no-internal-links", "false"]
            options += by_file({"sidewalks.guess.exclude": bare}, folder / "unpaved.netccfg")
            run = run_tool("netconvert", [*options, "--xml-validation", "never"], folder, _LIMITS)
            if run.returncode or not made.is_file():
                raise SumoError(
                    f"{path.name}: cannot be given pavements: {run.reason()}; repair it in netedit"
                )
            return without_comments(made.read_bytes())

    def pave_into(self, out: Path, fastest_mps: float) -> str:
        """The command that paves a scenario into a new folder, streets up to `fastest_mps` too."""
        options = f" --max-speed {math.ceil(fastest_mps)}" if fastest_mps > FASTEST_MPS else ""
        return (
            f"wcsim town pave {self._sumocfg} --out {shlex.quote(str(out))}{self._outside}{options}"
        )

    def traffic_alone(self) -> str:
        """The command that runs a scenario's traffic without wheelchairs."""
        return f"wcsim town run {self._sumocfg} --chairs 0{self._outside}"

    def netedit(self) -> str:
        """The command that opens a town's net to be changed by hand."""
        return f"{_tool('netedit')} -s {self._net}"

    def walkers(self) -> str:
        """The command that makes walkers for the scenario's own time, for an hour of it at most.

        Raises:
            TownError: the scenario's begin or end is no time.
        """
        begin_s, end_s = self.own_time()
        tool = shlex.join([sys.executable, str(sumo_home() / "tools" / "randomTrips.py")])
        return (
            f"create walkers.rou.xml with this command, and name it in {self._sumocfg}, "
            f'within <input>, in the value of <route-files value="..."/>: {tool} -n {self._net} '
            "--pedestrians --prefix walker "
            f"-b {begin_s:.12g} -e {min(end_s, begin_s + _HOUR_S):.12g} "
            f"-r {self._beside('walkers.rou.xml')} -o {self._beside('walkers.trips.xml')}"
        )

    def own_time(self) -> tuple[float, float]:
        """Begin and end of the scenario in s; without an end it takes an hour. Raises TownError."""
        config = read_configuration(self._town.sumocfg)
        begin_s, end_s = config.seconds("begin", "0"), config.seconds("end", "-1")
        return begin_s, end_s if end_s > begin_s else begin_s + _HOUR_S

    @staticmethod
    def signals(net: Path) -> str:
        """The command that gives a net netconvert's signal programs, with walkers' phases."""
        tool = _tool("netconvert")
        return (
            f"rebuild all programs in the net: {tool} -s {_path(net)} --tls.rebuild -o {_path(net)}"
        )

    def again(self, task: str, rebuild: str) -> str:
        """A task, the work that it discards, and the command that builds a town again."""
        folder = self._town.folder
        work = own_work(folder)
        lost = f" (this discards your changes to {', '.join(work)})" if work else ""
        command = f"cd {shlex.quote(str(folder.resolve()))} && {rebuild}"
        return f"{task}{lost}: {command}{' --replace' * bool(work)}"

    def larger(self) -> str:
        """The command that imports more around a town: its own extract was cut to its box."""
        words = shlex.split(self._town.file.rebuild)
        try:
            at = next(number for number, word in enumerate(words) if word.startswith("--bbox="))
            box, osm = Box.of(words[at].removeprefix("--bbox=")), words.index("--osm")
        except (StopIteration, ValueError):  # a town.toml may say anything
            return f"join the parts: {self.netedit()}"
        words[at] = box.grown(_WIDER * max(box.size_m)).option
        del words[osm : osm + 2]
        return self.again("take a larger area from the internet", shlex.join(words))

    def grade(self) -> str:
        """The command that flattens a town's steepest streets."""
        return (
            f"create better.net.xml with this command, and name it in {self._sumocfg}: "
            f"{_tool('netconvert')} -s {self._net} "
            f"--geometry.max-grade 12 --geometry.max-grade.fix -o {self._beside('better.net.xml')}"
        )

    def routes(self) -> str:
        """The command that routes a town's demand again and drops what finds no way."""
        town = self._town
        read = {path: _whole(path, town) for path in town.additional}
        needed = [
            path
            for path, parts in read.items()
            if any(item.tag in FOR_ROUTES for root in parts.values() for item in root)
        ]
        inside = {path: root for named in needed for path, root in read[named].items()}
        typed = [path.name for path, root in inside.items() if _has_types(root)]
        demand = [root for path in town.routes for root in _whole(path, town).values()]
        twice = typed if any(map(_has_types, demand)) else []
        deadly = [path.name for path, root in inside.items() if root.find(DEADLY) is not None]
        more = f" -a {_paths(needed)}" if needed else ""
        # SUMO takes each type once.
        more += " --vtype-output /dev/null" if typed and not twice else ""
        return (
            f"{_by_hand(deadly, twice)}"
            f"create {_ROUTED} with this command, and name it in {self._sumocfg}: "
            f"{_tool('duarouter')} -n {self._net} -r {_paths(town.routes)}{more} "
            f"--unsorted-input --ignore-errors -o {self._beside(_ROUTED)}"
        )

    def _beside(self, name: str) -> str:
        return _path(self._town.sumocfg.with_name(name))


def _by_hand(deadly: list[str], twice: list[str]) -> str:
    """What has to be done to files of these names before a demand is routed again."""
    first = ""
    if deadly:
        first += f"move each <{DEADLY}> of {', '.join(deadly)} into a file of its own, "
    if twice:
        first += f"remove the vehicle types from {', '.join(twice)}, "
        first += f"because {_ROUTED} will contain them, "
    return first


def _whole(path: Path, town: Town) -> dict[Path, Element]:
    """The roots of a file and of all that it includes, for duarouter reads these with it."""
    return {part: read_root(part) for part in with_included((path,), town.border)}


def _has_types(root: Element) -> bool:
    return any(element.tag in ("vType", "vTypeDistribution") for element in root.iter())


def _tool(name: str) -> str:
    """One of SUMO's, where the installed wheel has it: it need not be on the PATH."""
    return shlex.quote(str(sumo_home() / "bin" / name))


def _path(path: Path) -> str:
    return _paths([path])


def _paths(paths: Sequence[Path]) -> str:
    """Several as SUMO's tools take them."""
    return shlex.quote(",".join(str(path.resolve()) for path in paths))
