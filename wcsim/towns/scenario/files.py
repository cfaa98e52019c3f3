"""Files of a scenario that name other files, to be read, included or written.

What they write goes into one folder, none twice. A file that writes nothing stays where it is. Only
one that writes is copied, with nothing but those names changed. Files outside of the scenario's
folder, its border, are neither opened nor copied unless its user permits it.
"""

import hashlib
import os
import re
import shlex
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from wcsim.core.files import find_cache_folder, write_bytes
from wcsim.core.reading import SCENARIO, escape, is_file, read_file_size
from wcsim.errors import DiskFullError, TownError
from wcsim.towns.scenario.options import Content, SumoOption
from wcsim.towns.sumo.xml_io import MAX_XML_BYTES, parse_root, read_bytes, scan

_ALLOW = "--allow-outside"
MAX_DEPTH = 16  # of files that include each other
NOWHERE = ("", "NUL", "nul", "/dev/null")  # "NULL" is a file of that name to SUMO
_COPIES = "inputs"
_RULES = b"1"  # of `_NamesFiles`; with another number it looks through all files anew
_LARGE_BYTES = 100_000
_UNSAFE = re.compile(r"[^A-Za-z0-9_.-]+")
_MAX_LENGTH = 120
_SUMO_SPLITS_AT = ",:;$%"  # lists, sockets and substitutions in SUMO's file names
# Elements and attributes that name XML files that SUMO reads.
_READ = {
    ("rerouter", "file"),
    ("variableSpeedSign", "file"),
    ("calibrator", "file"),
    ("include", "href"),
}
_TEXTS = ("edgesFile",)  # it reads them too, and they are no XML: a line for each edge
_PICTURES = ("imgFile", "osgFile", "href")  # sumo-gui shows them, SUMO itself never opens them
_READ_PARAMETERS = ("device.fcd-replay.file", "device.fcd-replay.files")
# What is not read is written.
_WRITTEN = re.compile(r"(?i)^(dest|.*((?<!pro)file|output))$")
_WRITTEN_PARAMETER = re.compile(r"(?i)^(.*[.-])?\s*\w*((?<!pro)files?|output)\s*$")
_GRIDS = re.compile(r"((?i:grids|catalog|init|file)\s*=)(?!\s*(@?null|epsg:\d+)(\s|$))")
# A path of these letters is spelt alike in every language.
_PLAIN = re.compile(r"(/[A-Za-z0-9_.+@=~()-]+( +[A-Za-z0-9_.+@=~()-]+)*)+")


def check_inside(path: Path, border: Path | None, named_by: Path) -> None:
    """Return when a file lies in the folder `border`, links followed; None is no border.

    Raises:
        TownError: It lies elsewhere, whether it exists or not; or no system could hold such a file.
    """
    try:
        real = Path(os.path.realpath(path))
        if border is None or real.is_relative_to(os.path.realpath(border)):
            return
    except ValueError as error:  # NUL in the path
        raise TownError(
            f"{escape(named_by)}: names {escape(path)} ({error}); correct the name"
        ) from None
    # Some commands trust a scenario as it is. A copy of it is for every command.
    if named_by.suffix != ".sumocfg":
        copy = ", and of wcsim town import, which makes a copy for all others"
    else:
        path_there = named_by.absolute()
        name = re.sub(r"[^A-Za-z0-9_-]", "_", path_there.parent.name)[:64] or "town"
        copy = (
            ", or a copy for all commands: wcsim town import "
            f"--sumocfg {shlex.quote(escape(path_there, 4096))} --name {name} {_ALLOW}"
        )
    raise TownError(
        f"{escape(named_by)}: names {escape(path)}, which is outside of its folder "
        f"{escape(border)}; move it there and correct the name, or permit files elsewhere: "
        f"{_ALLOW} of wcsim town run and pave{copy}"
    )


def check_file(path: Path, border: Path | None, named_by: Path) -> None:
    """Return when a file lies in the folder `border` and is a regular one. Raises TownError."""
    check_inside(path, border, named_by)
    if not is_file(path):
        raise TownError(
            f"{escape(named_by)}: names a file that does not exist: {escape(path)}; "
            f"restore it or correct {escape(named_by.name)}"
        )
    if "," in str(path):
        raise TownError(
            f"{escape(path)}: SUMO splits file names at commas; rename the file or its folder"
        )


def with_included(files: Iterable[Path], border: Path | None) -> tuple[Path, ...]:
    """Additional or route files, each followed by all that it includes, none twice.

    Args:
        files: As a scenario names them, plain or gzip-compressed.
        border: The folder outside of which nothing is opened; None for none.

    Raises:
        TownError: An included file is not there, is no XML, includes itself, or lies outside of the
            border.
    """
    # The key is where a file really lies, for it may have many names.
    found: dict[Path, Path] = {}
    for path in files:
        _follow(path, border, (), found)
    return tuple(found.values())


class OutputNames:
    """The files that a scenario writes into one folder, one for each file of its author."""

    def __init__(self, folder: Path) -> None:
        """Raises TownError for a folder whose name SUMO does not take for one."""
        strange = sorted(set(str(folder)) & set(_SUMO_SPLITS_AT))
        if strange:
            raise TownError(
                f"{folder}: SUMO cannot write to a path with {' '.join(strange)} in it; "
                "choose another"
            )
        self.folder = folder
        self._of_author: dict[str, Path] = {}
        self._taken: set[str] = set()

    @property
    def paths(self) -> tuple[Path, ...]:
        """All of them, sorted."""
        return tuple(sorted(self._of_author.values()))

    def place(self, author: str, base: Path, instead: str) -> Path:
        """Where the file goes that the author named `author` in a file of the folder `base`.

        Args:
            author: As it is written; a path, a socket, or a name for the console.
            base: The folder that relative names are taken from.
            instead: The name to use when the author's has none that can be used.
        """
        key = os.path.normpath(base / author)
        if key not in self._of_author:
            name = _UNSAFE.sub("_", Path(author).name).strip("_.-")[-_MAX_LENGTH:].lstrip("_.-")
            if author in ("stdout", "stderr", "-") or not name:
                name = instead
            self._of_author[key] = self.folder / self.unique(name)
        return self._of_author[key]

    def unique(self, name: str) -> str:
        """The name, with a number in it when it is taken; it is taken from now on."""
        stem, dot, endings = name.partition(".")
        number, found = 1, name
        while found.lower() in self._taken:
            number += 1
            found = f"{stem}-{number}{dot}{endings}"
        self._taken.add(found.lower())
        return found


class FilteredFiles:
    """The files of one scenario on their way into a folder."""

    def __init__(self, folder: Path, border: Path | None) -> None:
        """Begin with none.

        Args:
            folder: For what is written, and a folder in it for files that need changes.
            border: The folder outside of which nothing is opened; None for none.
        """
        self.names = OutputNames(folder)
        """Of what is written."""
        self._copies = OutputNames(folder / self.names.unique(_COPIES))
        self._border = border
        self._done: dict[Path, Path] = {}
        self.read: dict[Path, None] = {}
        """Every file that was met, in that order."""
        self.texts: dict[Path, None] = {}
        """Those among them that are no XML."""
        self.pictures: dict[Path, None] = {}
        """What sumo-gui would show; nothing was looked at."""

    def place(self, path: Path, named_by: Path) -> Path:
        """The file itself when it writes nothing, else the filtered copy of it.

        Raises:
            TownError: it is not there, is no XML, includes itself, or lies outside of the border.
        """
        return self._place(path, named_by, ())

    def place_option(self, option: SumoOption, path: Path, named_by: Path) -> Path:
        """The file, or the filtered copy of it, that an option names to be read.

        Raises TownError as `place` does.
        """
        if option.reads is Content.FOLDER:
            check_inside(path, self._border, named_by)
            return path.absolute()
        place = self.place if option.reads is Content.XML else self.place_text
        return place(path, named_by)

    def place_text(self, path: Path, named_by: Path) -> Path:
        """A file that SUMO reads as something else than XML, where it is.

        Raises:
            TownError: it is not there, is no regular file, is too large, or lies outside of the
                border.
        """
        whole = self._note(path, named_by)
        read_file_size(whole, SCENARIO)
        self.texts[whole] = None
        return whole

    def _place(self, path: Path, named_by: Path, above: tuple[Path, ...]) -> Path:
        whole = self._note(path, named_by)
        below = _below(above, whole, str(named_by))
        if whole not in self._done:
            self._done[whole] = self._filtered(whole, below)
        return self._done[whole]

    def _note(self, path: Path, named_by: Path) -> Path:
        whole = path.absolute()
        check_file(whole, self._border, named_by)
        self.read[whole] = None
        return whole

    def _filtered(self, path: Path, above: tuple[Path, ...]) -> Path:
        # 1. Look through it. Most files name no other one, and are not parsed for that. A large one
        #    is looked through once: it takes a fifth of the time in which a world opens.
        data = read_bytes(path, MAX_XML_BYTES)
        plain = _PLAIN.fullmatch(str(path)) is not None
        if _NamesFiles(escape(path)).finds_none(data) and plain:
            return path

        # 2. Change the names in it.
        root = without_namespaces(parse_root(data, escape(path)))
        changes = [self._change(element, path, above) for element in root.iter()]
        if plain and not any(changes):
            return path

        # 3. Write the copy. What it reads has to be found from another folder too.
        for element in root.iter():
            for key, value in element.attrib.items():
                if value and ((element.tag, key) in _READ or key in _PICTURES):
                    element.set(key, str((path.parent / value).absolute()))
        name = _UNSAFE.sub("_", path.name.removesuffix(".gz"))[-_MAX_LENGTH:].lstrip(".")
        place = self._copies.folder / self._copies.unique(name or "file.xml")
        place.parent.mkdir(parents=True, exist_ok=True)
        ElementTree.ElementTree(root).write(place, encoding="UTF-8", xml_declaration=True)
        return place

    def _change(self, element: Element, path: Path, above: tuple[Path, ...]) -> bool:
        """Lead what an element writes into the folder, and what it reads to filtered files.

        Returns:
            Whether that changed it.
        """
        before = dict(element.attrib)
        for key, value in before.items():
            there = path.parent / value
            if (element.tag, key) in _READ:
                if value and (filtered := self._place(there, path, above)) != there.absolute():
                    element.set(key, str(filtered))
            elif key in _TEXTS:
                element.set(key, str(self.place_text(there, path)))
            elif key in _PICTURES:
                self.pictures[there.absolute()] = None
            elif _WRITTEN.match(key) and value not in NOWHERE:
                element.set(key, str(self.names.place(value, path.parent, f"{element.tag}.xml")))
        if element.tag == "param" and before.get("value"):
            self._change_parameter(element, path, above)
        return before != element.attrib

    def _change_parameter(self, element: Element, path: Path, above: tuple[Path, ...]) -> None:
        """The same for a parameter: one attribute names it, and another one its file."""
        key, value = element.get("key", ""), element.attrib["value"]
        if _writes_parameter(key) and value not in NOWHERE:
            written = self.names.place(value, path.parent, f"{key.strip()}.xml")
            element.set("value", str(written))
        elif _reads_parameter(key):
            named = (path.parent / part.strip() for part in value.split(","))
            read = [str(self._place(there, path, above)) for there in named]
            element.set("value", ",".join(read))


def without_namespaces(root: Element) -> Element:
    """The same tree with the bare names that SUMO uses, without attributes of other namespaces."""
    for element in root.iter():
        # The tag of a comment is no text.
        tag: object = element.tag
        if not isinstance(tag, str):
            continue
        element.tag = tag.rpartition("}")[2]
        for key in [key for key in element.attrib if key.startswith("{")]:
            del element.attrib[key]
    return root


def _follow(
    path: Path, border: Path | None, above: tuple[Path, ...], found: dict[Path, Path]
) -> None:
    real = Path(os.path.realpath(path))
    below = _below(above, real, escape(path))
    if real in found:
        return
    found[real] = path
    for name in _included(path):
        there = path.parent / name
        check_file(there, border, path)
        _follow(there, border, below, found)


def _below(above: tuple[Path, ...], path: Path, where: str) -> tuple[Path, ...]:
    """The files that lead to what a file includes.

    Raises TownError when they lead back to it, or are too many.
    """
    if path in above or len(above) >= MAX_DEPTH:
        chain = " -> ".join(item.name for item in (*above, path))
        raise TownError(f"{where}: its files include each other ({chain}); remove one <include>")
    return (*above, path)


def _included(path: Path) -> list[str]:
    """The names that a file includes; most files have none, and are not parsed for that."""
    data, names = read_bytes(path), list[str]()
    if b"include" not in data:
        return names

    def visit(tag: str, attributes: list[str]) -> None:
        if tag.rpartition(":")[2] == "include":
            names.append(dict(zip(attributes[::2], attributes[1::2], strict=True)).get("href", ""))

    scan(data, escape(path), visit)
    return [name for name in names if name]


class _NamesFiles:
    """Goes through the elements of a file, and knows afterwards whether any names another file."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._plain: set[str] = set()  # keys that were looked at and name no file
        self.found = False

    def finds_none(self, data: bytes) -> bool:
        """Whether a file names no other one, as it is known or by a look through it.

        Raises TownError for names of files that belong in no scenario.
        """
        key = hashlib.sha256(data + _RULES).hexdigest()[:32]
        verdict = find_cache_folder() / f"plain-{key}.ok"
        if verdict.is_file():
            return True
        scan(data, self._where, self)
        if not self.found and len(data) >= _LARGE_BYTES:
            with suppress(DiskFullError):
                write_bytes(verdict, b"ok\n")
        return not self.found

    def __call__(self, tag: str, attributes: list[str]) -> None:
        """Note an element. Raises TownError for names of files that belong in no scenario."""
        if self._plain.issuperset(attributes[::2]):
            return
        odd = [key for key in attributes[::2] if _may_name(key.rpartition(":")[2])]
        self._plain.update(key for key in attributes[::2] if key not in odd)
        if not odd:
            return

        # It has an attribute that names a file, or may do so.
        values = dict(zip(attributes[::2], attributes[1::2], strict=True))
        emission = values.get("emissionClass", "")
        if ".." in emission or emission.startswith("/"):
            raise TownError(
                f"{self._where}: has emissionClass={escape(emission, 60)!r}; "
                "expected a name: correct it"
            )
        projection = values.get("projParameter", "")
        if _GRIDS.search(projection):
            raise TownError(
                f"{self._where}: has projParameter={escape(projection, 60)!r}, "
                "which names a file; expected one without"
            )
        is_parameter = tag.rpartition(":")[2] == "param"
        for key, value in values.items():
            name = key.rpartition(":")[2]
            if name == "key":
                names_file = _writes_parameter(value) or _reads_parameter(value)
                self.found |= is_parameter and names_file
            elif name not in ("emissionClass", "projParameter") and _may_name(name):
                self.found = True


def _may_name(key: str) -> bool:
    special = key in ("key", "href", "emissionClass", "projParameter")
    return special or _WRITTEN.match(key) is not None


def _reads_parameter(key: str) -> bool:
    """Whether the value of a <param> with this key names a file that SUMO reads."""
    return key.strip() in _READ_PARAMETERS


def _writes_parameter(key: str) -> bool:
    """Whether the value of a <param> with this key names a file that SUMO writes."""
    return not _reads_parameter(key) and _WRITTEN_PARAMETER.match(key) is not None
