"""A seeded fuzzer of town files: mutators of nets, routes, additional files, configurations and OSM extracts."""

import copy
import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from numpy.random import Generator

from tests.towns.fuzz.flipped_bytes import DISK, RAW, Disk, deadly, pick
from wcsim.core.seeding import make_rng
from wcsim.towns.scenario.options import SumoOption, Treatment, sumo_options

Tree = Callable[[Element, Generator], None]

FAMILIES = ("net", "rou", "add", "sumocfg", "osm")
_ORDER = (0, 1, 2, 3, 0, 1, 2, 3, 4, 0, 1, 2, 3, 0, 1, 3, 0, 1, 2, 4)  # few extracts: SUMO's tools take a second each
_EDGES = ("WC", "CW", "EC", "CE", "NC", "CN", "SC", "CS")
DEADLY = -1 - len(FAMILIES)
NASTY = (
    *("", " ", "nan", "inf", "-inf", "1e999", "-1", "0", "1e-30", "1e12", "-99999999999", "2147483648"),
    *("99999999999999999999", "true", "none", "all", "NULL", "0,0", "0,0 0,0", "1,2,3,4 5", "1,2 nan,3", "a b c"),
    *("%s%n%d", "${HOME}", "..", ":", "\u202e\u00e4\U0001f6b2", "x" * 4000, "7" * 400, "custom1", "-0.0", "0x10"),
)
OUT = (
    *("CANARY/abs.xml", "../canary/precious.xml", "link/x.xml", "${HOME}/x.xml", "base.net.xml", "a/b/../c.xml"),
    *("base.sumocfg", "%2e%2e/canary/y.xml", "localhost:9", "stdout", "/dev/stderr", "..", "file:///x.xml", "/"),
)
"""Where an author may want an output to go; CANARY is a folder that nobody may touch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One mutant; its number is its seed, and `spoil` may be called once."""

    number: int
    family: str
    changes: tuple[str, ...]
    spoil: Disk


def make_case(number: int) -> Case:
    """The mutant of that number; always the same one. Those below 0 are the families' sound files, and DEADLY."""
    if number == DEADLY:
        return Case(number=number, family="net", changes=("deadly",), spoil=deadly)
    if number < 0:
        return Case(number=number, family=FAMILIES[-1 - number], changes=(), spoil=lambda path: None)
    rng = make_rng(number, "fuzz")
    family = FAMILIES[_ORDER[number % len(_ORDER)]]
    if rng.random() < 0.15:
        name = pick(rng, (*RAW, *DISK))
        raw = RAW.get(name)
        spoil: Disk = DISK[name] if raw is None else lambda path: _put(path, raw(path.read_bytes(), rng))
        return Case(number=number, family=family, changes=(name,), spoil=spoil)
    own = tuple(OWN[family].items())
    general = tuple(TREE.items())
    chosen = [pick(rng, own if rng.random() < 0.5 else general) for _ in range(1 + int(rng.random() < 0.3))]
    return Case(
        number=number,
        family=family,
        changes=tuple(name for name, _ in chosen),
        spoil=lambda path: _change_tree(path, [change for _, change in chosen], rng),
    )


def _put(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def _change_tree(path: Path, changes: list[Tree], rng: Generator) -> None:
    root = ElementTree.fromstring(path.read_bytes())  # noqa: S314 - a sound file of our own
    for change in changes:
        change(root, rng)
    text = ElementTree.tostring(root, encoding="unicode")
    text = text.replace("CANARY", str(path.resolve().parents[1] / "canary"))
    path.write_text(text, encoding="utf-8", errors="replace")


# --- changes to any tree ---


def _some(root: Element, rng: Generator, tag: str = "") -> Element:
    """An element, those of rare tags as likely as those of common ones; the root where there is no other."""
    below = [item for item in root.iter(tag or None) if item is not root]
    if not below:
        return root
    kind = tag or pick(rng, sorted({item.tag for item in below}))
    return pick(rng, [item for item in below if item.tag == kind])


def _parent(root: Element, child: Element) -> Element | None:
    return next((item for item in root.iter() if child in list(item)), None)


def _drop(root: Element, rng: Generator) -> None:
    child = _some(root, rng)
    parent = _parent(root, child)
    if parent is not None:
        parent.remove(child)


def _drop_kind(root: Element, rng: Generator) -> None:
    tag = _some(root, rng).tag
    for parent in list(root.iter()):
        for child in [item for item in parent if item.tag == tag]:
            parent.remove(child)


def _double(root: Element, rng: Generator) -> None:
    child = _some(root, rng)
    parent = _parent(root, child)
    for _ in range(pick(rng, (1, 1, 300))):
        (root if parent is None else parent).append(copy.deepcopy(child) if child is not root else Element("x"))


def _move(root: Element, rng: Generator) -> None:
    child = _some(root, rng)
    parent, target = _parent(root, child), _some(root, rng)
    if parent is not None and target not in list(child.iter()):
        parent.remove(child)
        target.insert(0, child)


def _drop_attribute(root: Element, rng: Generator) -> None:
    element = _some(root, rng)
    if element.attrib:
        del element.attrib[pick(rng, sorted(element.attrib))]


def _nasty_attribute(root: Element, rng: Generator) -> None:
    element = _some(root, rng)
    if element.attrib:
        element.set(pick(rng, sorted(element.attrib)), pick(rng, NASTY))


def _nasty_everywhere(root: Element, rng: Generator) -> None:
    """One attribute of all elements of a kind."""
    element = _some(root, rng)
    if element.attrib:
        key, value = pick(rng, sorted(element.attrib)), pick(rng, NASTY)
        for item in root.iter(element.tag):
            item.set(key, value)


def _swap_values(root: Element, rng: Generator) -> None:
    one, other = (_some(root, rng) for _ in range(2))
    if one.attrib and other.attrib:
        a, b = pick(rng, sorted(one.attrib)), pick(rng, sorted(other.attrib))
        one.attrib[a], other.attrib[b] = other.attrib[b], one.attrib[a]


def _swap_ids(root: Element, rng: Generator) -> None:
    tag = _some(root, rng).tag
    one, other = (_some(root, rng, tag) for _ in range(2))
    one.attrib["id"], other.attrib["id"] = other.get("id", ""), one.get("id", "")


def _wrong_reference(root: Element, rng: Generator) -> None:
    """A value that is the id of something becomes the id of nothing."""
    known = {item.get("id") for item in root.iter()}
    places = [(item, key) for item in root.iter() for key, value in item.items() if key != "id" and value in known]
    if places:
        element, key = pick(rng, places)
        element.set(key, "nowhere")


def _rename(root: Element, rng: Generator) -> None:
    _some(root, rng).tag = pick(rng, ("lane", "vehicle", "param", "include", "Net", "x" * 300, "\u00e4"))


def _wrong_root(root: Element, rng: Generator) -> None:
    root.tag = pick(rng, ("routes", "net", "configuration", "osm", "html", "additional", "a"))


def _empty(root: Element, rng: Generator) -> None:
    root[:] = []


def _reverse(root: Element, rng: Generator) -> None:
    root[:] = list(root)[::-1]


def _deep(root: Element, rng: Generator) -> None:
    element = _some(root, rng)
    for _ in range(pick(rng, (20, 600))):
        element = ElementTree.SubElement(element, pick(rng, (element.tag, "param")))


def _words(root: Element, rng: Generator) -> None:
    _some(root, rng).text = pick(rng, NASTY)


TREE: Mapping[str, Tree] = {
    change.__name__.strip("_"): change
    for change in (
        *(_drop, _drop_kind, _double, _move, _drop_attribute, _nasty_attribute, _nasty_everywhere, _swap_values),
        *(_swap_ids, _wrong_reference, _rename, _wrong_root, _empty, _reverse, _deep, _words),
    )
}


# --- changes that mean something to one family ---


@functools.cache
def fragments(family: str) -> tuple[str, ...]:
    """Elements that SUMO knows and seldom gets, as text."""
    root = ElementTree.parse(Path(__file__).with_name("fuzz_parts.xml")).getroot()  # noqa: S314
    return tuple(ElementTree.tostring(item, encoding="unicode") for item in root.iterfind(f"{family}/*"))


def _fragment(family: str) -> Tree:
    def put(root: Element, rng: Generator) -> None:
        edge = pick(rng, _EDGES)
        text = pick(rng, fragments(family)).replace("EDGE", edge).replace("LANE", f"{edge}_1")
        element = ElementTree.fromstring(text.replace("OUT", pick(rng, OUT)))  # noqa: S314 - ours
        if rng.random() < 0.3 and element.attrib:
            element.set(pick(rng, sorted(element.attrib)), pick(rng, NASTY))
        root.insert(int(rng.integers(len(root) + 1)), element)

    return put


def _on_shapes(change: Callable[[list[tuple[float, ...]], Generator], list[tuple[float, ...]]]) -> Tree:
    """A change to one shape of a net, or to all of them."""

    def put(root: Element, rng: Generator) -> None:
        shaped = [item for item in root.iter() if item.get("shape")]
        few = [pick(rng, shaped)] if rng.random() < 0.7 and shaped else shaped
        for item in few:
            points = [tuple(float(v) for v in part.split(",")) for part in item.attrib["shape"].split()]
            item.set("shape", " ".join(",".join(f"{v:.9g}" for v in point) for point in change(points, rng)))

    return put


def _without(tag: str, function: str = "") -> Tree:
    def put(root: Element, rng: Generator) -> None:
        for item in root.findall(tag):
            if not function or item.get("function") == function:
                root.remove(item)

    return put


def _self_loop(root: Element, rng: Generator) -> None:
    edge = pick(rng, [item for item in root.iterfind("edge") if item.get("from")])
    edge.set("to", edge.attrib["from"])


def _option(root: Element, rng: Generator) -> None:
    """Some of SUMO's options, spelt in any way, with values of their kind or of none."""
    known = sumo_options()
    for _ in range(int(rng.integers(1, 5))):
        spelling = pick(rng, sorted(known))
        element = ElementTree.SubElement(root, spelling)
        value = _value_of(known[spelling], rng)
        if rng.random() < 0.15:
            element.text = value
        else:
            element.set(pick(rng, ("value", "value", "v")), value)


def _writer(root: Element, rng: Generator) -> None:
    """Options that write files, each to where it must not."""
    writers = [name for name, item in sorted(sumo_options().items()) if item.treatment is Treatment.OUTPUT]
    for name in {pick(rng, writers) for _ in range(4)}:
        ElementTree.SubElement(root, name, value=pick(rng, OUT))


def _inputs(root: Element, rng: Generator) -> None:
    """Files of another kind, in the wrong place, or none."""
    names = ("net-file", "route-files", "additional-files")
    value = pick(rng, (".", "..", "/etc/hostname", "base.sumocfg", "base.net.xml,base.add.xml", "none.xml", *OUT))
    for item in root.iter(pick(rng, names)):
        item.set("value", pick(rng, (value, f"{item.get('value')},{value}")))


def _value_of(option: SumoOption, rng: Generator) -> str:
    if rng.random() < 0.08:
        return pick(rng, NASTY)
    told = {
        "BOOL": ("true", "false"),
        "FLOAT": ("0", "1", "-1", "0.3", "1e9"),
        "INT": ("0", "1", "-1", "7", "100000"),
        "TIME": ("0", "1", "-1", "0.05", "1:00:00", "1e9"),
        "FILE": OUT,
        "STR": ("none", "x", "0", "all", *OUT[:3]),
    }
    return pick(rng, told.get(option.kind, ("a,b", "0 1", "all", *OUT[:3])))


OWN: Mapping[str, Mapping[str, Tree]] = {
    "net": {
        "fragment": _fragment("net"),
        "fragment_again": _fragment("net"),
        "self_loop": _self_loop,
        "zero_length": _on_shapes(lambda points, rng: points[:1] * 2),
        "one_point": _on_shapes(lambda points, rng: points[:1]),
        "bow_tie": _on_shapes(lambda points, rng: [points[-1], *points[1:-1:2], points[0], *points[2:-1:2]]),
        "shuffled": _on_shapes(lambda points, rng: [points[int(i)] for i in rng.permutation(len(points))]),
        "far": _on_shapes(lambda points, rng: [*points[:-1], (points[-1][0] + pick(rng, (3e3, 9e4, 1e7)), 0.0)]),
        "degrees": _on_shapes(lambda points, rng: [(24.9 + p[0] / 1e5, 60.1 + p[1] / 1e5) for p in points]),
        "high": _on_shapes(lambda points, rng: [(*p[:2], float(rng.normal(0, pick(rng, (1, 1e4))))) for p in points]),
        "no_connections": _without("connection"),
        "no_walkingareas": _without("edge", "walkingarea"),
        "no_crossings": _without("edge", "crossing"),
        "no_internal": _without("edge", "internal"),
        "no_junctions": _without("junction"),
    },
    "rou": {"fragment": _fragment("rou"), "fragment_again": _fragment("rou"), "add": _fragment("add")},
    "add": {"fragment": _fragment("add"), "fragment_again": _fragment("add"), "rou": _fragment("rou")},
    "sumocfg": {"option": _option, "option_again": _option, "writer": _writer, "inputs": _inputs},
    "osm": {"fragment": _fragment("osm"), "fragment_again": _fragment("osm")},
}
