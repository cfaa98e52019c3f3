"""HTML put together so that no text of others becomes markup, and numbers as CSV."""

from __future__ import annotations

import base64
import csv
import html
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

_VOID: Final = frozenset({"meta", "img", "br", "link", "input"})
_MOST_STEM: Final = 80
Cell = str | int | float | None


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Exhibit:
    """Something that is shown, and the numbers that it is made of."""

    name: str
    title: str
    says: str  # how to read it
    body: Markup
    csv: str
    svg: bytes = b""  # of a figure

    @property
    def stem(self) -> str:
        """The name of its files, which lead out of no folder, whatever others call a town or a part."""
        return re.sub(r"[^A-Za-z0-9_-]+", "-", self.name)[:_MOST_STEM]


def el(tag: str, *inside: object, **attributes: object) -> Markup:
    """An element; what is inside and is no Markup is escaped, so are attributes.

    A trailing _ of an attribute's name is dropped, other _ become -; None leaves it out, True gives it without a value.

    >>> el("p", "a < b", class_="x")
    '<p class="x">a &lt; b</p>'
    """
    told = "".join(
        f" {name.rstrip('_').replace('_', '-')}" + ("" if value is True else f'="{html.escape(str(value))}"')
        for name, value in attributes.items()
        if value is not None
    )
    if tag in _VOID:
        return Markup(f"<{tag}{told}>")
    return Markup(f"<{tag}{told}>{joined(inside)}</{tag}>")


def joined(items: Iterable[object]) -> Markup:
    """Several pieces after each other; what is no Markup is escaped."""
    return Markup("".join(item if isinstance(item, Markup) else html.escape(str(item)) for item in items))


def csv_of(columns: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """Rows as CSV; None is empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(["" if cell is None else cell for cell in row] for row in rows)
    return out.getvalue()


def data_uri(kind: str, data: bytes) -> str:
    """Data as an address that holds it."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def table(headings: Sequence[object], rows: Iterable[Sequence[object]], name: str = "") -> Markup:
    """A table that a reader can sort; a cell may be a pair of what is shown and what it is sorted by."""
    head = el("thead", el("tr", *(el("th", heading, scope="col") for heading in headings)))
    body = el("tbody", *(el("tr", *(_cell(cell, place) for place, cell in enumerate(row))) for row in rows))
    return el("div", el("table", head, body, class_="sortable", id=name or None), class_="wide", tabindex="0")


def _cell(cell: object, place: int) -> Markup:
    shown, key = cell if isinstance(cell, tuple) else (cell, None)
    return el("th" if place == 0 else "td", shown, data_key=key, scope="row" if place == 0 else None)
