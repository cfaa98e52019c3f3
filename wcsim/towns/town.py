"""Towns on disk: find one by name or path, list them, and say by hash whether two are the same."""

from __future__ import annotations

import hashlib
import logging
import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from wcsim.config import TownFile, read_toml
from wcsim.errors import ConfigError, TownError
from wcsim.towns.xmlio import content_digest, read_root

log = logging.getLogger("wcsim.towns")

NOT_TOWNS = ("scenes",)
MAX_CFG_BYTES = 1 << 20
_NET_KEYS = ("net-file", "net", "n")
_ROUTE_KEYS = ("route-files", "routes", "r")
_MORE_KEYS = ("additional-files", "additional", "a")


@dataclass(frozen=True, slots=True, kw_only=True)
class Town:
    """A folder that holds a whole SUMO scenario and, as `town.toml`, what SUMO does not know."""

    name: str
    split: str  # "train", "test" or "scene"
    folder: Path
    file: TownFile
    sumocfg: Path
    net: Path
    poly: Path | None
    routes: tuple[Path, ...] = ()
    additional: tuple[Path, ...] = ()  # the polygons among them


def find_town(name_or_path: str) -> Town:
    """The town of that name (in ./scenarios/sumo, then in the package), or at that path (a folder or a .sumocfg).

    Raises:
        TownError: no such town, or its files are missing or broken.
    """
    if not name_or_path:
        raise TownError("a town has no name; give one of: " + _known() + ", or a path to a folder with a .sumocfg")
    for root in town_roots():
        folder = root / name_or_path
        if re.fullmatch(r"[\w-]+", name_or_path) and name_or_path not in NOT_TOWNS and _configs(folder):
            return open_town(folder)
    path = Path(name_or_path).expanduser()
    if path.is_dir() or path.is_file():
        return open_town(path)
    raise TownError(
        f"unknown town {name_or_path!r}; expected one of: {_known()}, or a path to a folder with a .sumocfg"
    )


def list_towns() -> tuple[Town, ...]:
    """All towns that can be found by name, sorted; one in ./scenarios/sumo hides one of the package.

    A folder that cannot be opened is logged and left out, so that one broken town does not hide the others.
    """
    towns: dict[str, Town] = {}
    for root in town_roots():
        for folder in sorted(root.iterdir()):
            if folder.name not in NOT_TOWNS and folder.name not in towns and _configs(folder):
                try:
                    towns[folder.name] = open_town(folder)
                except (TownError, ConfigError) as error:
                    log.warning("left out: %s", error)
    return tuple(towns[name] for name in sorted(towns))


def town_roots() -> tuple[Path, ...]:
    """Folders in which towns are looked up by name, first hit first."""
    package = Path(__file__).resolve().parents[1]
    places = (Path.cwd() / "scenarios" / "sumo", package / "scenarios" / "sumo", package.parent / "scenarios" / "sumo")
    return tuple(dict.fromkeys(place for place in places if place.is_dir()))


def open_town(path: Path) -> Town:
    """The town in a folder, or of a .sumocfg file. Raises TownError with the cure when a file is missing."""
    sumocfg = path if path.is_file() else _only_config(path)
    folder = sumocfg.parent
    root = read_root(sumocfg, MAX_CFG_BYTES)
    nets = _inputs(root, _NET_KEYS, folder)
    if len(nets) != 1:
        raise TownError(f"{sumocfg}: names {len(nets)} nets; expected one <net-file value=...> in <input>")
    routes, additional = _inputs(root, _ROUTE_KEYS, folder), _inputs(root, _MORE_KEYS, folder)
    missing = [str(item) for item in (*nets, *routes, *additional) if not item.is_file()]
    if missing:
        raise TownError(f"{sumocfg}: names a file that is not there: {missing[0]}; restore it or correct the sumocfg")
    poly = next((item for item in additional if re.search(r"\.poly\.xml(\.gz)?$", item.name)), None)
    file = town_file(folder, sumocfg)
    return Town(
        name=file.name,
        split=file.split,
        folder=folder,
        file=file,
        sumocfg=sumocfg,
        net=nets[0],
        poly=poly,
        routes=routes,
        additional=additional,
    )


def town_file(folder: Path, sumocfg: Path) -> TownFile:
    """`town.toml` of a folder; a SUMO scenario that was made elsewhere has none and gets the defaults."""
    toml = folder / "town.toml"
    if toml.is_file():
        return read_toml(toml, TownFile)
    name = re.sub(r"[^A-Za-z0-9_-]", "-", folder.resolve().name)[:64] or "town"
    return TownFile(name=name, split="train")


def content_hash(town: Town) -> str:
    """SHA-256 (hex) over all SUMO input files' uncompressed content, comments stripped; file names do not count."""
    digests = sorted(content_digest(path) for path in {town.net, *town.routes, *town.additional})
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()


def streets_hash(town: Town) -> str:
    """SHA-256 (hex) over the net alone: the same streets with other traffic are the same town to a network."""
    return content_digest(town.net)


def _only_config(folder: Path) -> Path:
    configs = _configs(folder)
    named = [item for item in configs if item.stem == folder.resolve().name]
    if len(named or configs) == 1:
        return (named or configs)[0]
    got = ", ".join(item.name for item in configs) or "none"
    raise TownError(f"{folder}: expected one .sumocfg file, got {got}; give the path of the one that is meant")


def _configs(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.sumocfg")) if folder.is_dir() else []


def _inputs(root: Element, keys: tuple[str, ...], folder: Path) -> tuple[Path, ...]:
    found: list[Path] = []
    for element in root.iter():
        if element.tag in keys:
            value = element.get("value") or element.get("v") or ""
            found += [folder / part.strip() for part in value.split(",") if part.strip()]
    return tuple(found)


def _known() -> str:
    names = {
        item.name for root in town_roots() for item in root.iterdir() if item.name not in NOT_TOWNS and _configs(item)
    }
    return ", ".join(sorted(names)) or "(no town is installed)"
