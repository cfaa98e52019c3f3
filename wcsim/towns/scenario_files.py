"""Files of a scenario that name other files: what they write is led into one folder, what they read stays theirs.

A file that writes nothing is left where it is; only one that does is copied, with nothing but those names changed.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from wcsim.errors import TownError
from wcsim.towns.scenario_names import NOWHERE, OutputNames
from wcsim.towns.xmlio import MAX_XML_BYTES, is_there, parse_root, read_bytes, shown

MAX_DEPTH = 16
_READ = {("rerouter", "file"), ("variableSpeedSign", "file"), ("calibrator", "file"), ("include", "href")}
_READ_ATTRIBUTES = ("imgFile", "osgFile", "href")
_READ_PARAMETERS = ("device.fcd-replay.file", "device.fcd-replay.files")
_WRITTEN = re.compile(r"(?i)^(dest|.*((?<!pro)file|output))$")
_HINT = re.compile(
    rb"""<(\w+:)?include\b|\s(dest|[\w:.-]*((?<![pP]ro)[fF]ile|[oO]utput))\s*="""
    rb"""|\bkey\s*=\s*["'][^"']*([fF]iles?|[oO]utput)["']|&\#|<!DOCTYPE"""
)
_ENCODING = re.compile(rb"""^[^>]{0,200}encoding\s*=\s*["'](?!utf-8|us-ascii|iso-8859)""", re.IGNORECASE)


class FilteredFiles:
    """The files of one scenario on their way into a folder."""

    def __init__(self, names: OutputNames, copies: Path) -> None:
        """`names` for what is written; `copies` is the folder for files that need changes."""
        self._names = names
        self._copies = OutputNames(copies)
        self._done: dict[Path, Path] = {}
        self.read: dict[Path, None] = {}
        """Every file that was met, in that order."""

    def place(self, path: Path, named_by: Path) -> Path:
        """The file itself when it writes nothing, else the filtered copy of it.

        Raises:
            TownError: it is not there, is no XML, or includes itself.
        """
        return self._place(path, named_by, ())

    def _place(self, path: Path, named_by: Path, above: tuple[Path, ...]) -> Path:
        whole = self._note(path, named_by)
        if whole in above or len(above) >= MAX_DEPTH:
            chain = " -> ".join(item.name for item in (*above, whole))
            raise TownError(f"{named_by}: its files include each other ({chain}); remove one <include>")
        if whole not in self._done:
            self._done[whole] = self._filtered(whole, (*above, whole))
        return self._done[whole]

    def _note(self, path: Path, named_by: Path) -> Path:
        whole = path.absolute()
        if not is_there(whole):
            raise TownError(
                f"{named_by}: names a file that is not there: {shown(whole)}; restore it or correct {named_by.name}"
            )
        if "," in str(whole):
            raise TownError(f"{whole}: SUMO splits file names at commas; rename the file or its folder")
        self.read[whole] = None
        return whole

    def _filtered(self, path: Path, above: tuple[Path, ...]) -> Path:
        data = read_bytes(path, MAX_XML_BYTES)
        if not names_files(data):
            return path
        root = without_namespaces(parse_root(data, str(path)))
        changes = [self._change(element, path, above) for element in root.iter()]
        if not any(changes):
            return path
        for element in root.iter():
            self._make_absolute(element, path)
        return self._copy(path, root)

    def _change(self, element: Element, path: Path, above: tuple[Path, ...]) -> bool:
        """Lead what an element writes into the folder, and what it reads to filtered files; True if that changed it."""
        before = dict(element.attrib)
        for key, value in before.items():
            if reads(element.tag, key):
                if (element.tag, key) in _READ and value not in NOWHERE:
                    there = path.parent / value
                    filtered = self._place(there, path, above)
                    if filtered != there.absolute():
                        element.set(key, str(filtered))
                elif is_there(path.parent / value):  # a picture, which SUMO itself never opens
                    self.read[(path.parent / value).absolute()] = None
            elif _WRITTEN.match(key) and value not in NOWHERE:
                element.set(key, str(self._names.place(value, path.parent, f"{element.tag}.xml")))
        if (
            element.tag == "param"
            and writes_parameter(before.get("key", ""))
            and before.get("value", "") not in NOWHERE
        ):
            place = self._names.place(before["value"], path.parent, f"{before['key']}.xml")
            element.set("value", str(place))
        return before != element.attrib

    def _make_absolute(self, element: Element, path: Path) -> None:
        for key, value in element.attrib.items():
            if reads(element.tag, key) and value not in NOWHERE:
                element.set(key, str((path.parent / value).absolute()))
        if element.tag == "param" and element.get("key") in _READ_PARAMETERS:
            element.set("value", str((path.parent / element.get("value", "")).absolute()))

    def _copy(self, path: Path, root: Element) -> Path:
        name = re.sub(r"[^A-Za-z0-9_.-]+", "_", path.name.removesuffix(".gz")).lstrip(".") or "file.xml"
        place = self._copies.folder / self._copies.unique(name)
        place.parent.mkdir(parents=True, exist_ok=True)
        ElementTree.ElementTree(root).write(place, encoding="UTF-8", xml_declaration=True)
        return place


def without_namespaces(root: Element) -> Element:
    """The same tree with the bare names that SUMO goes by; attributes of other namespaces are left out."""
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
        for key in [key for key in element.attrib if key.startswith("{")]:
            del element.attrib[key]
    return root


def names_files(data: bytes) -> bool:
    """Whether XML text may name a file anywhere, as far as its bytes tell; encodings that hide them count as yes."""
    head = data[:4]
    if head[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in head or _ENCODING.match(data[:400]):
        return True
    return _HINT.search(data) is not None


def reads(tag: str, key: str) -> bool:
    """Whether SUMO reads the file that this attribute names."""
    return (tag, key) in _READ or key in _READ_ATTRIBUTES


def writes_parameter(key: str) -> bool:
    """Whether the value of a <param> with this key names a file that SUMO writes."""
    last = re.split(r"[.-]", key)[-1].lower()
    return key not in _READ_PARAMETERS and last in ("file", "files", "output")
