"""Text of others never becomes markup, and what a template needs is there."""

import jinja2
import pytest

from wcsim.view.report.pages import TEMPLATES, Exhibit, page

EVIL = '"><script>alert(1)</script>'


def exhibit(**changes):
    return Exhibit(
        **{"name": "x", "title": EVIL, "says": EVIL, "columns": (EVIL, "b"), "rows": [(EVIL, None)], **changes}
    )


def written(*exhibits):
    about = {"clients": [EVIL], "manifests": {EVIL: {"town": EVIL, "status": EVIL}}, "by_rounds": ()}
    limits = {"limit": 0.1, "mean_steps": 2000, "over": 20}
    return page("training.jinja", title=EVIL, policies=EVIL, sections=[("s", EVIL, exhibits)], **about, **limits)


def test_what_is_no_markup_is_escaped_in_elements_attributes_and_cells():
    text = written(exhibit(svg=b"<svg/>"), exhibit())
    assert "<script>alert" not in text and text.count("&lt;script&gt;alert") == 16 and "<td>–</td>" in text
    cell = str(TEMPLATES.get_template("parts.jinja").module.cell(EVIL, EVIL, EVIL))
    assert "<script" not in cell and '<td data-key="&#34;&gt;&lt;script' in cell
    demo = {**dict.fromkeys(("learned", "film_says", "verdict"), EVIL), "film_webm": b"", "commands": [(EVIL, EVIL)]}
    result = {"episodes": {EVIL: [EVIL]}, "set": "demo"}
    said = page("demo.jinja", title=EVIL, result=result, rows=(), look=(), key=(EVIL, 0), trained=[EVIL], **demo)
    assert "<script>alert" not in said


def test_what_a_template_does_not_get_is_no_silent_gap():
    with pytest.raises(jinja2.UndefinedError, match="over"):
        page("training.jinja", title="", sections=[])


def test_csv_keeps_commas_quotes_and_nothing():
    rows = [('x, "y"', None), (1, 0.5)]
    assert exhibit(columns=("a", "b"), rows=rows).csv == 'a,b\n"x, ""y""",\n1,0.5\n'
