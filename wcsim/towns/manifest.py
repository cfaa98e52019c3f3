"""A town's manifest: what the importer wrote, so that a change since then is noticed."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from wcsim.errors import TownError
from wcsim.towns.town import Town
from wcsim.towns.xmlio import content_digest

KINDS = ("net.xml.gz", "poly.xml.gz", "rou.xml.gz", "dem.tif", "add.xml", "sumocfg")
AUTHORED = ("add.xml", "sumocfg")  # where authors add what they like; the others belong together


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes:
    """Files of a town that are not as they were imported."""

    stale: tuple[str, ...]  # net, polygons, demand, heights: they were made for each other
    authored: tuple[str, ...]


def hashes_of(folder: Path, name: str) -> dict[str, str]:
    """SHA-256 (hex) of each file of a town that is there, by its ending; of XML without comments and packing."""
    paths = {kind: folder / f"{name}.{kind}" for kind in KINDS}
    return {kind: _digest(path) for kind, path in paths.items() if path.is_file()}


def changes_of(town: Town) -> Changes:
    """What was changed since the import; nothing for a town without a manifest."""
    noted = town.file.hashes
    now: dict[str, str] = {}
    for kind in noted:
        path = _path(town, kind)
        try:
            now[kind] = _digest(path) if path.is_file() else ""
        except TownError:
            now[kind] = ""
    changed = [kind for kind in noted if now[kind] != noted[kind]]
    return Changes(
        stale=tuple(_path(town, kind).name for kind in changed if kind not in AUTHORED),
        authored=tuple(_path(town, kind).name for kind in changed if kind in AUTHORED),
    )


def _path(town: Town, kind: str) -> Path:
    """The file that is meant; in an adopted scenario files are noted by their place in the folder."""
    return town.folder / (f"{town.name}.{kind}" if kind in KINDS else kind)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.suffix == ".tif" else content_digest(path)
