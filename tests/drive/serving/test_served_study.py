"""`wcsim drive --study`: a page without a browser goes through a block of it."""

import signal
from pathlib import Path
from typing import Any

import pytest

from tests.drive.recording.studies import STUDY, write_study
from tests.drive.serving.served import FakePage, served
from wcsim.cli.main import main
from wcsim.drive.recording.study_lead import _participant_rows, open_study

pytestmark = pytest.mark.timeout(900)
WITHOUT = STUDY[STUDY.index("[practice]") : STUDY.index("[[blocks]]")]
SECOND = STUDY[STUDY.index('[[blocks]]\nname = "more"') : STUDY.index("[[questions]]")]
SHORT = STUDY.replace(WITHOUT, "").replace(SECOND, "")


def step(page: FakePage, kind: str) -> dict[str, Any]:
    """The view of the next step of this kind whose button may be pressed."""
    told = page.until(
        lambda message: message["say"] == "study" and message["view"]["kind"] == kind and message["view"]["ready"]
    )
    view: dict[str, Any] = told["view"]
    return view


def test_a_page_goes_through_a_study_and_nobody_changes_what_it_sets(corner: Path, tmp_path: Path) -> None:
    path, out = write_study(tmp_path, corner, SHORT), tmp_path / "out"
    words = ("--study", str(path), "--participant", "3", "--out", str(out))
    with served(None, *words) as (address, process):
        with FakePage(address) as page:
            page.say("goon", step=step(page, "welcome")["step"])
            page.say("goon", step=step(page, "read")["step"])
            assert step(page, "drive")["left_s"] <= 3.0
            page.say("assist", on=True)
            told = page.until(lambda message: message["say"] == "notice" and message["kind"] == "refused")
            assert "the study sets this" in told["told"]
            page.stick = (0.0, 0.8)
            asked = step(page, "ask")
            page.say("answerall", step=asked["step"], answers=[9, 0])
            page.until(lambda message: message["say"] == "notice" and "expected 0 to 6" in message["told"])
            page.say("answerall", step=asked["step"], answers=[2, 0])
            page.say("answerall", step=step(page, "ask")["step"], answers=[1])
            with FakePage(address) as late:
                assert step(late, "end")["participant"] == 3, "who comes later is told too"
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=120)
    assert "order alone" in said and "alone saved in " in said and "Traceback" not in said
    rows = _participant_rows(open_study(str(path), 3, out))
    assert [(row["block"], row["answer_effort"], row["answer_best"]) for row in rows] == [
        ("alone", "3", ""),
        ("end", "", "with more"),
    ]
    assert float(rows[0]["distance_m"]) > 0.5 and rows[0]["ended"] == "minutes"
    assert main(["log", "verify", rows[0]["recording"]]) == 0


@pytest.mark.parametrize(
    "words, told",
    [
        (("--study", "assistance"), "--participant"),
        (("--study", "assistance", "--participant", "1", "--policy", "follow"), "leave --policy out"),
        (("--study", "assistance", "--participant", "1", "--seed", "4"), "--seed"),
        (("monaco", "--study", "assistance", "--participant", "1"), "monaco"),
        (("--study", "nothing.toml", "--participant", "1"), "there is no such study"),
        (("--study", "assistance", "--participant", "-1"), "expected 1 to 9999"),
        (("--participant", "1"), "--participant"),
        (("monaco", "--suite", "guard", "--seed", "5"), "--seed"),
    ],
)
def test_wrong_words_are_refused_in_a_line(
    words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["drive", *words]) == 2
    assert told in capsys.readouterr().err
