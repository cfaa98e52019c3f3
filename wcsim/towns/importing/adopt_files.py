"""Which files go with the copy of somebody's scenario: those that are SUMO's, and nobody's private ones."""

from __future__ import annotations

import shutil
from pathlib import Path

from wcsim.core.reading import FileKind, opened, read_text
from wcsim.core.reading import read_bytes as read_plain
from wcsim.errors import TownError
from wcsim.towns.scenario.border import require_file, require_inside
from wcsim.towns.sumo.xml_io import MAX_XML_BYTES, read_bytes, scan

_NOTICES = ("LICENSE*", "LICENCE*", "COPYING*", "README*")
_NOTICE_BYTES = 1 << 20
ROOTS = frozenset(
    (
        "net", "routes", "trips", "vehicles", "additional", "additionals", "add", "vTypes", "vss",
        "variableSpeedSign", "rerouter", "calibrator", "snapshot", "meandata", "data", "netstats",
        "edgedata", "weights", "interval", "tlLogics", "tls", "shapes", "polygons", "pois", "detectors",
        "busStops", "stops", "taz", "tazs", "viewsettings", "gui-settings", "fcd-export", "emission-export",
        "edgeRelations", "routes-info", "persons"
    )
)  # fmt: skip
"""Root elements of what SUMO reads."""

_PICTURES = (b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"BM")
_SELECTED = ("edge:", "lane:")
_SELECTION = FileKind(what="a list of edges", limit_bytes=16 << 20, error=TownError)
_NOTICE = FileKind(what="a notice", limit_bytes=_NOTICE_BYTES, error=TownError)
_COPIED = FileKind(what="a file of a scenario", limit_bytes=MAX_XML_BYTES, error=TownError)


def copy_file(path: Path, place: Path) -> None:
    """Copy a regular file. Raises TownError when it is none."""
    with opened(path, _COPIED) as source, place.open("wb") as target:
        shutil.copyfileobj(source, target)


def copy_settings(path: Path, place: Path) -> None:
    """Copy the settings of a window; of what is none of SUMO's goes an empty one, for SUMO wants the file."""
    try:
        _require_root(path)
    except TownError:
        place.write_text("<viewsettings/>\n", encoding="utf-8")
    else:
        copy_file(path, place)


def copy_notices(source: Path, out: Path, border: Path | None) -> tuple[str, ...]:
    """Copy the licence and the readme that lie beside a scenario, and not elsewhere; returns their names."""
    names = set()
    for path in (path for mask in _NOTICES for path in source.glob(mask)):
        try:
            require_inside(path, border, source)
            notice = read_plain(path, _NOTICE)
        except TownError:  # a link to elsewhere, or no notice
            continue
        names.add(path.name)
        if not (out / path.name).exists():
            (out / path.name).write_bytes(notice)
    return tuple(sorted(names))


def require_kind(path: Path, *, text: bool) -> None:
    """Return for a file of SUMO's, XML or else a list of edges. Raises TownError."""
    if not text:
        _require_root(path)
    elif not all(line.startswith(_SELECTED) for line in read_text(path, _SELECTION).split()):
        raise TownError(
            f"{path}: is not a list of edges; expected lines such as edge:ID: remove it, or correct its lines"
        )


def _require_root(path: Path) -> None:
    """Raise TownError for XML that is none of SUMO's: it may be anybody's, and a town is made to be passed on."""
    tags: list[str] = []
    scan(read_bytes(path, MAX_XML_BYTES), str(path), lambda tag, _: tags.append(tag) if not tags else None)
    if tags[0].rpartition(":")[2] not in ROOTS:
        raise TownError(
            f"{path}: begins with <{tags[0][:40]}>, which is no SUMO file; expected routes, additional, ..."
        )


def is_picture(path: Path, border: Path | None) -> bool:
    """Whether a picture that sumo-gui would show can go with the copy."""
    try:
        require_file(path, border, path)
        with opened(path, _COPIED) as file:
            return file.read(8).startswith(_PICTURES)
    except TownError:
        return False
