"""SUMO's own options, and what a .sumocfg sets of them, whichever way it spells them."""

import functools
import math
import os
import re
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

from wcsim.core.own_folder import create_temporary_folder
from wcsim.errors import SumoError, TownError
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.sumo.xml_io import read_head, read_root, without_comments

_MAX_CFG_BYTES = 1 << 20
_HEAD_BYTES = 1 << 14
_NET = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:<\?[^<>]*>\s*)?<net[\s>]")
_LIMITS = Limits(wall_s=30.0, cpu_s=20, memory_bytes=4 << 30, file_bytes=1 << 24)
_DROPPED_TOPICS = ("configuration", "gui_only", "traci_server")
_DROPPED = ("output-prefix", "output-suffix", "verbose", "print-options", "help", "version")
_INPUTS = (
    "astar.all-distances",
    "astar.landmark-distances",
    "phemlight-path",
    "device.fcd-replay.files",
)
_WRITES = re.compile(r"[.-](file|files|output|log)$|^log$")
_TEXTS = tuple(name for name in _INPUTS if name.startswith("astar."))
_FOLDERS = ("phemlight-path",)
_NAME_PARTS = ("save-state.suffix",)  # a part of the names of files
_EXPECTED = {
    "BOOL": "true or false",
    "TIME": "a time",
    "FLOAT": "a number",
    "INT": "a whole number",
    "STR": "letters, digits, . _ -",
}
_BOOLS = ("1", "yes", "true", "on", "x", "t", "0", "no", "false", "off", "-", "f")
_VARIABLE = re.compile(r"\$\{([^${}]*)\}")


class Content(Enum):
    """What lies where an option names something to be read."""

    XML = "xml"
    TEXT = "text"
    FOLDER = "folder"


class Treatment(Enum):
    """What becomes of an option of an author's configuration."""

    KEEP = "keep"
    INPUT = "input"  # names files that SUMO reads
    OUTPUT = "output"  # names files that SUMO writes
    DROP = "drop"


@dataclass(frozen=True, slots=True, kw_only=True)
class SumoOption:
    """An option as SUMO itself lists it."""

    name: str
    topic: str
    kind: str  # FILE, STR, STR[], INT, FLOAT, BOOL, TIME
    default: str = ""

    @property
    def treatment(self) -> Treatment:
        """What may be done with it: what could write a file is output, unless known to read one."""
        if self.topic in _DROPPED_TOPICS or self.name in _DROPPED:
            return Treatment.DROP
        if self.kind != "FILE" and not (self.kind == "STR" and _WRITES.search(self.name)):
            return Treatment.KEEP
        reads = self.topic == "input" or self.name.endswith("input-file") or self.name in _INPUTS
        return Treatment.INPUT if reads else Treatment.OUTPUT

    @property
    def reads(self) -> Content:
        """What an INPUT names; whatever is not known to be something else must be XML."""
        if self.name in _FOLDERS:
            return Content.FOLDER
        is_text = self.name in _TEXTS or self.name.endswith("input-file")
        return Content.TEXT if is_text else Content.XML


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenOption:
    """An option and the value that a configuration gives it."""

    option: SumoOption
    value: str

    def files(self, folder: Path) -> tuple[Path, ...]:
        """The value as file names, those that are relative taken from `folder`, as SUMO does it."""
        parts = [
            unquote(_VARIABLE.sub(lambda found: os.environ.get(found[1], ""), part.strip()))
            for part in self.value.split(",")
        ]
        return tuple(folder / part for part in parts if part)


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """What a .sumocfg says."""

    path: Path
    given: tuple[GivenOption, ...]

    def value(self, name: str) -> str | None:
        """The value that the author gave an option, None when it is not mentioned."""
        return next((item.value for item in self.given if item.option.name == name), None)

    def number(self, name: str, otherwise: float) -> float:
        """The number of an option; `otherwise` where its value is none, which SUMO refuses."""
        try:
            return float(self.value(name) or otherwise)
        except ValueError:
            return otherwise

    @property
    def scale(self) -> float:
        """The author's own factor of the demand."""
        return self.number("scale", 1.0)

    def seconds(self, name: str, otherwise: str) -> float:
        """A time of SUMO's, in seconds or as [[days:]hours:]minutes:seconds. Raises TownError.

        >>> times = SumoOption(name="begin", topic="time", kind="TIME")
        >>> given = (GivenOption(option=times, value="1:00:30"),)
        >>> Configuration(path=Path("x"), given=given).seconds("begin", "0")
        3630.0
        """
        text = self.value(name) or otherwise
        try:
            parts = [float(part) for part in reversed(text.split(":"))]
        except ValueError:
            raise TownError(
                f"{self.path}: {text!r} is not a time; expected seconds or hours:minutes:seconds"
            ) from None
        return sum(part * share for part, share in zip(parts, (1, 60, 3600, 86400), strict=False))

    def files(self, name: str) -> tuple[Path, ...]:
        """The files that an option names."""
        found = (item.files(self.path.parent) for item in self.given if item.option.name == name)
        return next(found, ())


@functools.cache
def sumo_options() -> dict[str, SumoOption]:
    """Every option of this SUMO by each of its spellings, from the template that SUMO writes.

    Raises:
        SumoError: SUMO cannot be run.
    """
    with create_temporary_folder() as folder:
        run = run_tool("sumo", ["--save-template", "options.xml"], folder, _LIMITS)
        if run.returncode:
            raise SumoError(
                f"SUMO did not list its options: {run.reason()}; "
                "install the eclipse-sumo wheel again"
            )
        root = ElementTree.parse(folder / "options.xml").getroot()  # noqa: S314 - SUMO wrote it
    found: dict[str, SumoOption] = {}
    for topic in root:
        for element in topic:
            option = SumoOption(
                name=element.tag,
                topic=topic.tag,
                kind=element.get("type", "STR"),
                default=element.get("value", ""),
            )
            for spelling in (element.tag, *element.get("synonymes", "").split()):
                found[spelling] = option
    return found


def read_configuration(sumocfg: Path) -> Configuration:
    """What a .sumocfg sets, read as SUMO reads it: at any depth and by any spelling.

    Raises:
        TownError: it is no configuration, or it names an option that SUMO does not have.
    """
    if _NET.match(without_comments(read_head(sumocfg, _HEAD_BYTES))):
        raise TownError(f"{sumocfg}: is a net; give the .sumocfg that names it beside its demand")
    root = read_root(sumocfg, _MAX_CFG_BYTES)
    known = sumo_options()
    given: dict[str, GivenOption] = {}
    for element in root.iter():
        # A value is an attribute, or the text of an element without any other one in it.
        text = (element.text or "").strip() if not len(element) else ""
        value = element.get("value", element.get("v", text or None))
        if element is root or value is None:
            continue
        value = value.strip()
        option = known.get(element.tag)
        if option is None:
            raise TownError(
                f"{sumocfg}: SUMO has no option <{element.tag}>; correct its name or remove it"
            )
        if option.name in given:
            raise TownError(
                f"{sumocfg}: sets <{option.name}> twice; SUMO takes it once: join the values"
            )
        if value and not _fits(option, value):
            raise TownError(
                f"{sumocfg}: <{option.name}> is {value[:40]!r}; expected {_EXPECTED[option.kind]}"
            )
        given[option.name] = GivenOption(option=option, value=value)
    return Configuration(path=sumocfg, given=tuple(given.values()))


def _fits(option: SumoOption, value: str) -> bool:
    """Whether a value is of its option's kind: SUMO ignores others, with hardly a message."""
    kind = option.kind
    if option.name in _NAME_PARTS:
        return re.fullmatch(r"[A-Za-z0-9_.-]+", value) is not None
    if "${" in value or kind not in ("BOOL", "TIME", "FLOAT", "INT"):
        return True
    if kind == "BOOL":
        return value.lower() in _BOOLS
    if kind == "TIME":
        return re.fullmatch(r"-?[0-9.:eE+-]+[dhms]*", value) is not None
    try:
        return math.isfinite(float(value) if kind == "FLOAT" else int(value))
    except ValueError:
        return False
