"""Towns on disk: found by name or path, compared by hash, and changed since their import or not."""

import hashlib
import logging
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from wcsim.config import TownFile, read_toml
from wcsim.config.scene import ChairWay
from wcsim.core.reading import HEIGHTS, TOWN, escape, is_file, is_folder, read_bytes
from wcsim.errors import ConfigError, TownError, meant
from wcsim.towns.scenario.files import check_file, check_inside, with_included
from wcsim.towns.scenario.options import Configuration, read_configuration
from wcsim.towns.sumo.xml_io import content_digest, read_head, read_root

log = logging.getLogger("wcsim.towns")

NOT_TOWNS = ("scenes",)
TOWN_TOML = "town.toml"
_BOUNDARY = re.compile(rb"""<location\b[^<>]*\bconvBoundary\s*=\s*["']([^"']*)["']""")
_LOCATION_BYTES = 1 << 20
# So far from its origin a mesh of 32-bit numbers knows no millimetres, and soon no kerbs.
_FAR_M = 10_000.0
_POLYGONS = re.compile(r"\.poly\.xml(\.gz)?$")
KINDS = ("net.xml.gz", "poly.xml.gz", "rou.xml.gz", "dem.tif", "add.xml", "sumocfg")
# What the importer writes besides, and the extract.
BESIDE = ("town.toml", "LICENSE-DATA", "osm/bbox")
CYCLE_PATHS = "--cycle-paths"  # of `wcsim town import`
# Keys of a town.toml that no importer writes.
_AUTHORED_KEYS = ("kerb_height_m", "lowered_kerb_m", "chair_ways", "warmup_s", "sumocfg")


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
    # Nothing outside of this folder is opened because of it. None: its user trusts it.
    border: Path | None = None
    passing: bool = False  # it is driven once: what is built of it is not cached
    drafted: bool = False  # wcsim wrote it: no child tries its first steps

    @property
    def declared(self) -> bool:
        """Whether a town.toml says what it is for; without one, `split` is a mere guess."""
        return (self.folder / TOWN_TOML).is_file()

    @property
    def address(self) -> str:
        """What `find_town` takes to find this town again, in this process or another one."""
        try:
            return str(self.folder if _main_config(self.folder) == self.sumocfg else self.sumocfg)
        except TownError:
            return str(self.sumocfg)


def find_town(name_or_path: str, *, outside: bool = False) -> Town:
    """The town of a name or at a path.

    Args:
        name_or_path: A name, looked up in ./scenarios/sumo and then in the package; or the path of
            a folder or a .sumocfg.
        outside: Whether a scenario at a path may name files outside of its folder.

    Raises:
        TownError: no such town, or its files are missing, broken, or elsewhere.
    """
    # 1. A name hides a path.
    if not name_or_path:
        raise TownError(
            f"the town name is empty; expected one of: {_known()}, "
            "or a path to a folder with a .sumocfg"
        )
    is_name = re.fullmatch(r"[\w-]+", name_or_path) and name_or_path not in NOT_TOWNS
    for root in town_roots():
        if is_name and _is_town(root / name_or_path):
            return open_town(root / name_or_path)

    # 2. Else it is a path.
    path = expanded(name_or_path)
    if is_folder(path) or is_file(path):
        return open_town(path, outside=outside)

    # 3. Else the message depends on what it looks like.
    named = escape(name_or_path, 160)
    is_config = name_or_path.endswith(".sumocfg")
    if is_config or "/" in name_or_path:
        what = "file" if is_config else "folder"
        raise TownError(
            f"{named}: there is no such {what}, seen from {Path.cwd()}; expected a folder with a "
            f".sumocfg, the path of one, or a town: {_known()}"
        )
    raise TownError(
        f"unknown town {named!r}; expected one of: {_known()}, or a path to a folder with a "
        f".sumocfg{meant(name_or_path, _known().split(', '))}"
    )


def expanded(path: str) -> Path:
    """A path as it was typed, with the home folder in place of ~ where that user is known."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)


def list_towns() -> tuple[Town, ...]:
    """All towns that can be found by name, sorted; one in ./scenarios/sumo hides the package's.

    A folder that cannot be opened is logged and left out: it hides no other one.
    """
    towns: dict[str, Town] = {}
    for root in town_roots():
        for folder in sorted(root.iterdir()):
            if folder.name not in NOT_TOWNS and folder.name not in towns and _is_town(folder):
                try:
                    towns[folder.name] = open_town(folder)
                except (TownError, ConfigError) as error:
                    log.warning("left out: %s", error)
    return tuple(towns[name] for name in sorted(towns))


def by_name(towns: Iterable[Town]) -> dict[str, Town]:
    """Towns by the name that their results go by. Raises TownError when two of them share one."""
    found: dict[str, Town] = {}
    for town in towns:
        other = found.setdefault(town.name, town)
        if other.sumocfg.resolve() != town.sumocfg.resolve():
            raise TownError(
                f"{other.address} and {town.address} are both named {town.name}; use one at a time"
            )
    return found


def town_roots() -> tuple[Path, ...]:
    """Folders in which towns are looked up by name, first hit first."""
    package = Path(__file__).resolve().parents[2]
    places = (place / "scenarios" / "sumo" for place in (Path.cwd(), package, package.parent))
    return tuple(dict.fromkeys(place for place in places if place.is_dir()))


def open_town(path: Path, *, outside: bool = False) -> Town:
    """The town in a folder, or of a .sumocfg file.

    Args:
        path: The one or the other.
        outside: Whether it may name files outside of its folder.

    Raises:
        TownError: A file is missing, broken, or elsewhere; with the cure.
    """
    sumocfg = path if path.is_file() else _main_config(path)
    folder = path.parent if path.is_file() else path
    border = None if outside else folder
    check_inside(sumocfg, border, sumocfg)
    config = read_configuration(sumocfg)
    nets = config.files("net-file")
    if len(nets) != 1:
        raise TownError(
            f"{sumocfg}: names {len(nets)} nets; expected one <net-file value=...> in <input>"
        )
    routes, additional = config.files("route-files"), config.files("additional-files")
    for item in (*nets, *routes, *additional):
        check_file(item, border, sumocfg)
    file = _town_file(folder, config)
    return Town(
        name=file.name,
        split=file.split,
        folder=folder,
        file=file,
        sumocfg=sumocfg,
        net=nets[0],
        poly=polygons_among(additional),
        routes=routes,
        additional=additional,
        border=border,
    )


def polygons_among(files: tuple[Path, ...]) -> Path | None:
    """The first file that its name says to hold buildings and trees, None where there is none."""
    return next((path for path in files if _POLYGONS.search(path.name)), None)


def _town_file(folder: Path, config: Configuration) -> TownFile:
    """`town.toml` of a folder; the origin is the middle of the net where it names none."""
    toml, net = folder / TOWN_TOML, config.files("net-file")[0]
    if toml.is_file():
        file = read_town_file(toml)
        if "origin_m" in file.model_fields_set:
            return file
        # A net may have UTM's coordinates, which are far from their origin.
        middle_m = net_middle(net)
        far = max(abs(middle_m[0]), abs(middle_m[1])) > _FAR_M
        return file.model_copy(update={"origin_m": middle_m}) if far else file
    # A scenario made elsewhere has no such file.
    place, alone = folder.resolve(), len(_configs(folder)) == 1
    words = place.name if alone else f"{place.name}-{config.path.stem}"
    name = re.sub(r"(-|[^A-Za-z0-9_])+", "-", words).strip("-")[:64] or "town"
    return TownFile(name=name, split="train", origin_m=net_middle(net))


def read_town_file(toml: Path) -> TownFile:
    """A `town.toml`. Raises ConfigError or TownError with every fault and its place."""
    return read_toml(toml, TownFile, TOWN)


def net_middle(net: Path) -> tuple[int, int]:
    """The middle of a net in its own coordinates, in whole metres; (0, 0) where it states none.

    Raises:
        TownError: the file cannot be read, or is no XML.
    """
    found = _BOUNDARY.search(read_head(net, _LOCATION_BYTES))
    # The reader of the net reports what is wrong with it.
    try:
        bounds_m = [float(part) for part in found.group(1).decode().split(",")] if found else []
        if not bounds_m:
            junctions = read_root(net).findall("junction")
            xs_m, ys_m = ([float(each.get(key, "0")) for each in junctions] for key in ("x", "y"))
            xs_m, ys_m = xs_m or [0.0], ys_m or [0.0]
            bounds_m = [min(xs_m), min(ys_m), max(xs_m), max(ys_m)]
        west_m, south_m, east_m, north_m = bounds_m
        return round((west_m + east_m) / 2), round((south_m + north_m) / 2)
    except (ValueError, OverflowError):
        return 0, 0


def content_hash(town: Town) -> str:
    """SHA-256 (hex) over all SUMO input files' uncompressed content, without comments and names.

    What these include counts too: SUMO reads it as a part of them.

    Raises:
        TownError: A file cannot be read, or what it includes is missing, or outside of the town's
            border.
    """
    named = (*town.routes, *town.additional)
    paths = {town.net, *named, *with_included(named, town.border)}
    return hashlib.sha256("\n".join(sorted(map(content_digest, paths))).encode()).hexdigest()


def streets_hash(town: Town) -> str:
    """SHA-256 (hex) over the net alone: to a network, other traffic makes no other town."""
    return content_digest(town.net)


def towns_hash(towns: Sequence[Town]) -> str:
    """SHA-256 (hex) over the streets of towns in their order.

    Of one town it is its `streets_hash`, of none "".
    """
    hashes = [streets_hash(town) for town in towns]
    if len(hashes) < 2:
        return "".join(hashes)
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def _main_config(folder: Path) -> Path:
    """The .sumocfg of a folder: the one of its town.toml, the only one, or the one of its name."""
    toml = folder / TOWN_TOML
    named_by_toml = read_town_file(toml).sumocfg if toml.is_file() else ""
    if named_by_toml:
        path = folder / named_by_toml
        check_inside(path, folder, toml)
        if not is_file(path):
            raise TownError(
                f"{toml}: names sumocfg {named_by_toml!r}, which is not there; "
                "restore or correct it"
            )
        return path
    if (folder / "scene.toml").is_file():
        raise TownError(f"{folder} is a scene, not a town; run it: wcsim scene run {folder}")
    configs = _configs(folder)
    named = [item for item in configs if item.stem == folder.resolve().name]
    if len(named or configs) == 1:
        return (named or configs)[0]
    found = ", ".join(item.name for item in configs) or "none"
    raise TownError(
        f"{folder}: expected one .sumocfg file, got {found}; give the path of the one that is meant"
    )


def _is_town(folder: Path) -> bool:
    # Such a name has an import that is not done, or was killed.
    if folder.name.startswith("."):
        return False
    return bool(_configs(folder)) or is_file(folder / TOWN_TOML)


def _configs(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.sumocfg")) if is_folder(folder) else []


def _known() -> str:
    names = {
        item.name
        for root in town_roots()
        for item in root.iterdir()
        if item.name not in NOT_TOWNS and _is_town(item)
    }
    return ", ".join(sorted(names)) or "(no town is installed)"


def hash_files(folder: Path, name: str) -> dict[str, str]:
    """SHA-256 (hex) of each file of a town that is there, by its ending; see `content_digest`."""
    paths = {kind: folder / f"{name}.{kind}" for kind in KINDS}
    return {kind: _digest(path) for kind, path in paths.items() if path.is_file()}


def find_changes(folder: Path, file: TownFile) -> tuple[Path, ...]:
    """Files of a town's folder that were changed since the import; none without a manifest."""
    # In an adopted scenario files are noted by their place in the folder.
    noted = {
        folder / (f"{file.name}.{kind}" if kind in KINDS else kind): was
        for kind, was in file.hashes.items()
    }
    changed = []
    for path, was in noted.items():
        try:
            now = _digest(path) if path.is_file() else ""
        except TownError:
            now = ""
        if now != was:
            changed.append(path)
    return tuple(changed)


def own_work(folder: Path) -> tuple[str, ...]:
    """Files of a town's folder that were changed or added since its import: sorted paths in it."""
    try:
        file = read_town_file(folder / "town.toml")
    except (ConfigError, TownError):
        return ("town.toml",)
    # 1. A town.toml with what no importer writes was changed by hand.
    changed = set(find_changes(folder, file))
    usual = TownFile(
        name=file.name, split=file.split, chair_ways=chair_ways(CYCLE_PATHS in file.rebuild)
    )
    if any(getattr(file, key) != getattr(usual, key) for key in _AUTHORED_KEYS):
        changed.add(folder / "town.toml")
    # 2. All files were added but those that the importer wrote.
    written: set[str] = set()
    if file.rebuild:
        written = {*BESIDE, f"osm/{file.name}.osm.xml.gz", f"opendrive/{file.name}.xodr.gz"}
        written.update(f"{file.name}.{kind}" for kind in KINDS)
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()}
    return tuple(sorted(name for name in there if name not in written or folder / name in changed))


def chair_ways(cycle_paths: bool) -> tuple[ChairWay, ...]:
    """Ways of the chairs of an imported or generated town, with cycle paths if the law permits."""
    return ("sidewalk", "crossing", "shared", *(("cycleway",) if cycle_paths else ()))


def _digest(path: Path) -> str:
    if path.suffix == ".tif":
        return hashlib.sha256(read_bytes(path, HEIGHTS)).hexdigest()
    return content_digest(path)
