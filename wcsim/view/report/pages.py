"""Pages of HTML by templates that escape all text, what they show with its numbers as CSV, and their files."""

from __future__ import annotations

import base64
import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import jinja2

from wcsim.core.files import write_bytes
from wcsim.core.reading import counted

_MOST_STEM: Final = 80
Cell = str | int | float | None
PAGE: Final = "report.html"
_FIGURES: Final = "report"


class Figure(NamedTuple):
    """A cell of a table that shows something else than it is sorted by."""

    text: str
    key: Cell
    below: str = ""  # in small letters


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownTable:
    """A table that a reader can sort; a heading is a text, or something with a `heading` and what it `says`."""

    name: str = ""  # its anchor
    headings: Sequence[object]
    rows: Sequence[Sequence[Cell | Figure]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Exhibit:
    """Something that is shown, and the numbers that it is made of."""

    name: str
    title: str
    says: str  # how to read it
    columns: Sequence[str]  # of the numbers
    rows: Sequence[Sequence[Cell]]
    tables: Sequence[ShownTable] = ()  # that are shown instead of the numbers
    svg: bytes = b""  # of a figure, which is shown instead of them

    @property
    def stem(self) -> str:
        """The name of its files, which lead out of no folder, whatever others call a town or a part."""
        return re.sub(r"[^A-Za-z0-9_-]+", "-", self.name)[:_MOST_STEM]

    @property
    def csv(self) -> str:
        """Its numbers; None is empty."""
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([self.columns, *self.rows])
        return out.getvalue()


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of a page."""

    name: str  # its anchor
    title: str
    exhibits: Sequence[Exhibit]


def _data_uri(data: bytes, kind: str) -> str:
    """Data as an address that holds it."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def page(template: str, **shown: object) -> str:
    """The whole file, by one of the templates."""
    places = jinja2.FileSystemLoader([Path(__file__).parent / name for name in ("templates", "assets")])
    templates = jinja2.Environment(
        loader=places, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    templates.filters["data_uri"] = _data_uri
    templates.globals["counted"] = counted
    return templates.get_template(template).render(shown)


def write_page(folder: Path, text: str, exhibits: Sequence[Exhibit]) -> Path:
    """Write the page, and its figures and numbers beside it. Raises DiskFullError."""
    for exhibit in exhibits:
        write_bytes(folder / _FIGURES / f"{exhibit.stem}.csv", exhibit.csv.encode())
        if exhibit.svg:
            write_bytes(folder / _FIGURES / f"{exhibit.stem}.svg", exhibit.svg)
    write_bytes(folder / PAGE, text.encode())
    return folder / PAGE
