"""The page of a test: it parses, asks for nothing from outside, and shows the numbers of result.json."""

import base64
import csv
import dataclasses
import html
import io
import json
import math
import re
import shutil
from html.parser import HTMLParser

import pytest

from tests.view.report.results import POLICIES, SCRIPT, score_anew, with_episodes, write_result
from wcsim.agents.evaluation.suite.result_files import read_result
from wcsim.agents.evaluation.suite.rows import GROUPS
from wcsim.view.report.comparisons import verdict
from wcsim.view.report.failures import Illustration, _SeenMoment, failures_of
from wcsim.view.report.figures import figures_of
from wcsim.view.report.suite_page import write_suite_page

VOID = {"meta", "img", "br", "link", "input"}
PNG = b"a picture"  # nobody looks at it here


class Reader(HTMLParser):
    """Every element with its attributes; refuses what is not closed in its order."""

    def __init__(self, text):
        super().__init__()
        self.found, self.open, self.tables = [], [], []  # the last: seen without a click, and how wide each is
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))
        if tag == "table" and "details" not in self.open:
            self.tables.append([dict(attributes)["id"], 0])
        if tag == "th" and ("scope", "col") in attributes and "details" not in self.open:
            self.tables[-1][1] += 1
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def all(self, tag):
        return [attributes for name, attributes in self.found if name == tag]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("finished")


@pytest.fixture(scope="module")
def said(folder):
    return write_result(folder)


def written(folder):
    """The page of a finished test, with pictures of one failure."""
    result = read_result(folder)
    failures = failures_of(result, folder)
    moment = _SeenMoment(
        before_s=0.5, speed_mps=1.0, asked="+0.00 +1.00", given="+0.00 +0.50", behind_jpg=PNG, seen_png=PNG
    )
    pictures = {("follow", 0, 1): Illustration(seen=(moment,) * 3, street_png=PNG, near=("car 1.0 m",))}
    pictures["follow", 0, 0] = Illustration(missing=f"it went {SCRIPT}")
    return write_suite_page(result, folder, failures, pictures, "", folder)


@pytest.fixture(scope="module")
def text(folder, said):
    path = written(folder)
    assert path == folder / "report.html"
    return path.read_text()


def test_it_parses_and_no_request_leaves_it(text):
    page = Reader(text)
    addresses = [value for _, found in page.found for key, value in found.items() if key in ("src", "href", "action")]
    assert addresses and all(address.startswith(("#", "data:")) for address in addresses)
    assert not re.search(r"https?://|url\(|@import|fetch\(|XMLHttpRequest|import\(", text)
    allowed = next(found["content"] for found in page.all("meta") if "http-equiv" in found)
    assert "default-src 'none'" in allowed and "http" not in allowed
    for found in page.all("img"):
        if found["src"].startswith("data:image/svg"):
            svg = base64.b64decode(found["src"].partition(",")[2]).decode()
            assert not re.search(r'href="(?!#|data:)', svg)


def test_names_of_others_stay_text(text):
    assert "<script>alert" not in text and text.count("&lt;script&gt;alert(1)") > 10
    assert len(Reader(text).all("script")) == 1


def test_every_link_inside_leads_somewhere_and_ids_are_used_once(text):
    page = Reader(text)
    ids = [found["id"] for _, found in page.found if "id" in found]
    assert len(ids) == len(set(ids))
    inside = {found["href"][1:] for found in page.all("a") if found["href"].startswith("#")}
    assert inside <= set(ids)
    assert {f"f-{place}-0-0" for place in (2, 3, 4)} | {"f-0-0-1"} <= inside  # the worst moment of each policy


def test_the_figures_csv_are_there_and_on_the_page(text, folder):
    page = Reader(text)
    links = {found["download"]: found["href"] for found in page.all("a") if "download" in found}
    files = {path.name for path in (folder / "report").glob("*.csv")}
    parts = {"table-all.csv", "table-free.csv", "table-hazard.csv", "comparison.csv", "episodes.csv"}
    drawn = {"help.csv", "town-nowhere.csv", "failures.csv"}
    assert files == set(links) == parts | drawn
    for name, address in links.items():
        assert base64.b64decode(address.partition(",")[2]) == (folder / "report" / name).read_bytes()
    assert {path.stem for path in (folder / "report").glob("*.svg")} >= {"help", "town-nowhere"}


def test_numbers_are_those_of_the_result(text, folder, said):
    for number, columns in enumerate(GROUPS.values()):
        begin = text.index(f'id="table-all-{number}"' if number else 'id="table-all"')
        lines = text[begin : text.index("</table>", begin)].split("<tr>")[2:]
        for row, line in zip(said["pooled"], lines, strict=True):
            shown = re.findall(r'<td[^>]*data-key="([0-9.e-]+)"', line)
            wanted = [row[column.key] for column in columns if isinstance(row[column.key], int | float)]
            assert [float(value) for value in shown] == [pytest.approx(float(value)) for value in wanted]
    rows = list(csv.DictReader(io.StringIO((folder / "report" / "table-all.csv").read_text())))
    assert [row["policy"] for row in rows] == list(POLICIES)
    for row, wanted in zip(rows, said["pooled"], strict=True):
        assert float(row["score"]) == wanted["score"] and float(row["score_ci_low"]) == wanted["score_ci"][0]
    assert float(rows[1]["accel_rms_mps2"]) == pytest.approx(math.sqrt(150 / 594), abs=1e-6)  # 6 times 25, 99 changes
    assert float(rows[1]["stick_travel_per_s"]) == pytest.approx(20.0)  # 30 in 1.5 s


def failure(text, name):
    return text.partition(f'id="{name}"')[2].partition("</details>")[0]


def test_a_failure_has_its_pictures_or_says_why_not(text):
    shown = failure(text, "f-0-0-1")
    assert shown.count("<img") == 7 and "wcsim test follow" in shown
    missing = failure(text, "f-0-0-0")
    assert "No pictures: it went &lt;script&gt;" in missing and "<img" not in missing
    assert "Until 0.9 s before, a held stick would have saved the chair" in text


def test_the_same_result_gives_the_same_bytes(folder, text):
    assert written(folder).read_text() == text


def test_crashes_are_drawn_over_unneeded_help_where_it_was_judged(folder, tmp_path):
    result = read_result(folder)
    (drawn,) = (each for each in figures_of(result, folder) if each.name == "help")
    rows = {row["policy"]: row for row in csv.DictReader(io.StringIO(drawn.csv))}
    assert float(rows["follow"]["crashes"]) == pytest.approx(8 / 12, abs=1e-6)
    assert list(rows) == list(POLICIES) and float(rows["dwa"]["unneeded"]) == 0.0
    blind = {name: [dataclasses.replace(e, judged=False) for e in found] for name, found in result.episodes.items()}
    assert "help" not in {each.name for each in figures_of(with_episodes(result, blind), folder)}


def test_a_town_that_was_made_for_a_list_is_drawn_from_the_results_folder(tmp_path, corner):
    write_result(tmp_path)
    result = read_result(tmp_path)
    (before,) = (each for each in figures_of(result, tmp_path) if each.name == "town-nowhere")
    shutil.copytree(corner, tmp_path / "towns" / "nowhere")
    (after,) = (each for each in figures_of(result, tmp_path) if each.name == "town-nowhere")
    assert "not on this machine" in before.says and "not on this machine" not in after.says
    assert "way,1.0,1.0,0.0" in after.csv, "places come with the second after which they were reached"


def test_one_look_shows_the_sentence_and_one_table_of_seven_columns(text, folder):
    assert Reader(text).tables == [["table-all", 7]] and verdict(read_result(folder)) in html.unescape(text)
    assert "highest" not in text, "what cannot be told apart"


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", ["x " * 1500, "/../../../escaped", "\0", ".."])
def test_files_of_a_town_or_part_of_any_name_lie_in_the_folder(tmp_path, name):
    folder = tmp_path / "a" / "result"
    write_result(folder)
    for file, old in (("episodes.json", "nowhere"), ("episodes.json", "hazard")):
        text = (folder / file).read_text().replace(json.dumps(old), json.dumps(name))
        (folder / file).write_text(text)
    score_anew(folder)
    result = read_result(folder)
    write_suite_page(result, folder, failures_of(result, folder), {}, "", folder)
    outside = [path for path in tmp_path.rglob("*") if path.is_file() and folder not in path.parents]
    assert outside == [] and any(path.name.startswith("table-") for path in (folder / "report").iterdir())
