"""Change attributes of an XML file and leave every other byte as it is."""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from xml.parsers import expat
from xml.sax.saxutils import escape

from wcsim.errors import TownError

_Edits = Mapping[int, Mapping[str, str]]  # number of the element in the order of the file -> attribute -> value
_TAG = re.compile(rb"""<(?:[^<>"']|"[^"]*"|'[^']*')*>""")
_DECLARED = re.compile(rb"""<\?xml[^>]*?encoding\s*=\s*["']([A-Za-z0-9._-]+)""")


def edited(data: bytes, edits: _Edits, where: str) -> bytes:
    """XML text in which elements have other values of attributes that they have already.

    Args:
        data: The text, as `xmlio.parse_root` accepts it.
        edits: What to change; elements are counted as `Element.iter` gives them.
        where: What messages call the text.

    Raises:
        TownError: an attribute is not there.
    """
    starts: list[int] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda *_: starts.append(parser.CurrentByteIndex)
    parser.Parse(data, True)
    found = _DECLARED.match(data.removeprefix(codecs.BOM_UTF8).lstrip())
    encoding = found[1].decode("ascii") if found else "utf-8"
    parts, done = list[bytes](), 0
    for number in sorted(edits):
        tag = _TAG.match(data, starts[number])
        if tag is None:
            raise TownError(f"{where}: element {number + 1} cannot be changed; write its attributes in quotes")
        parts += [data[done : tag.start()], _changed(tag[0], edits[number], encoding, where)]
        done = tag.end()
    return b"".join((*parts, data[done:]))


def _changed(tag: bytes, values: Mapping[str, str], encoding: str, where: str) -> bytes:
    for name, value in values.items():
        text = escape(value, {'"': "&quot;"}).encode(encoding, "xmlcharrefreplace")
        found = re.search(rb"""\s""" + re.escape(name.encode(encoding)) + rb"""\s*=\s*("[^"]*"|'[^']*')""", tag)
        if found is None:
            raise TownError(f"{where}: attribute {name} cannot be changed; write it as {name}='...'")
        tag = tag[: found.start(1)] + b'"' + text + b'"' + tag[found.end(1) :]
    return tag
