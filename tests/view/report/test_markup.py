"""Text of others never becomes markup."""

from wcsim.view.report.markup import Markup, csv_of, el, table


def test_what_is_no_markup_is_escaped_in_elements_attributes_and_cells():
    evil = '"><script>alert(1)</script>'
    for made in (el("p", evil), el("p", "x", title=evil), table(("a",), [(evil,), ((evil, evil),)])):
        assert "<script" not in made and "&lt;script" in made
    assert el("p", el("b", "x"), Markup("<i>y</i>")) == "<p><b>x</b><i>y</i></p>"
    assert el("a", "x", class_="k", data_key=0, hidden=None, open=True) == '<a class="k" data-key="0" open>x</a>'


def test_csv_keeps_commas_quotes_and_nothing():
    assert csv_of(("a", "b"), [('x, "y"', None), (1, 0.5)]) == 'a,b\n"x, ""y""",\n1,0.5\n'
