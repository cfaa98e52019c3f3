"""Make a town folder of somebody's ready scenario: byte-for-byte copies of the files it names, and a town.toml."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path

from wcsim.errors import TownError
from wcsim.towns.folder import foreign_license_text, town_toml_text
from wcsim.towns.netcheck import validate_net
from wcsim.towns.scenario_files import FilteredFiles
from wcsim.towns.scenario_names import OutputNames
from wcsim.towns.scenario_options import Configuration, Treatment, read_configuration
from wcsim.towns.town import NOT_TOWNS, Town, net_middle, open_town
from wcsim.towns.xmlio import content_digest, is_folder, is_there

MAX_FILES = 500
NOTICES = ("LICENSE*", "LICENCE*", "COPYING*", "README*")
NOTICE_BYTES = 1 << 20
_SETTINGS = ("gui-settings-file",)  # not needed, but it makes the town look as its author likes it


def adopt_scenario(sumocfg: Path, name: str, out: Path, split: str = "train", source: str = "") -> Town:
    """Copy a scenario and all the files it names into the new folder `out`, its structure kept, and open it.

    Args:
        sumocfg: The author's configuration; it and its files stay as they are.
        name: The town's name.
        out: A folder that is not there yet, or is empty.
        split: "train" or "test".
        source: Where it comes from; default: that it is somebody else's.

    Raises:
        TownError: a file is missing or broken, lies where a copy cannot name it, or `out` is in the way.
    """
    if not sumocfg.is_file():
        raise TownError(f"{sumocfg}: there is no such file; expected somebody's .sumocfg")
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", name):
        raise TownError(f"town name {name!r}: expected 1 to 64 letters, digits, - or _")
    if name in NOT_TOWNS:
        raise TownError(f"a town cannot be named {name!r}, for that is no town's folder; choose another name")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise TownError(f"{out} is there already; remove it, or choose another place")
    start = Path(os.path.normpath(sumocfg.absolute()))
    config = read_configuration(start)
    validate_net(_net_of(config))
    files = files_of(config)
    base = Path(os.path.commonpath([path.parent for path in files]))
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as folder:
        work = Path(folder) / out.name
        for path in files:
            place = work / path.relative_to(base)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, place)
        notices = _copy_notices(start.parent, work / start.relative_to(base).parent)
        if not (work / "LICENSE-DATA").exists():
            told = foreign_license_text(start.name, notices)
            (work / "LICENSE-DATA").write_text(told, encoding="utf-8")
        (work / "town.toml").write_text(_town_toml(config, name, (split, source), base, files), encoding="utf-8")
        _stay_inside(read_configuration(work / start.relative_to(base)), work)
        if out.is_dir():
            out.rmdir()
        work.replace(out)
    return open_town(out)


def _copy_notices(source: Path, out: Path) -> tuple[str, ...]:
    """Copy the licence and the readme that lie beside a scenario; returns their names."""
    found = [path for mask in NOTICES for path in source.glob(mask) if path.is_file()]
    found = [path for path in found if path.stat().st_size <= NOTICE_BYTES]
    for path in found:
        if not (out / path.name).exists():
            shutil.copyfile(path, out / path.name)
    return tuple(sorted({path.name for path in found}))


def files_of(config: Configuration) -> tuple[Path, ...]:
    """The configuration and every file that SUMO reads because of it, absolute, sorted. Raises TownError."""
    with tempfile.TemporaryDirectory(prefix="wcsim-adopt-") as folder:
        names = OutputNames(Path(folder))
        met = FilteredFiles(names, Path(folder))
        for item in config.given:
            if item.option.treatment is Treatment.INPUT:
                for path in item.files(config.path.parent):
                    if not is_folder(path):
                        met.place(path, config.path)
        found = {config.path, *met.read}
    for name in _SETTINGS:
        found.update(path for path in config.files(name) if is_there(path))
    if len(found) > MAX_FILES:
        raise TownError(f"{config.path}: names {len(found)} files; expected at most {MAX_FILES}")
    return tuple(sorted({Path(os.path.normpath(path.absolute())) for path in found}))


def _net_of(config: Configuration) -> Path:
    nets = config.files("net-file")
    if len(nets) != 1 or not is_there(nets[0]):
        raise TownError(f"{config.path}: expected one <net-file value=...> that is there, got {_listed(nets)}")
    return nets[0]


def _town_toml(config: Configuration, name: str, told: tuple[str, str], base: Path, files: tuple[Path, ...]) -> str:
    split, source = told
    text = town_toml_text(
        name=name,
        split=split,
        origin_m=net_middle(_net_of(config)),
        source=source or f"scenario {config.path.name} of somebody else; ask its author for the licence",
        hashes={str(path.relative_to(base)): content_digest(path) for path in files},
    )
    return text.replace("\nsource = ", f"\nsumocfg = {_toml(config.path.relative_to(base))}\nsource = ", 1)


def _toml(path: Path) -> str:
    return '"' + str(path).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _stay_inside(config: Configuration, folder: Path) -> None:
    """Raise TownError when the copy still names a file elsewhere: by an absolute path, or through the environment."""
    outside = [path for path in files_of(config) if not path.is_relative_to(folder.absolute())]
    if outside:
        raise TownError(
            f"{config.path.name}: names {outside[0]} by a path that a copy cannot follow; name it relative to the "
            f"{config.path.suffix} file"
        )


def _listed(paths: tuple[Path, ...]) -> str:
    return ", ".join(str(path) for path in paths) or "none"
