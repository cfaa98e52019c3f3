"""Make a town folder of somebody's ready scenario: byte-for-byte copies of the files it names, and a town.toml."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path

from wcsim.core.reading import is_file
from wcsim.errors import TownError
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.importing.adopt_files import copy_file, copy_notices, copy_settings, is_picture, require_kind
from wcsim.towns.importing.folder_texts import foreign_license_text, town_toml_text
from wcsim.towns.scenario.border import require_file, require_inside
from wcsim.towns.scenario.files import FilteredFiles
from wcsim.towns.scenario.options import Configuration, Content, Treatment, read_configuration
from wcsim.towns.scenario.outputs import OutputNames
from wcsim.towns.scenario.town import NOT_TOWNS, Town, net_middle, open_town
from wcsim.towns.sumo.xml_io import content_digest

_MAX_FILES = 500
_SETTINGS = "gui-settings-file"  # not needed, but it makes the town look as its author likes it


def adopt_scenario(
    sumocfg: Path,
    name: str,
    out: Path,
    split: str = "train",
    source: str = "",
    *,
    outside: bool = False,
    cycle_paths: bool = False,
) -> Town:
    """Copy a scenario and all the files it names into the new folder `out`, its structure kept, and open it.

    What is copied are files that SUMO reads, of its own kinds, and the licence and the readme beside them.

    Args:
        sumocfg: The author's configuration; it and its files stay as they are.
        name: The town's name.
        out: A folder that is not there yet, or is empty.
        split: "train" or "test".
        source: Where it comes from; default: that it is somebody else's.
        outside: Whether it may name files outside of its own folder.
        cycle_paths: Whether chairs drive on its cycle paths.

    Raises:
        TownError: a file is missing, broken, elsewhere, or of no kind of SUMO's, or `out` is in the way.
    """
    if not sumocfg.is_file():
        raise TownError(f"{sumocfg}: there is no such file; expected a .sumocfg")
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", name):
        raise TownError(f"town name {name!r}: expected 1 to 64 letters, digits, - or _")
    if name in NOT_TOWNS:
        raise TownError(f"a town cannot be named {name!r}: that folder is reserved; choose another name")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise TownError(f"{out} already exists; remove it, or choose another folder")
    start = Path(os.path.normpath(sumocfg.absolute()))
    config = read_configuration(start)
    border = None if outside else start.parent
    require_inside(start, border, start)
    files_of(config, border)  # what is missing is said before SUMO opens a large net
    validate_net(_net_of(config, border), border=border)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as folder:
        work = Path(folder) / out.name
        base, files = copy_scenario(config, border, work)
        names = [path.relative_to(base) for path in files]
        hashes = {str(place): content_digest(work / place) for place in names}
        toml = _town_toml(config, name, (split, source), config.path.relative_to(base), hashes, cycle_paths)
        (work / "town.toml").write_text(toml, encoding="utf-8")
        if out.is_dir():
            out.rmdir()
        work.replace(out)
    return open_town(out)


def copy_scenario(
    config: Configuration, border: Path | None, work: Path, around: Path | None = None
) -> tuple[Path, tuple[Path, ...]]:
    """Copy all files of a scenario into the folder `work`, with the licence and the readme beside them.

    Args:
        config: The scenario.
        border: As for `files_of`.
        work: A folder that is not there yet.
        around: A folder that has a place in the copy too, whatever lies in it.

    Returns:
        The folder whose place `work` takes, and the files as they lie below it.

    Raises:
        TownError: as `files_of`, or the copy would still name a file elsewhere.
    """
    start = Path(os.path.normpath(config.path.absolute()))
    files = files_of(config, border)
    whole = (Path(os.path.normpath(around.absolute())),) if around is not None else ()
    base = Path(os.path.commonpath([*(path.parent for path in files), *whole]))
    settings = {Path(os.path.normpath(path.absolute())) for path in config.files(_SETTINGS)}
    for path in files:
        place = work / path.relative_to(base)
        place.parent.mkdir(parents=True, exist_ok=True)
        (copy_settings if path in settings else copy_file)(path, place)
    _stay_inside(read_configuration(work / start.relative_to(base)), work)
    notices = copy_notices(start.parent, work / start.relative_to(base).parent, border)
    if not (work / "LICENSE-DATA").exists():
        (work / "LICENSE-DATA").write_text(foreign_license_text(start.name, notices), encoding="utf-8")
    return base, files


def files_of(config: Configuration, border: Path | None) -> tuple[Path, ...]:
    """The configuration and every file that SUMO reads because of it, absolute, sorted.

    Raises:
        TownError: One is missing, broken, outside of `border`, or of no kind of SUMO's.
    """
    with tempfile.TemporaryDirectory(prefix="wcsim-adopt-") as folder:
        names = OutputNames(Path(folder))
        met = FilteredFiles(names, Path(folder), border)
        for item in config.given:
            if item.option.treatment is Treatment.INPUT and item.value:
                if item.option.reads is not Content.XML and not item.option.name.endswith("input-file"):
                    raise TownError(
                        f"{config.path}: sets <{item.option.name}>, which cannot be copied; remove that option"
                    )
                for path in item.files(config.path.parent):
                    met.place_option(item.option, path, config.path)
        for path in met.read:
            require_kind(path, text=path in met.texts)
        found = {config.path, *met.read, *(path for path in met.pictures if is_picture(path, border))}
    for path in filter(is_file, config.files(_SETTINGS)):
        require_inside(path, border, config.path)
        found.add(path)
    if len(found) > _MAX_FILES:
        raise TownError(f"{config.path}: names {len(found)} files; expected at most {_MAX_FILES}")
    return tuple(sorted({Path(os.path.normpath(path.absolute())) for path in found}))


def _net_of(config: Configuration, border: Path | None) -> Path:
    nets = config.files("net-file")
    if len(nets) != 1:
        raise TownError(f"{config.path}: expected one <net-file value=...> that exists, got {_listed(nets)}")
    require_file(nets[0], border, config.path)
    return nets[0]


def _town_toml(
    config: Configuration, name: str, told: tuple[str, str], sumocfg: Path, hashes: dict[str, str], cycle_paths: bool
) -> str:
    split, source = told
    text = town_toml_text(
        name=name,
        split=split,
        origin_m=net_middle(_net_of(config, None)),
        source=source or f"scenario {config.path.name} of another author; ask the author for the licence",
        hashes=hashes,
    )
    text = text.replace('"shared"]', '"shared", "cycleway"]', int(cycle_paths))
    return text.replace("\nsource = ", f"\nsumocfg = {_toml(sumocfg)}\nsource = ", 1)


def _toml(path: Path) -> str:
    return '"' + str(path).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _stay_inside(config: Configuration, folder: Path) -> None:
    """Raise TownError when the copy still names a file elsewhere: by an absolute path, or through the environment."""
    inside = os.path.normpath(folder.absolute())
    elsewhere = [path for path in files_of(config, None) if not path.is_relative_to(inside)]
    if elsewhere:
        raise TownError(
            f"{config.path.name}: names {elsewhere[0]} by a path that a copy cannot follow; name it relative to the "
            f"{config.path.suffix} file"
        )


def _listed(paths: tuple[Path, ...]) -> str:
    return ", ".join(str(path) for path in paths) or "none"
