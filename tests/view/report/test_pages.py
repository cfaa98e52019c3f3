"""Text of others never becomes markup, and what a template needs is there."""

import jinja2
import pytest

from wcsim.view.report.pages import Exhibit, Figure, Section, ShownTable, page

EVIL = '"><script>alert(1)</script>'


def exhibit(**changes):
    return Exhibit(
        **{"name": "x", "title": EVIL, "says": EVIL, "columns": (EVIL, "b"), "rows": [(EVIL, None)], **changes}
    )


def written(*exhibits):
    sections = [Section(name="s", title=EVIL, exhibits=exhibits)]
    return page("training.jinja", title=EVIL, about=[(EVIL, EVIL)], policies=EVIL, sections=sections)


def test_what_is_no_markup_is_escaped_in_elements_attributes_and_cells():
    cells = ShownTable(headings=[EVIL, "b"], rows=[(EVIL, Figure(EVIL, EVIL, EVIL))])
    text = written(exhibit(), exhibit(tables=[cells]), exhibit(svg=b"<svg/>"))
    assert "<script>alert" not in text and text.count("&lt;script&gt;alert") == 18
    assert '<td data-key="&#34;&gt;&lt;script' in text and "<td>–</td>" in text
    demo = {**dict.fromkeys(("learned", "film", "film_says"), EVIL), "still_png": b"", "commands": [(EVIL, EVIL)]}
    assert "<script>alert" not in page("demo.jinja", title=EVIL, tables=[], **demo)


def test_what_a_template_does_not_get_is_no_silent_gap():
    with pytest.raises(jinja2.UndefinedError, match="policies"):
        page("training.jinja", title="", about=[], sections=[])


def test_csv_keeps_commas_quotes_and_nothing():
    rows = [('x, "y"', None), (1, 0.5)]
    assert exhibit(columns=("a", "b"), rows=rows).csv == 'a,b\n"x, ""y""",\n1,0.5\n'
