"""Is a net safe to open in this process? SUMO dies on broken ones, so a child opens it first."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from xml.etree.ElementTree import Element

from wcsim.errors import SumoError, TownError
from wcsim.towns.cache import cache_folder, write_whole
from wcsim.towns.tools import Limits, run_tool
from wcsim.towns.xmlio import MAX_XML_BYTES, parse_root, read_bytes

CHECK = 1  # raise it when the check becomes stricter
_LIMITS = Limits(wall_s=60.0, cpu_s=50, memory_bytes=3 << 30, file_bytes=1 << 20)
_NUMBERS = ("shape", "outlineShape", "customShape", "x", "y", "z", "length", "width", "speed", "friction", "radius")


def validate_net(net: Path) -> None:
    """Return when SUMO can open a net, from memory of an equal net where there is one.

    Raises:
        TownError: it is not a net, or SUMO refuses it or dies of it; the message says why in one or two lines.
    """
    data = read_bytes(net, MAX_XML_BYTES)
    verdict = cache_folder() / f"net-{hashlib.sha256(data + bytes([CHECK])).hexdigest()[:32]}.ok"
    if verdict.is_file():
        return
    scan_net(parse_root(data, str(net)), str(net))
    options = ["-n", str(net.resolve()), "--end", "1", "--no-step-log", "--no-warnings", "--xml-validation", "never"]
    try:
        run = run_tool("sumo", options, net.resolve().parent, _LIMITS)
    except SumoError as error:
        raise TownError(f"{net}: SUMO could not open this net ({error}); build it again with netconvert") from None
    if run.returncode:
        raise TownError(f"{net}: SUMO cannot open this net ({run.reason()}); build it again with netconvert")
    write_whole(verdict, lambda path: path.write_text("ok\n", encoding="utf-8"))


def scan_net(root: Element, where: str) -> None:
    """Refuse what is no net at all, before any simulator sees it. Raises TownError."""
    if root.tag != "net":
        raise TownError(f"{where}: its root element is <{root.tag}>; expected <net>: build it with netconvert")
    edges = [edge for edge in root.iterfind("edge") if edge.find("lane") is not None]
    if not edges:
        raise TownError(f"{where}: has no edge with lanes; expected a street net: build it with netconvert")
    if root.find("junction") is None:
        raise TownError(f"{where}: has no junction; expected a street net: build it with netconvert")
    for element in root.iter():
        for key in _NUMBERS:
            text = element.get(key)
            if text is not None and not _all_finite(text):
                raise TownError(
                    f"{where}: <{element.tag} id={element.get('id')!r}> has {key}={text[:40]!r}; expected numbers"
                )


def _all_finite(text: str) -> bool:
    try:
        return all(math.isfinite(float(part)) for part in text.replace(",", " ").split())
    except ValueError:
        return False
