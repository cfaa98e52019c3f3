"""Hostile recordings, written for other programs: floating car data that is XML, and bags that others can read."""

from pathlib import Path
from xml.etree import ElementTree

from mcap.reader import make_reader

from tests.attack.files.family import Family
from tests.attack.files.files import logged, sound_trace
from tests.attack.files.people import sound_drive
from wcsim.bridge.recording.convert import convert_to_fcd
from wcsim.bridge.recording.ros_chairs import drive_bag, trace_bag
from wcsim.log.drive import read_drive
from wcsim.log.reader import read_trace_states


def families(work: Path) -> list[Family]:
    """What `wcsim log convert` makes of traces and drives."""
    trace, drive = sound_trace(work), sound_drive(work / "sound.drive")
    return [
        logged("fcd", "trace", trace, _take_fcd),
        logged("mcap of a trace", "trace", trace, _take_trace),
        logged("mcap of a drive", "a.drive", drive, _take_drive),
    ]


def _take_fcd(path: Path) -> bool:
    """Every actor is there under its own name, in every step."""
    out = path.with_name("fcd.xml")
    steps = convert_to_fcd(path, out)
    found = list(ElementTree.parse(out).getroot())  # noqa: S314 - our own file
    records = [record for record in read_trace_states(path)[1] if record.epoch == 0]
    told = [{body.id.partition(":")[2] for body in record.bodies if not body.piece} for record in records]
    there = (names <= {item.get("id") for item in step} for names, step in zip(told, found, strict=True))
    return len(found) == steps and all(there)


def _take_trace(path: Path) -> bool:
    header, records = read_trace_states(path)
    return _readable(path.with_name("a.mcap"), trace_bag(header.tick_s, records, path.with_name("a.mcap")))


def _take_drive(path: Path) -> bool:
    return _readable(path.with_name("a.mcap"), drive_bag(read_drive(path), path.with_name("a.mcap")))


def _readable(bag: Path, counts: dict[str, int]) -> bool:
    with bag.open("rb") as file:
        return sum(1 for _ in make_reader(file).iter_messages()) == sum(counts.values())
