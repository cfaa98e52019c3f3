"""Make a town folder of an author's ready scenario: byte-for-byte copies of the files it names, and a town.toml.

Only files that SUMO reads go with the copy, and the author's notices; private files of other kinds stay behind.
"""

import os
import shutil
from pathlib import Path

from wcsim.core.files import write_folder_atomically
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import EDGES, NOTICE, SCENARIO, is_file, open_regular_file, read_module_toml, read_text
from wcsim.core.reading import read_bytes as read_plain
from wcsim.errors import TownError
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.importing.folder_texts import check_new, check_words, town_toml_text
from wcsim.towns.scenario.files import FilteredFiles, check_file, check_inside
from wcsim.towns.scenario.options import Configuration, Content, Treatment, read_configuration
from wcsim.towns.scenario.town import Town, net_middle, open_town
from wcsim.towns.sumo.xml_io import MAX_XML_BYTES, content_digest, read_bytes, scan

_MAX_FILES = 500
_SETTINGS = "gui-settings-file"  # not needed, but it makes the town look as its author likes it
_NOTICES = ("LICENSE*", "LICENCE*", "COPYING*", "README*")
_ROOTS = frozenset(read_module_toml(__file__)["roots"].split())
_FOREIGN = """\
The files in this folder, but for this one and a town.toml, were made of somebody's scenario ({config}). They are its
author's, under the author's licence, and wcsim gives no right to pass them on. {beside}
"""
_PICTURES = (b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"BM")
_SELECTED = ("edge:", "lane:")


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
        source: Where it comes from; default: that it is of another author.
        outside: Whether it may name files outside of its own folder.
        cycle_paths: Whether chairs drive on its cycle paths.

    Raises:
        TownError: a file is missing, broken, elsewhere, or of no kind of SUMO's, or `out` is in the way.
    """
    if not sumocfg.is_file():
        raise TownError(f"{sumocfg}: there is no such file; expected a .sumocfg")
    check_words(name, split)
    check_new(out)
    start = Path(os.path.normpath(sumocfg.absolute()))
    config = read_configuration(start)
    border = None if outside else start.parent
    check_inside(start, border, start)
    _files_of(config, border)  # missing files are reported before SUMO opens a large net
    validate_net(_net_of(config, border), border=border)
    with write_folder_atomically(out) as work:
        base, files = copy_scenario(config, border, work)
        names = [path.relative_to(base) for path in files]
        hashes = {str(place): content_digest(work / place) for place in names}
        toml = town_toml_text(
            name=name,
            split=split,
            origin_m=net_middle(_net_of(config, None)),
            cycle_paths=cycle_paths,
            hashes=hashes,
            sumocfg=str(config.path.relative_to(base)),
            source=source or f"scenario {config.path.name} of another author; ask the author for the licence",
        )
        (work / "town.toml").write_text(toml, encoding="utf-8")
    return open_town(out)


def copy_scenario(
    config: Configuration, border: Path | None, work: Path, around: Path | None = None
) -> tuple[Path, tuple[Path, ...]]:
    """Copy all files of a scenario into the folder `work`, with the licence and the readme beside them.

    Args:
        config: The scenario.
        border: As for `_files_of`.
        work: An empty folder.
        around: A folder that has a place in the copy too, whatever lies in it.

    Returns:
        The folder whose place `work` takes, and the files as they lie below it.

    Raises:
        TownError: as `_files_of`, or the copy would still name a file elsewhere.
    """
    start = Path(os.path.normpath(config.path.absolute()))
    files = _files_of(config, border)
    whole = (Path(os.path.normpath(around.absolute())),) if around is not None else ()
    base = Path(os.path.commonpath([*(path.parent for path in files), *whole]))
    settings = {Path(os.path.normpath(path.absolute())) for path in config.files(_SETTINGS)}
    for path in files:
        place = work / path.relative_to(base)
        place.parent.mkdir(parents=True, exist_ok=True)
        (_copy_settings if path in settings else copy_file)(path, place)
    _stay_inside(read_configuration(work / start.relative_to(base)), work)
    notices = _copy_notices(start.parent, work / start.relative_to(base).parent, border)
    if not (work / "LICENSE-DATA").exists():
        beside = (
            f"What lay beside it: {', '.join(notices)}." if notices else "No licence lay beside it: ask its author."
        )
        notice = _FOREIGN.format(config=start.name, beside=beside)
        (work / "LICENSE-DATA").write_text(notice, encoding="utf-8")
    return base, files


def _files_of(config: Configuration, border: Path | None) -> tuple[Path, ...]:
    """The configuration and every file that SUMO reads because of it, absolute, sorted.

    Raises:
        TownError: One is missing, broken, outside of `border`, or of no kind of SUMO's.
    """
    with create_temporary_folder() as folder:
        met = FilteredFiles(folder, border)
        for item in config.given:
            if item.option.treatment is Treatment.INPUT and item.value:
                if item.option.reads is not Content.XML and not item.option.name.endswith("input-file"):
                    raise TownError(
                        f"{config.path}: sets <{item.option.name}>, which cannot be copied; remove that option"
                    )
                for path in item.files(config.path.parent):
                    met.place_option(item.option, path, config.path)
        for path in met.read:
            _check_kind(path, text=path in met.texts)
        found = {config.path, *met.read, *(path for path in met.pictures if _is_picture(path, border))}
    for path in filter(is_file, config.files(_SETTINGS)):
        check_inside(path, border, config.path)
        found.add(path)
    if len(found) > _MAX_FILES:
        raise TownError(f"{config.path}: names {len(found)} files; expected at most {_MAX_FILES}")
    return tuple(sorted({Path(os.path.normpath(path.absolute())) for path in found}))


def _net_of(config: Configuration, border: Path | None) -> Path:
    nets = config.files("net-file")
    if len(nets) != 1:
        listed = ", ".join(map(str, nets)) or "none"
        raise TownError(f"{config.path}: expected one <net-file value=...> that exists, got {listed}")
    check_file(nets[0], border, config.path)
    return nets[0]


def _stay_inside(config: Configuration, folder: Path) -> None:
    """Raise TownError when the copy still names a file elsewhere: by an absolute path, or through the environment."""
    inside = os.path.normpath(folder.absolute())
    elsewhere = [path for path in _files_of(config, None) if not path.is_relative_to(inside)]
    if elsewhere:
        raise TownError(
            f"{config.path.name}: names {elsewhere[0]} by a path that a copy cannot follow; name it relative to the "
            f"{config.path.suffix} file"
        )


def copy_file(path: Path, place: Path) -> None:
    """Copy a regular file. Raises TownError when it is none."""
    with open_regular_file(path, SCENARIO) as source, place.open("wb") as target:
        shutil.copyfileobj(source, target)


def _copy_settings(path: Path, place: Path) -> None:
    """Copy the settings of a window; of what is none of SUMO's goes an empty one, for SUMO wants the file."""
    try:
        _check_root(path)
    except TownError:
        place.write_text("<viewsettings/>\n", encoding="utf-8")
    else:
        copy_file(path, place)


def _copy_notices(source: Path, out: Path, border: Path | None) -> tuple[str, ...]:
    """Copy the licence and the readme that lie beside a scenario, and not elsewhere; returns their names."""
    names = set()
    for path in (path for mask in _NOTICES for path in source.glob(mask)):
        try:
            check_inside(path, border, source)
            notice = read_plain(path, NOTICE)
        except TownError:  # a link to elsewhere, or no notice
            continue
        names.add(path.name)
        if not (out / path.name).exists():
            (out / path.name).write_bytes(notice)
    return tuple(sorted(names))


def _check_kind(path: Path, *, text: bool) -> None:
    """Return for a file of SUMO's, XML or else a list of edges. Raises TownError."""
    if not text:
        _check_root(path)
    elif not all(line.startswith(_SELECTED) for line in read_text(path, EDGES).split()):
        raise TownError(
            f"{path}: is not a list of edges; expected lines such as edge:ID: remove it, or correct its lines"
        )


def _check_root(path: Path) -> None:
    """Raise TownError for XML that is none of SUMO's: it may be anybody's, and a town is made to be passed on."""
    tags: list[str] = []
    scan(read_bytes(path, MAX_XML_BYTES), str(path), lambda tag, _: tags.append(tag) if not tags else None)
    if tags[0].rpartition(":")[2] not in _ROOTS:
        raise TownError(
            f"{path}: begins with <{tags[0][:40]}>, which is no SUMO file; expected routes, additional, ..."
        )


def _is_picture(path: Path, border: Path | None) -> bool:
    """Whether a picture that sumo-gui would show can go with the copy."""
    try:
        check_file(path, border, path)
        with open_regular_file(path, SCENARIO) as file:
            return file.read(8).startswith(_PICTURES)
    except TownError:
        return False
