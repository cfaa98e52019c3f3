"""Make a town folder of an author's ready scenario: exact copies of its files, and a town.toml.

Only files that SUMO reads go with the copy, and the author's notices; private files of other kinds
stay behind.
"""

import os
import shutil
from contextlib import suppress
from pathlib import Path

from wcsim.core.files import write_folder_atomically
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import (
    EDGES,
    NOTICE,
    SCENARIO,
    is_file,
    open_regular_file,
    read_module_toml,
    read_text,
)
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
_DATA = read_module_toml(__file__)
_ROOTS = frozenset(_DATA["roots"].split())
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
    """Copy a scenario and all the files it names into the new folder `out`, and open it.

    The folders below it stay as they are. What is copied are files that SUMO reads, of its own
    kinds, and the licence and the readme beside them.

    Args:
        sumocfg: The author's configuration; it and its files stay as they are.
        name: The town's name.
        out: A folder that is not there yet, or is empty.
        split: "train" or "test".
        source: Where it comes from; default: that it is of another author.
        outside: Whether it may name files outside of its own folder.
        cycle_paths: Whether chairs drive on its cycle paths.

    Raises:
        TownError: A file is missing, broken, elsewhere, or of no kind of SUMO's, or `out` is in the
            way.
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
        unnamed = f"scenario {config.path.name} of another author; ask the author for the licence"
        toml = town_toml_text(
            name=name,
            split=split,
            origin_m=net_middle(_net_of(config, None)),
            cycle_paths=cycle_paths,
            hashes=hashes,
            sumocfg=str(config.path.relative_to(base)),
            source=source or unnamed,
        )
        (work / "town.toml").write_text(toml, encoding="utf-8")
    return open_town(out)


def copy_scenario(
    config: Configuration, border: Path | None, work: Path, around: Path | None = None
) -> tuple[Path, tuple[Path, ...]]:
    """Copy all files of a scenario into the folder `work`, with licence and readme beside them.

    Args:
        config: The scenario.
        border: As for `_files_of`.
        work: An empty folder.
        around: A folder that has a place in the copy too, whatever lies in it.

    Returns:
        The folder whose place `work` takes, and the files as they lie below it.

    Raises:
        TownError: As `_files_of`, or the copy would still name a file elsewhere.
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

    # The copy must not name files elsewhere: by an absolute path, or through the environment.
    own_config, inside = work / start.relative_to(base), os.path.normpath(work.absolute())
    named = _files_of(read_configuration(own_config), None)
    if elsewhere := [path for path in named if not path.is_relative_to(inside)]:
        raise TownError(
            f"{own_config.name}: names {elsewhere[0]} by a path that a copy cannot follow; "
            f"name it relative to the {own_config.suffix} file"
        )

    # The licence and the readme that lie beside the scenario go along; nothing from elsewhere does.
    notices = set()
    for path in (path for mask in _NOTICES for path in start.parent.glob(mask)):
        try:
            check_inside(path, border, start.parent)
            notice = read_plain(path, NOTICE)
        except TownError:  # a link to elsewhere, or no notice
            continue
        notices.add(path.name)
        if not (own_config.parent / path.name).exists():
            (own_config.parent / path.name).write_bytes(notice)
    if not (work / "LICENSE-DATA").exists():
        beside = "No licence lay beside it: ask its author."
        if notices:
            beside = f"What lay beside it: {', '.join(sorted(notices))}."
        text = _DATA["foreign"].format(config=start.name, beside=beside)
        (work / "LICENSE-DATA").write_text(text, encoding="utf-8")
    return base, files


def copy_file(path: Path, place: Path) -> None:
    """Copy a regular file. Raises TownError when it is none."""
    with open_regular_file(path, SCENARIO) as source, place.open("wb") as target:
        shutil.copyfileobj(source, target)


def _files_of(config: Configuration, border: Path | None) -> tuple[Path, ...]:
    """The configuration and every file that SUMO reads because of it, absolute, sorted.

    Raises:
        TownError: One is missing, broken, outside of `border`, or of no kind of SUMO's.
    """
    with create_temporary_folder() as folder:
        met = FilteredFiles(folder, border)
        for item in config.given:
            option = item.option
            if option.treatment is not Treatment.INPUT or not item.value:
                continue
            if option.reads is not Content.XML and not option.name.endswith("input-file"):
                raise TownError(
                    f"{config.path}: sets <{option.name}>, which cannot be copied; "
                    "remove that option"
                )
            for path in item.files(config.path.parent):
                met.place_option(option, path, config.path)
        for path in met.read:
            if path in met.texts:
                _check_edges(path)
            else:
                _check_root(path)
        found = {config.path, *met.read}
        # Pictures that sumo-gui would show go along, where they can: a town does without them.
        for path in met.pictures:
            with suppress(TownError):
                check_file(path, border, path)
                with open_regular_file(path, SCENARIO) as file:
                    if file.read(8).startswith(_PICTURES):
                        found.add(path)
    for path in filter(is_file, config.files(_SETTINGS)):
        check_inside(path, border, config.path)
        found.add(path)
    if len(found) > _MAX_FILES:
        raise TownError(f"{config.path}: names {len(found)} files; expected at most {_MAX_FILES}")
    return tuple(sorted({Path(os.path.normpath(path.absolute())) for path in found}))


def _check_edges(path: Path) -> None:
    """Raise TownError for a text that is no list of edges."""
    if not all(line.startswith(_SELECTED) for line in read_text(path, EDGES).split()):
        raise TownError(
            f"{path}: is not a list of edges; expected lines such as edge:ID: "
            "remove it, or correct its lines"
        )


def _net_of(config: Configuration, border: Path | None) -> Path:
    nets = config.files("net-file")
    if len(nets) != 1:
        listed = ", ".join(map(str, nets)) or "none"
        raise TownError(
            f"{config.path}: expected one <net-file value=...> that exists, got {listed}"
        )
    check_file(nets[0], border, config.path)
    return nets[0]


def _copy_settings(path: Path, place: Path) -> None:
    """Copy the settings of a window, or an empty file: SUMO needs one, and others are private."""
    try:
        _check_root(path)
    except TownError:
        place.write_text("<viewsettings/>\n", encoding="utf-8")
    else:
        copy_file(path, place)


def _check_root(path: Path) -> None:
    """Raise TownError for XML that is none of SUMO's: it may be private; towns are passed on."""
    tags: list[str] = []
    data = read_bytes(path, MAX_XML_BYTES)
    scan(data, str(path), lambda tag, _: tags.append(tag) if not tags else None)
    if tags[0].rpartition(":")[2] not in _ROOTS:
        raise TownError(
            f"{path}: begins with <{tags[0][:40]}>, which is no SUMO file; "
            "expected routes, additional, ..."
        )
