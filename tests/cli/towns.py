"""Towns for the command line: a tiny OpenStreetMap extract, and copies of a sound town with something broken."""

import gzip
import shutil
from collections.abc import Callable
from pathlib import Path

TINY_BBOX = "24.999,59.9995,25.0046,60.0023"
_NODE = '<node id="{}" lat="{:.6f}" lon="{:.6f}" version="1"/>'


def tiny_osm() -> str:
    """Three streets that cross three others, all with pavements, and a house."""
    places = [(row, column) for row in range(3) for column in range(3)]
    lines = [_NODE.format(10 * row + column + 1, 60 + 0.0009 * row, 25 + 0.0018 * column) for row, column in places]
    for number in range(3):
        for first, step in ((10 * number + 1, 1), (number + 1, 10)):
            ids = [first + step * k for k in range(3)]
            lines.append(way(len(lines) + 100, ids, highway="residential", sidewalk="both", name=f"Street {first}"))
    for number, (lat, lon) in enumerate([(60.0003, 25.0023), (60.0003, 25.003), (60.0006, 25.003), (60.0006, 25.0023)]):
        lines.append(_NODE.format(500 + number, lat, lon))
    lines.append(way(200, [500, 501, 502, 503, 500], building="yes"))
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', '<osm version="0.6">', *lines, "</osm>\n"])


def way(number: int, nodes: list[int], **tags: str) -> str:
    refs = "".join(f'<nd ref="{node}"/>' for node in nodes)
    elements = "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
    return f'<way id="{number}" version="1">{refs}{elements}</way>'


def _net(town: Path) -> Path:
    return next(town.glob("*.net.xml.gz"))


def _missing_net(town: Path) -> None:
    _net(town).unlink()


def _empty_net(town: Path) -> None:
    _net(town).write_bytes(gzip.compress(b"<net/>"))


def _plain_empty_net(town: Path) -> None:
    _net(town).write_bytes(b"<net/>")


def _truncated_net(town: Path) -> None:
    _net(town).write_bytes(_net(town).read_bytes()[:700])


def _no_xml(town: Path) -> None:
    _net(town).write_bytes(gzip.compress(b"edges: none\n"))


def _routes_as_net(town: Path) -> None:
    _net(town).write_bytes(gzip.compress(b'<routes><vehicle id="a"/></routes>'))


def _missing_routes(town: Path) -> None:
    next(town.glob("*.rou.xml*")).unlink()


def _unknown_key(town: Path) -> None:
    _add_to_toml(town, "colour = 'blue'\n")


def _out_of_bounds(town: Path) -> None:
    text = (town / "town.toml").read_text()
    (town / "town.toml").write_text(text.replace("kerb_height_m = 0.12", "kerb_height_m = 12"))


def _no_toml(town: Path) -> None:
    _add_to_toml(town, "this is = = no TOML\n")


def _no_sumocfg(town: Path) -> None:
    next(town.glob("*.sumocfg")).unlink()


def _add_to_toml(town: Path, line: str) -> None:
    path = town / "town.toml"
    path.write_text(line + path.read_text())


FAULTS: dict[str, tuple[Callable[[Path], None], str]] = {
    "missing-net": (_missing_net, "does not exist"),
    "empty-net": (_empty_net, "no edge"),
    "plain-empty-net": (_plain_empty_net, "no edge"),
    "truncated-net": (_truncated_net, "cannot be read"),
    "no-xml": (_no_xml, "not well-formed"),
    "routes-as-net": (_routes_as_net, "<routes>"),
    "missing-routes": (_missing_routes, "does not exist"),
    "unknown-key": (_unknown_key, "unknown key 'colour'"),
    "out-of-bounds": (_out_of_bounds, "kerb_height_m"),
    "no-toml": (_no_toml, "is not TOML"),
    "no-sumocfg": (_no_sumocfg, ".sumocfg"),
}
"""What may be wrong with a town, and what the message must say."""


def broken(town: Path, fault: str, where: Path) -> Path:
    """A copy of a town with something wrong."""
    shutil.copytree(town, where)
    FAULTS[fault][0](where)
    return where
