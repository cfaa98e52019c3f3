"""What the elements of SUMO's files say of other files: which attribute names one, to be read or to be written."""

from __future__ import annotations

import re

from wcsim.core.reading import shown
from wcsim.errors import TownError

_READ = {("rerouter", "file"), ("variableSpeedSign", "file"), ("calibrator", "file"), ("include", "href")}
_TEXTS = ("edgesFile",)  # not XML: a line for each edge
_PICTURES = ("imgFile", "osgFile", "href")
_READ_PARAMETERS = ("device.fcd-replay.file", "device.fcd-replay.files")
_WRITTEN = re.compile(r"(?i)^(dest|.*((?<!pro)file|output))$")
_WRITTEN_PARAMETER = re.compile(r"(?i)^(.*[.-])?\s*\w*((?<!pro)files?|output)\s*$")
_GRIDS = re.compile(r"((?i:grids|catalog|init|file)\s*=)(?!\s*(@?null|epsg:\d+)(\s|$))")


class NamesFiles:
    """Goes through the elements of a file and says afterwards whether any of them names another file."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._plain: set[str] = set()  # keys that were looked at and name no file
        self.found = False

    def __call__(self, tag: str, attributes: list[str]) -> None:
        """Note an element. Raises TownError for names of files that belong in no scenario."""
        if self._plain.issuperset(attributes[::2]):
            return
        odd = [key for key in attributes[::2] if _may_name(key.rpartition(":")[2])]
        self._plain.update(key for key in attributes[::2] if key not in odd)
        if odd:
            self._note(tag.rpartition(":")[2], dict(zip(attributes[::2], attributes[1::2], strict=True)))

    def _note(self, tag: str, attributes: dict[str, str]) -> None:
        """An element with an attribute that names a file, or may do so."""
        emission, projection = attributes.get("emissionClass", ""), attributes.get("projParameter", "")
        if ".." in emission or emission.startswith("/"):
            raise TownError(f"{self._where}: has emissionClass={shown(emission, 60)!r}; expected a name: correct it")
        if _GRIDS.search(projection):
            told = shown(projection, 60)
            raise TownError(f"{self._where}: has projParameter={told!r}, which names a file; expected one without")
        for key, value in attributes.items():
            name = key.rpartition(":")[2]
            if name == "key":
                self.found |= tag == "param" and (writes_parameter(value) or reads_parameter(value))
            elif name not in ("emissionClass", "projParameter") and _may_name(name):
                self.found = True


def _may_name(key: str) -> bool:
    return key in ("key", "href", "emissionClass", "projParameter") or _WRITTEN.match(key) is not None


def reads(tag: str, key: str) -> bool:
    """Whether SUMO reads the file that this attribute names, as XML."""
    return (tag, key) in _READ


def reads_text(key: str) -> bool:
    """Whether SUMO reads the file that this attribute names, and it is no XML."""
    return key in _TEXTS


def shows(key: str) -> bool:
    """Whether sumo-gui shows the picture that this attribute names, which SUMO itself never opens."""
    return key in _PICTURES


def writes(key: str) -> bool:
    """Whether SUMO writes the file that this attribute names, when it does not read it."""
    return _WRITTEN.match(key) is not None


def reads_parameter(key: str) -> bool:
    """Whether the value of a <param> with this key names a file that SUMO reads."""
    return key.strip() in _READ_PARAMETERS


def writes_parameter(key: str) -> bool:
    """Whether the value of a <param> with this key names a file that SUMO writes."""
    return not reads_parameter(key) and _WRITTEN_PARAMETER.match(key) is not None
