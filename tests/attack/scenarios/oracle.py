"""What SUMO would read and write of a filtered scenario, found out without any of wcsim's own reading.

The reading is as lenient as SUMO's: gzip and zlib by their first bytes, encodings guessed as Xerces does.
"""

import html
import os
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

from tests.towns.scenario.test_options import WRITERS

READ_XML = frozenset(
    ("net-file", "route-files", "additional-files", "weight-files", "load-state", "device.fcd-replay.files")
)
READ_TEXT = frozenset(
    (
        *("fcd-output.filter-edges.input-file", "device.ssm.filter-edges.input-file", "astar.all-distances"),
        *("astar.landmark-distances", "phemlight-path"),
    )
)
NOWHERE = ("NUL", "nul", "/dev/null", "")
_NEVER = ("output-prefix", "save-configuration", "save-template", "save-schema", "remote-port", "gui-settings-file")
_TAG = re.compile(r"<([A-Za-z_][\w:.-]*)((?:[^>\"']|\"[^\"]*\"|'[^']*')*)>", re.DOTALL)
_ATTRIBUTE = re.compile(r"([A-Za-z_][\w:.-]*)[\s\x85\u2028]*=[\s\x85\u2028]*(\"[^\"]*\"|'[^']*')", re.DOTALL)
_SAID = re.compile(r"""<\?xml[^>]*?encoding\s*=\s*["']([\w.-]+)["']""")
_READ = {("include", "href"), ("rerouter", "file"), ("variableSpeedSign", "file"), ("calibrator", "file")}
_WRITTEN_KEYS = ("device.ssm.file", "device.toc.file", "file", "device.rerouting.output")


def escapes(sumocfg: Path, run: Path, theirs: Path) -> Iterator[str]:
    """In words, what the scenario at `sumocfg` would write outside of `run`, or read outside of it and `theirs`."""
    text = sumocfg.read_text(encoding="utf-8")
    saw_safety = False
    for tag, attributes in _elements(text):
        value = attributes.get("value", "")
        saw_safety |= tag == "device.ssm.file"
        if tag in _NEVER:
            yield f"<{tag}> is left in"
        elif tag in WRITERS.split():
            for part in value.split(","):
                yield from _written(unquote(part), run, tag)
        elif tag in READ_XML or tag in READ_TEXT:
            for part in value.split(","):
                yield from _read(Path(unquote(part)), (run, theirs), tag in READ_XML, set())
        elif tag == "save-state.suffix" and "/" in value:
            yield f"states end with {value!r}"
    if not saw_safety:
        yield "safety devices write where they want to"


def _written(name: str, run: Path, by: str) -> Iterator[str]:
    place = os.path.normpath(name)
    if name not in NOWHERE and not (
        name.startswith(f"{run}/") and place == name and ":" not in name and "%" not in name
    ):
        yield f"{by} writes {name[:80]!r}"


def _read(path: Path, inside: tuple[Path, Path], xml: bool, seen: set[Path]) -> Iterator[str]:
    real = Path(os.path.realpath(path))
    if not any(real.is_relative_to(place) for place in inside):
        yield f"{str(path)[:80]!r} is read"
    elif xml and real not in seen:
        seen.add(real)
        if not real.is_file():
            yield f"{str(path)[:80]!r} is read, and is no file"
            return
        yield from _inside(_as_sumo_reads(real.read_bytes()), path, inside, seen)


def _inside(text: str, path: Path, inside: tuple[Path, Path], seen: set[Path]) -> Iterator[str]:
    if "<!DOCTYPE" in text:
        yield f"{path.name} has a document type"
    for tag, attributes in _elements(text):
        for key, value in attributes.items():
            if (tag, key) in _READ:
                if value:
                    yield from _read(path.parent / value, inside, True, seen)
            elif key == "edgesFile":
                yield from _read(path.parent / value, inside, False, seen)
            elif key in ("file", "output", "dest"):
                yield from _written(value, inside[0], f"<{tag} {key}> of {path.name}")
            elif key == "projParameter" and "nadgrids=" in value and "nadgrids=null" not in value:
                yield f"{path.name} has {value[:60]!r}"
        if tag == "param" and attributes.get("key") in _WRITTEN_KEYS:
            yield from _written(attributes.get("value", ""), inside[0], f"{attributes['key']} of {path.name}")
        if tag == "param" and attributes.get("key") == "device.fcd-replay.file" and attributes.get("value"):
            yield from _read(path.parent / attributes["value"], inside, True, seen)


def _elements(text: str) -> Iterator[tuple[str, dict[str, str]]]:
    for tag, rest in _TAG.findall(re.sub(r"<!--.*?-->|<!\[CDATA\[.*?\]\]>", "", text, flags=re.DOTALL)):
        yield tag, {key: html.unescape(value[1:-1]) for key, value in _ATTRIBUTE.findall(rest)}


def _as_sumo_reads(data: bytes) -> str:
    """Text of a file, whatever it is packed and written in."""
    plain = b""
    while data[:2] == b"\x1f\x8b" or data[:2] in (b"\x78\x01", b"\x78\x9c", b"\x78\xda"):
        machine = zlib.decompressobj(47)
        try:
            plain += machine.decompress(data, 1 << 24)
        except zlib.error:
            break
        data = machine.unused_data
    data = plain or data
    for mark, codec in (
        *((b"\xff\xfe\0\0", "utf-32"), (b"\0\0\xfe\xff", "utf-32"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")),
        *((b"<\0\0\0", "utf-32-le"), (b"\0\0\0<", "utf-32-be"), (b"<\0", "utf-16-le"), (b"\0<", "utf-16-be")),
        *((b"\xef\xbb\xbf", "utf-8-sig"), (b"\x4c\x6f\xa7\x94", "cp037"), (b"\x4c", "cp037")),
    ):
        if data.startswith(mark):
            return data.decode(codec, "replace")
    found = _SAID.search(data[:4096].decode("latin-1"))
    try:
        return data.decode(found[1] if found else "utf-8", "replace")
    except LookupError:
        return data.decode("utf-8", "replace")
