"""Pages of HTML by templates that escape all text, their exhibits as CSV, and their files."""

import base64
import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import jinja2

from wcsim.core.files import write_bytes
from wcsim.core.reading import pluralize

_MOST_STEM: Final = 80
Cell = str | int | float | None
PAGE: Final = "report.html"
_FIGURES: Final = "report"


@dataclass(frozen=True, slots=True, kw_only=True)
class Exhibit:
    """Numbers that a page shows, in a table or drawn. Words for all pages are in templates."""

    name: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    svg: bytes = b""  # of a figure, which is shown instead of the numbers
    title: str = ""  # of those whose title follows from the data, as the next
    says: str = ""

    @property
    def stem(self) -> str:
        """The name of its files. It leads out of no folder, whatever a town or part is called."""
        return re.sub(r"[^A-Za-z0-9_-]+", "-", self.name)[:_MOST_STEM]

    @property
    def csv(self) -> str:
        """Its numbers; None is empty."""
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([self.columns, *self.rows])
        return out.getvalue()


def _data_uri(data: bytes, kind: str) -> str:
    """Data as an address that holds it."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


TEMPLATES: Final = jinja2.Environment(
    loader=jinja2.FileSystemLoader(
        [Path(__file__).parent / name for name in ("templates", "assets")]
    ),
    autoescape=jinja2.select_autoescape(disabled_extensions=("txt.jinja",), default=True),
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
TEMPLATES.filters["data_uri"] = _data_uri
TEMPLATES.globals["counted"] = pluralize


def page(template: str, **shown: object) -> str:
    """The whole text, by one of the templates; those of a .txt.jinja escape nothing."""
    return TEMPLATES.get_template(template).render(shown)


def write_page(folder: Path, text: str, exhibits: Sequence[Exhibit], name: str = PAGE) -> Path:
    """Write the page, and its figures and numbers beside it. Raises DiskFullError."""
    for exhibit in exhibits:
        write_bytes(folder / _FIGURES / f"{exhibit.stem}.csv", exhibit.csv.encode())
        if exhibit.svg:
            write_bytes(folder / _FIGURES / f"{exhibit.stem}.svg", exhibit.svg)
    write_bytes(folder / name, text.encode())
    return folder / name
