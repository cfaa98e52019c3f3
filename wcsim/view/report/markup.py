"""A page of HTML: its elements, in which all text is escaped, tables with their numbers as CSV, and its files."""

from __future__ import annotations

import base64
import csv
import html
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.core.files import write_bytes

_VOID: Final = frozenset({"meta", "img", "br", "link", "input"})
_MOST_STEM: Final = 80
Cell = str | int | float | None
PAGE: Final = "report.html"
_FIGURES: Final = "report"
_ALLOWED: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
_ASSETS: Final = Path(__file__).parent / "assets"
_SIMULATION_ONLY: Final = "SIMULATION ONLY: these figures say nothing about a real street."


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of the page."""

    name: str  # its anchor
    title: str
    body: Markup


def page(title: str, intro: Markup, sections: Sequence[Section]) -> str:
    """The whole file."""
    links = (el("a", section.title, href=f"#{section.name}") for section in sections)
    head = el(
        "head",
        el("meta", charset="utf-8"),
        el("meta", name="viewport", content="width=device-width, initial-scale=1"),
        el("meta", http_equiv="Content-Security-Policy", content=_ALLOWED),
        el("title", title),
        el("style", Markup((_ASSETS / "page.css").read_text(encoding="utf-8"))),
    )
    body = el(
        "body",
        el("header", el("h1", title), intro, el("nav", *links)),
        el("main", *(el("section", el("h2", each.title), each.body, id=each.name) for each in sections)),
        el("footer", _SIMULATION_ONLY),
        el("script", Markup((_ASSETS / "page.js").read_text(encoding="utf-8"))),
    )
    return f"<!DOCTYPE html>\n{el('html', head, body, lang='en')}\n"


def shown(exhibit: Exhibit, more: object = "") -> Markup:
    """An exhibit with its title, how to read it, and its numbers."""
    csv = el("a", "CSV", href=data_uri("text/csv", exhibit.csv.encode()), download=f"{exhibit.stem}.csv", class_="csv")
    beside = el("span", f" {_FIGURES}/{exhibit.stem}.svg", class_="csv") if exhibit.svg else ""
    return el(
        "div",
        el("h3", exhibit.title),
        exhibit.body,
        el("p", exhibit.says, " ", csv, beside, class_="says"),
        more,
        class_="exhibit drawn" if exhibit.svg else "exhibit",
        id=f"x-{exhibit.name}",
    )


def facts(pairs: Iterable[tuple[str, object]]) -> Markup:
    """What was done, in pairs of a word and what it is."""
    return el("dl", *(joined((el("dt", word), el("dd", said))) for word, said in pairs), class_="facts")


def write_page(folder: Path, text: str, exhibits: Iterable[Exhibit]) -> Path:
    """Write the page, and its figures and numbers beside it. Raises DiskFullError."""
    for exhibit in exhibits:
        write_bytes(folder / _FIGURES / f"{exhibit.stem}.csv", exhibit.csv.encode())
        if exhibit.svg:
            write_bytes(folder / _FIGURES / f"{exhibit.stem}.svg", exhibit.svg)
    write_bytes(folder / PAGE, text.encode())
    return folder / PAGE
