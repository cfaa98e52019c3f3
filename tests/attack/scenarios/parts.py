"""Scenarios that would write or read what they must not: every place for a name, every name, every way to hide it."""

import gzip
import os
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import escape

from numpy.random import Generator

from tests.towns.fuzz.flipped_bytes import pick
from wcsim.towns.scenario.options import Treatment, sumo_options

NAMES = (
    *(
        "{canary}/a.xml",
        "../canary/a.xml",
        "../canary/precious.xml",
        "{canary}/precious.xml",
        "link/a.xml",
        "../../a.xml",
    ),
    *("a.xml", "sub/a.xml", "", " ", "NUL", "NULL", "nul", "null", "/dev/null", "/dev/stderr", "stdout", "stderr", "-"),
    *(
        "localhost:9",
        "127.0.0.1:9",
        "[::1]:9",
        "a:9",
        "${{HOME}}/a.xml",
        "~/a.xml",
        "%2e%2e/canary/a.xml",
        "..",
        ".",
        "/",
    ),
    *(
        "a.xml,{canary}/b.xml",
        "a.xml%2C{canary}/b.xml",
        "a.xml;{canary}/b.xml",
        "a\nb.xml",
        "a\t../canary/x",
        "\u00e4.xml",
    ),
    *(
        "x" * 5000,
        "y/" * 2500,
        "dead",
        "pipe",
        "device",
        "folder",
        "private",
        "good.xml",
        "hidden.xml",
        "hidden.xml.gz",
    ),
    *("a.xml ", " {canary}/a.xml", "//..//canary/a.xml", "file://{canary}/a.xml", "\u202ea.xml", "{theirs}/a.net.xml"),
    *(
        "{theirs}/a.sumocfg",
        "a.rou.xml",
        "CON",
        "%s%n",
        "*",
        "|touch x",
        "`x`",
        "a\\..\\b",
        "{canary}",
        "NUL/../x",
        "$HOME",
    ),
)
"""Names of files; `canary` is a folder that nobody may touch."""

BESIDE = ("good.xml", "hidden.xml", "hidden.xml.gz", "./good.xml", "folder/../hidden.xml")
"""Names of what lies beside the files of the scenario."""

PRIVATE = ("private", "../canary/precious.xml", "link/precious.xml", "{canary}/precious.xml", "folder/../private")
"""Names of what is there, and not the scenario's."""

_FLOW = '<flow begin="0" end="9" vehsPerHour="900" speed="8"/>'
_ENDS = '<detEntry lane="{lane}" pos="2"/><detExit lane="{lane}" pos="8"/>'
_WATCHED = (
    '<vehicle id="k{n}" depart="0"><route edges="{edge}"/>'
    '<param key="has.ssm.device" value="true"/><param key="{0}" value="{1}"/></vehicle>'
)
WRITERS = (
    ("file", '<edgeData id="k{n}" {0}="{1}" period="1"/>'),
    ("file", '<laneData id="k{n}" {0}="{1}" period="1"/>'),
    ("file", '<e1Detector id="k{n}" lane="{lane}" pos="5" period="1" {0}="{1}"/>'),
    ("file", '<inductionLoop id="k{n}" lane="{lane}" pos="5" freq="1" {0}="{1}"/>'),
    ("file", '<instantInductionLoop id="k{n}" lane="{lane}" pos="5" {0}="{1}"/>'),
    ("file", '<laneAreaDetector id="k{n}" lane="{lane}" pos="1" endPos="9" period="1" {0}="{1}"/>'),
    ("file", '<e3Detector id="k{n}" period="1" {0}="{1}">' + _ENDS + "</e3Detector>"),
    ("file", '<vTypeProbe id="k{n}" period="1" {0}="{1}"/>'),
    ("file", '<routeProbe id="k{n}" edge="{edge}" period="1" {0}="{1}"/>'),
    ("output", '<calibrator id="k{n}" edge="{edge}" pos="0" {0}="{1}">' + _FLOW + "</calibrator>"),
    ("dest", '<timedEvent type="SaveTLSStates" source="C" {0}="{1}"/>'),
    ("device.ssm.file", '<vType id="k{n}"><param key="{0}" value="{1}"/></vType>'),
    (
        "device.ssm.file",
        '<vType id="k{n}"><param key="has.ssm.device" value="true"/><param value="{1}" key="{0}"/></vType>',
    ),
    ("device.ssm.file", _WATCHED),
    ("device.toc.file", '<vType id="k{n}"><param key="{0}" value="{1}"/></vType>'),
    ("file", '<tlLogic id="C" programID="p{n}" type="actuated"><param key="{0}" value="{1}"/></tlLogic>'),
)
_PLACE = 'netOffset="0,0" convBoundary="0,0,9,9" origBoundary="0,0,9,9"'
READERS = (
    ("href", '<include {0}="{1}"/>'),
    ("href", '<include {0}="{1}"/>'),
    ("file", '<rerouter id="k{n}" edges="{edge}" {0}="{1}"/>'),
    ("file", '<variableSpeedSign id="k{n}" lanes="{lane}" {0}="{1}"/>'),
    ("file", '<calibrator id="k{n}" edge="{edge}" pos="0" {0}="{1}"/>'),
    ("edgesFile", '<edgeData id="k{n}" file="d.xml" {0}="{1}"/>'),
    ("imgFile", '<poi id="k{n}" x="1" y="1" {0}="{1}"/>'),
    ("device.fcd-replay.file", '<vType id="k{n}"><param key="{0}" value="{1}"/></vType>'),
    ("emissionClass", '<vType id="k{n}" {0}="{1}"/>'),
    ("projParameter", "<location " + _PLACE + ' {0}="+proj=utm +nadgrids={1}"/>'),
)
ENCODINGS = (
    *((None, "utf-8"), (None, "utf-8-sig"), ("UTF-8", "utf-8"), ("ISO-8859-1", "latin-1"), ("us-ascii", "ascii")),
    *(("ebcdic-cp-us", "cp037"), ("cp037", "cp037"), ("cp500", "cp500"), ("ibm1140", "cp1140"), (None, "cp037")),
    *(("UTF-16", "utf-16"), (None, "utf-16"), (None, "utf-16-le"), (None, "utf-16-be"), ("UTF-16", "utf-8")),
    *((None, "utf-32"), (None, "utf-32-le"), ("UTF-32", "utf-32-be"), ("utf-7", "utf-7"), ("utf-8", "utf-7")),
    *(("ebcdic-cp-us", "utf-8"), ("UTF-8", "cp037"), ("shift_jis", "shift_jis"), ("gbk", "gbk"), ("klingon", "utf-8")),
)
_REPEATED = (*ENCODINGS[:5],) * 6  # most files are in one of the usual ones


def _twice(data: bytes) -> bytes:
    return gzip.compress(gzip.compress(data, 1), 1)


PACKINGS: tuple[Callable[[bytes], bytes], ...] = (
    *((bytes,) * 8),
    lambda data: gzip.compress(data, 1),
    _twice,
    lambda data: zlib.compress(data, 9),
    lambda data: zlib.compress(data, 1),
    lambda data: gzip.compress(data[:20], 1) + gzip.compress(data[20:], 1),
    lambda data: gzip.compress(data[:20], 1) + zlib.compress(data[20:]),
    lambda data: gzip.compress(data, 1)[:-9],
    lambda data: gzip.compress(data, 1) + b"\0\0\0",
    lambda data: b"\xef\xbb\xbf" + data,
    lambda data: b"\xff\xfe" + data,
    lambda data: b"\n " + data,
    lambda data: data.replace(b" ", b"\xc2\x85"),
    lambda data: data.replace(b"<", b"\0<", 1),
)
DECLARATIONS = (
    '<?xml version="{v}" encoding="{e}"?>',
    "<?xml version='{v}'\n encoding = '{e}' standalone='no' ?>",
    '<?xml version="{v}"' + " " * 2000 + 'encoding="{e}"?>',
    '<!-- x --><?xml version="{v}" encoding="{e}"?>',
    '<?xml encoding="{e}"?>',
)
DOCTYPES = (
    '<!DOCTYPE x [<!ATTLIST edgeData file CDATA "{canary}/d.xml">]>',
    '<!DOCTYPE x [<!ENTITY f "file"><!ENTITY c SYSTEM "{canary}/precious.xml">]>',
    '<!DOCTYPE x SYSTEM "{canary}/x.dtd">',
    "<!doctype x>",
)
DEVICES = ("ssm", "btreceiver", "emissions", "battery", "bluelight", "fcd", "tripinfo", "vehroute", "rerouting")


@dataclass(slots=True)
class Theirs:
    """A scenario that is being made, and what was done to it."""

    folder: Path
    canary: Path
    rng: Generator
    lane: str
    done: list[str] = field(default_factory=list)
    count: int = 0

    def kind(self, reads: bool) -> tuple[str, ...]:
        """Of what is read most must be there, or it is refused for that alone."""
        return pick(self.rng, (BESIDE, BESIDE, PRIVATE, NAMES)) if reads else NAMES

    def name(self, names: tuple[str, ...] = NAMES) -> str:
        """A nasty name for a file."""
        return pick(self.rng, names).format(canary=self.canary, theirs=self.folder)

    def element(self) -> str:
        """An element that names a file."""
        self.count += 1
        reads = self.rng.random() < 0.25
        key, text = pick(self.rng, READERS if reads else WRITERS)
        value = escape(
            self.name(self.kind(reads)),
            {'"': "&quot;", "\n": "&#10;", "\t": "&#9;"},
        )
        if value and self.rng.random() < 0.15:
            value = f"&#{ord(value[0])};{value[1:]}" if value[0] != "&" else value
        self.done.append(f"{key}={value[:50]!r}")
        edge = self.lane.rpartition("_")[0]
        made = text.format(key, value, n=self.count, lane=self.lane, edge=edge)
        if self.rng.random() < 0.1:
            made = pick(
                self.rng, (made.replace(" ", "\n\t"), made.replace('="', ' = \n"'), f'<x:y xmlns:x="u">{made}</x:y>')
            )
        if self.rng.random() < 0.04:
            made = pick(self.rng, ("<a>" * 150 + made + "</a>" * 150, f"<a>{made}</a>", f"<![CDATA[{made}]]>{made}"))
        return made

    def option(self) -> str:
        """An option with a nasty name as its value, spelt in any way."""
        spelling = pick(self.rng, _file_options() if self.rng.random() < 0.8 else _text_options())
        reads = sumo_options()[spelling].treatment is Treatment.INPUT
        name = self.name(self.kind(reads))
        value = escape(name, {'"': "&quot;", "\n": "&#10;", "\t": "&#9;"})
        self.done.append(f"<{spelling}>={value[:50]!r}")
        form = pick(
            self.rng, ('<{0} value="{1}"/>', '<{0} v="{1}"/>', "<{0}>{1}</{0}>", '<a><b><{0} value="{1}"/></b></a>')
        )
        return form.format(spelling, value)

    def wrapped(self, root: str, inside: str, *, hide: bool) -> bytes:
        """A file, written in an encoding and packing that may hide what is in it."""
        text = f"<{root}>{inside}</{root}>"
        if not hide:
            return text.encode("utf-8", "replace")
        said, codec = pick(self.rng, (*ENCODINGS, *_REPEATED))
        if self.rng.random() < 0.05:
            text = pick(self.rng, DOCTYPES).format(canary=self.canary) + text
        if said is not None:
            version = "1.1" if self.rng.random() < 0.15 else "1.0"
            shape = DECLARATIONS[0] if self.rng.random() < 0.7 else pick(self.rng, DECLARATIONS)
            text = shape.format(v=version, e=said) + text
        packing = int(self.rng.integers(len(PACKINGS)))
        self.done.append(f"{root} in {said}/{codec}, packing {packing}")
        return PACKINGS[packing](text.encode(codec, "xmlcharrefreplace"))


def _file_options() -> tuple[str, ...]:
    return tuple(sorted(name for name, item in sumo_options().items() if item.kind == "FILE" or "file" in item.name))


def _text_options() -> tuple[str, ...]:
    return tuple(sorted(name for name, item in sumo_options().items() if item.kind in ("STR", "STR[]")))


def furnish(folder: Path, canary: Path) -> None:
    """What lies beside the files of a scenario: links to elsewhere, a pipe, and files that may be named."""
    canary.mkdir(parents=True)
    (canary / "precious.xml").write_text("<additional><!-- irreplaceable --></additional>", encoding="utf-8")
    folder.mkdir()
    (folder / "link").symlink_to(canary)
    (folder / "dead").symlink_to(canary / "none.xml")
    (folder / "private").symlink_to(canary / "precious.xml")
    (folder / "device").symlink_to("/dev/zero")
    os.mkfifo(folder / "pipe")
    (folder / "folder").mkdir()
    (folder / "good.xml").write_text(
        '<additional><edgeData id="g" file="good-out.xml"/></additional>', encoding="utf-8"
    )


def write_scenario(theirs: Theirs, net: bytes, *, hostile: bool, devices: bool) -> Path:
    """Write it, with one to four nasty things unless it is to be a sound one; returns the .sumocfg."""
    folder, rng = theirs.folder, theirs.rng
    edge = theirs.lane.rpartition("_")[0]
    parts: dict[str, str] = {"cfg": "", "add": "", "rou": "", "net": ""}
    for _ in range(pick(rng, (1, 1, 1, 2, 4)) if hostile else 0):
        place = pick(rng, ("cfg", "add", "add", "rou", "net"))
        theirs.done.append(f"in {place}:")
        parts[place] += theirs.option() if place == "cfg" else theirs.element()
    if hostile or devices:
        parts["cfg"] += "".join(f"<device.{name}.probability value='1'/>" for name in DEVICES if rng.random() < 0.2)
    hidden = theirs.wrapped("additional", theirs.element(), hide=True) if hostile else b"<additional/>"
    (folder / "hidden.xml").write_bytes(hidden)
    (folder / "hidden.xml.gz").write_bytes(gzip.compress(hidden, 1))
    car = f'<vehicle id="one" depart="0"><route edges="{edge}"/></vehicle>'
    whole = net.replace(b"</net>", parts["net"].encode() + b"</net>")
    spoilt = pick(rng, ("add", "rou", "cfg", "net", "", "", "", "", "", "")) if hostile else ""
    (folder / "a.net.xml").write_bytes(theirs.wrapped("net", "", hide=True) if spoilt == "net" else whole)
    (folder / "a.add.xml").write_bytes(theirs.wrapped("additional", parts["add"], hide=spoilt == "add"))
    (folder / "a.rou.xml").write_bytes(theirs.wrapped("routes", car + parts["rou"], hide=spoilt == "rou"))
    more = ",hidden.xml" if hostile and rng.random() < 0.1 else ""
    inside = f"<n value='a.net.xml'/><r value='a.rou.xml'/><a value='a.add.xml{more}'/>{parts['cfg']}"
    sumocfg = folder / "a.sumocfg"
    sumocfg.write_bytes(theirs.wrapped("configuration", inside, hide=spoilt == "cfg"))
    return sumocfg
