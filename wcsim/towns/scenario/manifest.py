"""A town's manifest: what the importer wrote, so that a change since then is noticed."""

from __future__ import annotations

import hashlib
from pathlib import Path

from wcsim.config import TownFile
from wcsim.config.scene import ChairWay
from wcsim.core.reading import FileKind, read_bytes
from wcsim.errors import ConfigError, TownError
from wcsim.towns.scenario.town import Town, read_town_file
from wcsim.towns.sumo.xml_io import content_digest

KINDS = ("net.xml.gz", "poly.xml.gz", "rou.xml.gz", "dem.tif", "add.xml", "sumocfg")
BESIDE = ("town.toml", "LICENSE-DATA", "osm/bbox")  # what the importer writes besides, and the extract
_DEM = FileKind(what="a GeoTIFF", limit_bytes=1 << 30, error=TownError)
CYCLE_PATHS = "--cycle-paths"  # of `wcsim town import`
_AUTHORED_KEYS = ("kerb_height_m", "lowered_kerb_m", "chair_ways", "warmup_s", "sumocfg")  # of town.toml


def hash_files(folder: Path, name: str) -> dict[str, str]:
    """SHA-256 (hex) of each file of a town that is there, by its ending; of XML without comments and packing."""
    paths = {kind: folder / f"{name}.{kind}" for kind in KINDS}
    return {kind: _digest(path) for kind, path in paths.items() if path.is_file()}


def find_changes(town: Town) -> tuple[Path, ...]:
    """Files that were changed since the import; nothing for a town without a manifest."""
    noted = {_path(town, kind): digest for kind, digest in town.file.hashes.items()}
    return tuple(path for path, digest in noted.items() if _now(path) != digest)


def own_work(folder: Path) -> tuple[str, ...]:
    """Files of a town's folder that were changed or added since its import, as paths in it, sorted."""
    try:
        file = read_town_file(folder / "town.toml")
    except (ConfigError, TownError):
        return ("town.toml",)
    name = file.name
    written = {*BESIDE, f"osm/{name}.osm.xml.gz", *(f"{name}.{kind}" for kind in KINDS)} if file.rebuild else set()
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()}
    changed = {f"{name}.{kind}" for kind, digest in file.hashes.items() if _now(folder / f"{name}.{kind}") != digest}
    if _by_hand(file):
        changed.add("town.toml")
    return tuple(sorted((there - written) | (changed & there)))


def chair_ways(cycle_paths: bool) -> tuple[ChairWay, ...]:
    """Ways of the chairs of a town that is imported or generated: where the law has it so, cycle paths too."""
    return ("sidewalk", "crossing", "shared", *(("cycleway",) if cycle_paths else ()))


def _by_hand(file: TownFile) -> bool:
    """True when `town.toml` says what no importer writes."""
    usual = TownFile(name=file.name, split=file.split, chair_ways=chair_ways(CYCLE_PATHS in file.rebuild))
    return any(getattr(file, key) != getattr(usual, key) for key in _AUTHORED_KEYS)


def _now(path: Path) -> str:
    try:
        return _digest(path) if path.is_file() else ""
    except TownError:
        return ""


def _path(town: Town, kind: str) -> Path:
    """The file that is meant; in an adopted scenario files are noted by their place in the folder."""
    return town.folder / (f"{town.name}.{kind}" if kind in KINDS else kind)


def _digest(path: Path) -> str:
    return hashlib.sha256(read_bytes(path, _DEM)).hexdigest() if path.suffix == ".tif" else content_digest(path)
