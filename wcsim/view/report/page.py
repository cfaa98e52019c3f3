"""The page around exhibits: one file, whose policy for content lets no request leave it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.core.files import write_bytes
from wcsim.view.report.markup import Exhibit, Markup, data_uri, el, joined

PAGE: Final = "report.html"
FIGURES: Final = "report"
_ALLOWED: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
_ASSETS: Final = Path(__file__).parent / "assets"
SIMULATION_ONLY: Final = "SIMULATION ONLY: these figures say nothing about a real street."


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
        el("footer", SIMULATION_ONLY),
        el("script", Markup((_ASSETS / "page.js").read_text(encoding="utf-8"))),
    )
    return f"<!DOCTYPE html>\n{el('html', head, body, lang='en')}\n"


def shown(exhibit: Exhibit, more: object = "") -> Markup:
    """An exhibit with its title, how to read it, and its numbers."""
    csv = el("a", "CSV", href=data_uri("text/csv", exhibit.csv.encode()), download=f"{exhibit.stem}.csv", class_="csv")
    beside = el("span", f" {FIGURES}/{exhibit.stem}.svg", class_="csv") if exhibit.svg else ""
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
        write_bytes(folder / FIGURES / f"{exhibit.stem}.csv", exhibit.csv.encode())
        if exhibit.svg:
            write_bytes(folder / FIGURES / f"{exhibit.stem}.svg", exhibit.svg)
    write_bytes(folder / PAGE, text.encode())
    return folder / PAGE
