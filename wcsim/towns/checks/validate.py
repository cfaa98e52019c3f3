"""Is a net safe to open in this process? SUMO dies on broken ones, so a child opens it first."""

import hashlib
import itertools
import math
from pathlib import Path
from xml.etree.ElementTree import Element

from wcsim.core.own_folder import create_temporary_folder
from wcsim.errors import SumoError, TownError
from wcsim.towns.cache.folder import cache_folder, write_verdict
from wcsim.towns.checks.cures import Cures
from wcsim.towns.scenario.files import FilteredFiles
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.net import scan_numbers
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.sumo.xml_io import MAX_XML_BYTES, parse_root, read_bytes
from wcsim.types import Street

_CHECK = 5  # raise it when the check becomes stricter
_LIMITS = Limits(wall_s=60.0, cpu_s=50, memory_bytes=3 << 30, file_bytes=1 << 20)
_SMALLEST_M, LARGEST_M = 1.0, 500e3
# A lane is drawn so many times as long as its length, and longer than this.
_STRETCHED, _STRETCHED_M = 20.0, 2000.0


def validate_net(net: Path, *, border: Path | None = None) -> None:
    """Return when SUMO can open a net, from memory of an equal net where there is one.

    Args:
        net: The file.
        border: The folder outside of which nothing is opened; by default the net's own.

    Raises:
        TownError: It is not a net, or SUMO refuses it or dies of it; the message has one or two
            lines.
    """
    data = read_bytes(net, MAX_XML_BYTES)
    verdict = cache_folder() / f"net-{hashlib.sha256(data + bytes([_CHECK])).hexdigest()[:32]}.ok"
    if verdict.is_file():
        return
    _scan_net(parse_root(data, str(net)), str(net))
    with create_temporary_folder() as work:
        files = FilteredFiles(work, border or net.parent)
        # A net may name outputs too, which must not appear anywhere.
        safe = files.place(net, net)
        options = ["-n", str(safe.resolve()), "--end", "1", "--no-step-log", "--no-warnings"]
        try:
            run = run_tool("sumo", [*options, "--xml-validation", "never"], work, _LIMITS)
        except SumoError as error:
            why = f"SUMO could not open this net ({error})"
            raise TownError(f"{net}: {why}; build it again with netconvert") from None
    if run.returncode:
        why = f"SUMO cannot open this net ({run.reason()})"
        raise TownError(f"{net}: {why}; build it again with netconvert")
    if len(files.read) == 1:  # what a net includes may change while its own bytes stay
        write_verdict(verdict)


def require_pavement(street: Street, town: Town) -> None:
    """Raise TownError, with the cure, when a town has nothing that a wheelchair can drive on."""
    if not street.walk.edges:
        cures = Cures(town)
        raise TownError(
            f"{town.net}: has no pavement, walking area or crossing, so a wheelchair cannot drive "
            f"there (without wheelchairs it runs: {cures.traffic_alone()}); {cures.pave()}"
        )


def _scan_net(root: Element, where: str) -> None:
    """Refuse what is no net at all, before any simulator sees it. Raises TownError."""
    if root.tag != "net":
        raise TownError(
            f"{where}: its root element is <{root.tag}>; expected <net>: build it with netconvert"
        )
    edges = [edge for edge in root.iterfind("edge") if edge.find("lane") is not None]
    if not edges:
        raise TownError(
            f"{where}: has no edge with lanes; expected a street net: build it with netconvert"
        )
    if root.find("junction") is None:
        raise TownError(
            f"{where}: has no junction; expected a street net: build it with netconvert"
        )
    scan_numbers(root, where)
    _scan_size(root, edges, where)
    _scan_shapes(root, edges, where)


def _scan_size(root: Element, edges: list[Element], where: str) -> None:
    """Refuse a town of less than a metre or of hundreds of kilometres. Raises TownError."""
    # A town of less than a metre was never projected: its coordinates are degrees. Lanes are drawn
    # metres wide around them, so what counts is how far its junctions are from each other.
    again = "build it again from the same files, with netconvert's option --proj.utm"
    lanes = [lane for edge in edges for lane in edge.iterfind("lane")]
    span_m = _span_m([place for lane in lanes for place in _places(lane)])
    junctions = root.iterfind("junction")
    nodes = [node for node in junctions if node.get("type") != "internal" and node.get("y")]
    places = [(float(node.get("x", "0")), float(node.get("y", "0"))) for node in nodes]
    least_m = min(_span_m(places) or span_m, span_m)
    if len(edges) > 1 and 0.0 < least_m < _SMALLEST_M:
        raise TownError(
            f"{where}: is only {least_m:.4f} m across; its coordinates look like degrees; "
            f"expected metres: {again}"
        )
    if span_m > LARGEST_M:
        raise TownError(
            f"{where}: is {span_m / 1e3:.0f} km across; "
            f"expected at most {LARGEST_M / 1e3:.0f} km: {again}"
        )


def _scan_shapes(root: Element, edges: list[Element], where: str) -> None:
    """Refuse lanes and junctions that are drawn to places far away. Raises TownError."""
    # One such lane makes a small town hundreds of kilometres large.
    streets = [edge for edge in edges if edge.get("function") != "walkingarea"]
    for lane in (lane for edge in streets for lane in edge.iterfind("lane")):
        drawn_m = sum(math.dist(*ends) for ends in itertools.pairwise(_places(lane)))
        if drawn_m > max(_STRETCHED_M, _STRETCHED * float(lane.get("length") or 0.0)):
            raise TownError(
                f"{where}: lane {lane.get('id')!r} is {lane.get('length')} m long and drawn over "
                f"{drawn_m:.0f} m; expected similar lengths: build it again with netconvert"
            )
    # So does a junction whose outline reaches there.
    for junction in root.iterfind("junction"):
        outline = _places(junction)
        reach_m = max((math.dist(outline[0], place) for place in outline), default=0.0)
        if reach_m > _STRETCHED_M:
            raise TownError(
                f"{where}: junction {junction.get('id')!r} is {reach_m:.0f} m across; "
                f"expected at most {_STRETCHED_M:.0f} m: build it again with netconvert"
            )


def _span_m(places: list[tuple[float, float]]) -> float:
    """How far places reach over, along the longer side."""
    return max((max(side) - min(side) for side in zip(*places, strict=True)), default=0.0)


def _places(element: Element) -> list[tuple[float, float]]:
    """The points of a shape in the plane."""
    points = [place.split(",") for place in element.get("shape", "").split()]
    return [(float(point[0]), float(point[1])) for point in points if len(point) > 1]
