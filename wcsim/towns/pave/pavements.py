"""Pavements for a scenario that has none: a copy that SUMO runs, with stops where they lay.

netconvert puts phases of its own into the author's signal programs in the net; they are restored.
"""

import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from wcsim.core.files import write_folder_atomically
from wcsim.core.reading import TOWN, join_names, read_text
from wcsim.errors import TownError
from wcsim.towns.checks.cures import FASTEST_MPS, Cures
from wcsim.towns.importing.adopt import copy_scenario
from wcsim.towns.importing.folder_texts import check_new
from wcsim.towns.pave.elements import Paving
from wcsim.towns.scenario.files import without_namespaces
from wcsim.towns.scenario.options import read_configuration
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.net import LaneKind, Net, net_of, read_net
from wcsim.towns.sumo.xml_io import read_bytes, write_gzip, xml_bytes

_MOST_NAMES = 5  # of each kind of thing in a note
_HEAD = re.compile(
    rb"""(?s)(?:\xef\xbb\xbf)?\s*"""
    rb"""(?:<\?xml[^>]*?(?:encoding\s*=\s*["'](?P<encoding>[\w.-]+)["'][^>]*)?\?>)?"""
    rb"""(?:\s|<!--.*?-->)*"""
)
_PACKED = b"\x1f\x8b"


@dataclass(frozen=True, slots=True, kw_only=True)
class Paved:
    """A scenario that has got pavements."""

    sumocfg: Path
    streets: int  # edges with a new pavement
    had: int  # edges that had one before
    crossings: int  # added
    walkingareas: int  # added
    placed: int  # stops, detectors, ... that lie on a lane
    programs: int  # of signals, that were given the new links
    # Places that a junction has grown over, and how far they gave way.
    moved_m: tuple[tuple[str, float], ...]
    # With the fast streets too: the walkable share in one part, and the command; or 0, "".
    faster: tuple[float, str]
    notes: tuple[str, ...]


def pave_town(town: Town, out: Path, fastest_mps: float = FASTEST_MPS) -> Paved:
    """Copy a scenario into the new folder `out`, with pavements, crossings and walking areas.

    Stops, detectors and departures by lane move to the lane that they meant, signal programs get
    letters for the new crossings. No other value in the files is changed.

    Args:
        town: A scenario whose net has no crossings.
        out: A folder that is not there yet, or is empty.
        fastest_mps: Faster streets get no pavement.

    Raises:
        TownError: The net has crossings already, or can get none, or a file cannot be copied or
            changed.
        SumoError: netconvert failed.
    """
    check_new(out)
    net = read_net(town.net, town.file.origin_m)
    if net.lanes(LaneKind.CROSSING):
        raise TownError(
            f"{town.net}: has pavements and crossings already, and more would break them; "
            f"connect the parts: {Cures(town).netedit()}"
        )
    config = read_configuration(town.sumocfg)
    with write_folder_atomically(out) as work:
        # 1. Copy it. Of a town.toml the hashes stay behind, for the files are others now.
        declared = town.folder if town.declared else None
        base, files = copy_scenario(config, town.border, work, declared)
        toml = town.folder / "town.toml"
        if toml.is_file():
            text = read_text(toml, TOWN).partition("\n[hashes]")[0].rstrip("\n")
            _place_of(toml, base, work).write_text(f"{text}\n", encoding="utf-8")
        # 2. Build the net with pavements, and give it the author's programs.
        place = _place_of(town.net, base, work)
        before = _root(place)
        _write(place, Cures.add_pavements(place, fastest_mps))
        after = _root(place)
        nets = net_of(before, place.name), net_of(after, place.name)
        paving = Paving(*nets)
        if _restore_programs(before, after, paving):
            _write(place, xml_bytes(after))
        # 3. Change what names lanes, positions or signals in the other files.
        _edit_files([work / path.relative_to(base) for path in files], place, paving)
        # 4. Count what is new, and see what fast streets would give.
        crossings = _count(nets[1], "crossing")
        streets = sum(map(paving.lanes.shift, paving.lanes.before))
        walkingareas = _count(nets[1], "walkingarea") - _count(nets[0], "walkingarea")
        if not crossings and not streets and not walkingareas:
            none = f"{town.net}: none of its streets got a pavement, of up to {fastest_mps:g} m/s"
            raise TownError(f"{none}; {Cures(town).pave(out)}")
        faster, fast_note = _fast_streets(town, net, out, fastest_mps)
    return Paved(
        sumocfg=_place_of(config.path, base, out),
        streets=streets,
        had=net.paved_streets,
        crossings=crossings,
        walkingareas=walkingareas,
        placed=paving.placed,
        programs=paving.programs,
        moved_m=tuple(sorted(paving.moved_m.items(), key=lambda item: -item[1])),
        faster=faster,
        notes=(*fast_note, *_notes(net, paving, out / place.relative_to(work))),
    )


def _restore_programs(before: Element, after: Element, paving: Paving) -> bool:
    """Put the author's programs, with the new crossings, in the place of those of netconvert.

    Args:
        before: The author's net; its programs are changed as those of an additional file are.
        after: The net with crossings; is changed.
        paving: What is known of both; counts the programs.

    Returns:
        Whether there is any.
    """
    programs = Element("additional")
    logics = before.iterfind("tlLogic")
    programs.extend(logic for logic in logics if logic.get("id") in paving.signals)
    paving.edit(programs, in_net=True)
    names = {logic.get("id") for logic in programs}
    made = [logic for logic in after.iterfind("tlLogic") if logic.get("id") in names]
    if not made:
        return False
    place = list(after).index(made[0])
    for logic in made:
        after.remove(logic)
    after[place:place] = list(programs)
    return True


def _edit_files(files: list[Path], net: Path, paving: Paving) -> None:
    """Change what names lanes, positions or signals in the copies, and write those that differ."""
    others = [path for path in files if path != net and path.suffix != ".sumocfg"]
    starts = [read_bytes(path)[:4096].lstrip(b"\xef\xbb\xbf \t\r\n") for path in others]
    others = [path for path, start in zip(others, starts, strict=True) if start.startswith(b"<")]
    for path in others:
        paving.note_routes(_root(path))
    for path in others:
        root = _root(path)
        try:
            if root.tag == "net" or not paving.edit(root):
                continue
        except TownError as error:
            raise TownError(f"{path.name}: {error}") from None
        # The declaration and the comments that a file starts with stay, and so does its encoding.
        head = _HEAD.match(read_bytes(path))
        assert head is not None  # noqa: S101 - it may be empty
        encoding = (head["encoding"] or b"utf-8").decode("ascii")
        text: str = ElementTree.tostring(root, encoding="unicode")
        _write(path, head[0] + text.encode(encoding, "xmlcharrefreplace") + b"\n")


def _write(path: Path, text: bytes) -> None:
    """Replace a file's text; what was packed stays packed."""
    if path.read_bytes().startswith(_PACKED):
        write_gzip(path, text)
    else:
        path.write_bytes(text)


def _count(net: Net, function: str) -> int:
    return sum(edge.function == function for edge in net.edges)


def _fast_streets(
    town: Town, net: Net, out: Path, fastest_mps: float
) -> tuple[tuple[float, str], tuple[str, ...]]:
    """What pavements beside the fast streets too would give, see `Paved`, and the note of it."""
    bare = (edge for edge in net.edges if not edge.has(LaneKind.SIDEWALK))
    limits = net.speeds_mps
    fast = [limits[edge.id] for edge in bare if limits.get(edge.id, 0.0) > fastest_mps]
    if not fast:
        return (0.0, ""), ()
    share = Cures(town).paved_share(max(fast))
    other = out.with_name(f"{out.name}-{math.ceil(max(fast))}")
    command = Cures(town).pave_into(other, max(fast))
    gain = "netconvert finds no place for one"
    if share:
        connected = f"{share:.1%} of the walkable area is connected"
        gain = f"with them, {connected}; in another folder: {command}"
    left = f"{len(fast)} of {len(limits)} streets are faster than {fastest_mps:g} m/s"
    return (share, command), (f"{left} and got no pavement; {gain}",)


def _notes(net: Net, paving: Paving, place: Path) -> tuple[str, ...]:
    """What the junctions got, and what the author may want to correct in the net at `place`."""
    notes = []
    if not any(edge.function == "internal" for edge in net.edges):
        notes.append(
            "lanes inside junctions were added, because crossings need them; "
            "vehicles no longer jump over junctions"
        )
    if paving.parking:
        names = join_names(paving.parking, _MOST_NAMES)
        notes.append(
            f"parking areas on the new pavement of their lane: {names}; "
            "if wheelchairs must pass, move them in netedit"
        )
    notes += _never_green(paving, f"add a phase in netedit, or {Cures.signals(place)}", in_net=True)
    notes += _never_green(paving, "add a phase there", in_net=False)
    if paving.lost:
        names = join_names(paving.lost, _MOST_NAMES)
        notes.append(
            f"lanes inside junctions that no longer exist: {names}; "
            "correct the elements that name them"
        )
    return tuple(notes)


def _never_green(paving: Paving, cure: str, *, in_net: bool) -> list[str]:
    """Crossings without a phase in the programs of the net, or in those of additional files."""
    items = [item for item in paving.never_green if item.in_net == in_net]
    if in_net:
        # Others are in force in their places.
        items = [item for item in items if item.signal not in paving.overridden]
    if not items:
        return []
    found = dict.fromkeys(f"over {item.edge} at {item.signal}" for item in items)
    names = join_names(found, _MOST_NAMES)
    place = "the net" if in_net else "an additional file"
    why = "cars may drive over them in every phase of the signal program"
    why += (
        " (a NEMA controller shows two phases at once)" if any(item.rings for item in items) else ""
    )
    return [f"these crossings never get green: {why} in {place}: {names}; {cure}"]


def _place_of(path: Path, base: Path, folder: Path) -> Path:
    """The place in a folder of a file that lies below `base`."""
    return folder / Path(os.path.normpath(path.absolute())).relative_to(base)


def _root(path: Path) -> Element:
    """The root of a copy, with the comments inside it."""
    # The original was looked through when it was copied, so no DTD gets here.
    builder = ElementTree.TreeBuilder(insert_comments=True)
    parser = ElementTree.XMLParser(target=builder)  # noqa: S314
    return without_namespaces(ElementTree.fromstring(read_bytes(path), parser))  # noqa: S314
