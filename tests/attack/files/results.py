"""Hostile files of what was measured: results of tests, lists of episodes, tables of studies and of rounds."""

import csv
import io
import json
import os
from functools import partial
from pathlib import Path
from unittest import mock

from tests.attack.files.family import Family, model_twist
from tests.attack.files.files import csv_twist, same
from tests.attack.files.people import STUDY
from tests.attack.scenarios.twists import NASTY, cleared, json_text, toml_text
from tests.view.report.results import write_result
from wcsim.agents.evaluation.suite.result_files import ASKED, EPISODES, RESULT, read_result
from wcsim.agents.opening.list_file import open_suite, write_list
from wcsim.agents.runs.metrics import append_round_metrics, read_round_metrics
from wcsim.config import parse
from wcsim.config.study import StudyFile
from wcsim.core.reading import FileSpec, parse_toml
from wcsim.drive.recording.study_plan import append_row, read_rows, table_columns
from wcsim.view.report.failures import failures_of
from wcsim.view.report.suite_page import write_suite_page

COLUMNS = table_columns(parse(StudyFile, parse_toml(toml_text(STUDY), "a study", FileSpec(what="", limit_bytes=1)), ""))

_ODD = (*NASTY, *("/../../../x", "../../../x", "a/../../../../x") * 4)


def families(work: Path) -> list[Family]:
    """Each file as wcsim writes it, and who reads it: for results, the page too."""
    write_result(work)
    (work / ASKED).write_text(json.dumps({"suite": "dev2", "preset": "quick", "out": "o"}))
    held = {name: (work / name).read_bytes() for name in (RESULT, EPISODES, ASKED)}
    sha256 = json.loads(held[RESULT])["sha256"]
    for row in range(3):
        append_row(work / "t.csv", COLUMNS, {"study_sha256": "ab" * 6, "participant": str(row), "town": "a, b"})
        append_round_metrics(work / "r.csv", (row, 9 * row, 9, 0.5, row, 5, 1, 4, row, 10 * row, 0.25, 1.5, 0.5))
    table, rounds = ((work / name).read_bytes() for name in ("t.csv", "r.csv"))
    episodes = open_suite("guard").file
    write_list(episodes.model_copy(update={"blocks": episodes.blocks[:2]}), work / "l.json")
    listed = (work / "l.json").read_bytes()
    for name in (*held, "t.csv", "r.csv", "l.json"):
        cleared(work / name)
    return [
        *(
            Family(name=name, file=name, sound=data, take=partial(_take_result, sha256),
                   twist=model_twist(json.loads(data), json_text, _ODD),
                   beside=tuple(item for item in held.items() if item[0] != name))
            for name, data in held.items()
        ),
        Family(name="study table", file="t.csv", sound=table, twist=csv_twist(_rows(table)), take=_take_table),
        Family(name="rounds", file="r.csv", sound=rounds, twist=csv_twist(_rows(rounds)), take=_take_rounds),
        Family(name="episode list", file="l.json", sound=listed, twist=model_twist(json.loads(listed), json_text),
               take=lambda path: same(open_suite(str(path)).file)),
    ]  # fmt: skip


def _rows(data: bytes) -> list[list[str]]:
    return list(csv.reader(io.StringIO(data.decode())))


def _take_result(sha256: str, path: Path) -> bool:
    """What was measured is as it was; the page has one script, its own. Figures are left out, which take seconds."""
    result = read_result(path.parent)
    with mock.patch("wcsim.view.report.suite_page.figures_of", lambda *_: ()):
        page = write_suite_page(result, path.parent, failures_of(result, path.parent), {}, "", path.parent)
    as_held = result.to_json()["sha256"] == sha256
    return as_held and page.read_text(encoding="utf-8").count("<script") == 1


def _take_table(path: Path) -> bool:
    """Rows are read again after one more was written."""
    rows = read_rows(path, COLUMNS)
    if not os.path.lexists(path):
        return True
    append_row(path, COLUMNS, {"town": "x"})
    return read_rows(path, COLUMNS)[:-1] == rows


def _take_rounds(path: Path) -> bool:
    """All rows are there after the next round."""
    rows = read_round_metrics(path)
    append_round_metrics(path, (len(rows), 99, 9, 0.5, 0, 1, 0, 1, 0, 10, 0.25, 1.5, 0.5))
    return repr(read_round_metrics(path)[:-1]) == repr(rows)
