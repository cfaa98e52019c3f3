"""A participant goes through a study in the little town of `corner`, without a page."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.drive.recording.studies import STUDY, Participant, write_study
from wcsim.bridge.replay.replayed import verify
from wcsim.config import parse_json
from wcsim.config.study import StudyFile
from wcsim.drive.recording import study_lead
from wcsim.drive.recording.study_lead import OpenStudy, _participant_rows, _shipped_studies, open_study
from wcsim.drive.recording.study_plan import StepKind, read_rows, table_columns
from wcsim.errors import ConfigError, DiskFullError, PolicyError, TownError, WcsimError
from wcsim.log.drive import read_drive

Begin = Callable[[OpenStudy], Participant]
Opened = Callable[..., OpenStudy]


@pytest.fixture
def begin() -> Iterator[Begin]:
    """Begins a study; what is open at the end of a test is closed."""
    with ExitStack() as held:

        def new(study: OpenStudy) -> Participant:
            person = Participant(study)
            held.callback(person.close)
            return person

        yield new


@pytest.fixture
def opened(corner: Path, tmp_path: Path) -> Opened:
    def study(participant: int = 2, text: str = STUDY) -> OpenStudy:
        return open_study(str(write_study(tmp_path, corner, text)), participant, tmp_path / "out")

    return study


def column(study: OpenStudy, name: str = "block") -> list[str]:
    return [row[name] for row in _participant_rows(study)]


def test_a_participant_goes_through_all_of_it(opened: Opened, begin: Begin) -> None:
    study = opened()
    assert study.order == "more>alone"
    person = begin(study)
    assert (person.view.kind, person.view.title, person.view.button) == (StepKind.WELCOME, "A tiny study", "Continue")
    assert "Your name is not saved" in person.view.told[-1]
    assert "order more>alone" in person.said[0]
    person.press()
    assert (person.view.kind, person.view.where, person.view.ready) == (StepKind.READ, "Practice", True)
    assert not person.lead.drives and person.session is not None, "the street is there, and time stands"
    person.press()
    assert person.view.left_s == 3.0
    assert person.drive() == 30
    assert (person.view.where, person.view.title) == ("Part 1 of 2", "With more")
    assert person.session is not None
    assert (person.session.assistance.on, person.session.assistance.level) == (True, 1.5)
    person.press()
    person.press()  # "end here", at once
    assert [question["answers"] for question in person.view.questions] == [tuple("1234567"), ("yes", "no")]
    for wrong in ((1,), (7, 0), (0, 2)):
        with pytest.raises(WcsimError, match="reload the page"):
            person.answer(*wrong)
    with pytest.raises(WcsimError, match="questions are not answered"):
        person.press()
    person.answer(6, -1)
    assert (person.view.kind, person.view.wait_s) == (StepKind.REST, 5.0)
    with pytest.raises(WcsimError, match="rest is not over"):
        person.press()
    person.now_s += 5.0
    person.press()
    assert not person.session.assistance.on
    person.press()
    person.lead.go_on(person.view.step - 1)
    assert person.view.kind is StepKind.DRIVE, "a second press of the button before does nothing"
    assert person.drive() == 30
    person.answer(0, 1)
    person.answer(1)
    assert (person.view.kind, person.view.told) == (StepKind.END, ("Thanks.", "Everything is saved."))

    rows = _participant_rows(study)
    assert column(study) == ["practice", "more", "alone", "end"]
    assert column(study, "part") == ["0", "1", "2", ""]
    assert column(study, "ended") == ["minutes", "stopped", "minutes", ""]
    assert column(study, "assistance") == ["on", "on", "off", ""]
    assert column(study, "answer_effort") == ["", "7", "1", ""]
    assert column(study, "answer_again") == ["", "", "no", ""]
    assert rows[3]["answer_best"] == "with more"
    assert rows[2]["kpi1"] == "0.00000" or float(rows[2]["kpi1"]) < 0.2
    assert float(rows[2]["distance_m"]) > 1.0 and rows[2]["level"] == "1" and rows[1]["level"] == "1.5"
    assert {row["order"] for row in rows} == {"more>alone"} and {row["policy_failed"] for row in rows[:3]} == {"no"}
    drive = read_drive(Path(rows[2]["recording"]))
    assert len(drive.ticks) == 30 and verify(drive).mismatches == 0


def test_who_stops_goes_on_where_it_was_left(opened: Opened, begin: Begin) -> None:
    study = opened()
    person = begin(study)
    person.until(StepKind.ASK)
    person.close()  # driven, and not answered

    person = begin(study)
    person.press()
    assert (person.view.kind, person.view.where) == (StepKind.ASK, "Part 1 of 2"), "it is not driven again"
    person.answer(3, 0)
    person.now_s += 5.0
    person.press()
    person.press()
    person.drive(12)
    person.close()  # in the middle of a drive

    person = begin(study)
    person.press()
    assert (person.view.kind, person.view.where) == (StepKind.READ, "Part 2 of 2")
    person.until(StepKind.END)
    assert column(study) == ["practice", "more", "alone", "end"]
    assert _participant_rows(study)[1]["answer_effort"] == "4"
    assert {path.name for path in study.folder.glob("*.drive")} == {
        "0-practice.drive",
        "1-more.drive",
        "2-alone.drive",
        "2-alone-2.drive",
    }
    assert _participant_rows(study)[2]["recording"].endswith("2-alone-2.drive"), "that of the drive that counts"
    assert begin(study).view.kind is StepKind.END
    other = begin(opened(1))
    assert other.view.kind is StepKind.WELCOME
    other.close()


def test_figures_that_are_in_the_table_are_not_taken_for_another_drive(opened: Opened, begin: Begin) -> None:
    """A pilot whose rows were removed from the table is driven anew."""
    study = opened()
    person = begin(study)
    person.until(StepKind.ASK)
    kept = study.folder / "1-more.csv"
    assert kept.is_file()
    person.close()
    person = begin(study)
    assert any("more was driven before" in line for line in person.said), "never without a word"
    person.until(StepKind.REST)
    assert not kept.exists()
    study.table.unlink()
    assert begin(study).lead._steps[1].kind is StepKind.READ


def test_a_page_that_comes_in_the_middle_of_a_rest_is_told_what_is_left(opened: Opened, begin: Begin) -> None:
    person = begin(opened())
    person.until(StepKind.REST)
    waits_s = []
    for _ in range(12):
        person.now_s += 0.5
        person.lead.wait()
        waits_s.append(person.view.wait_s)
    assert waits_s == [5.0, 4.0, 4.0, 3.0, 3.0, 2.0, 2.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    shown = len(person.views)
    person.lead.wait()
    assert len(person.views) == shown, "and no more once it is over"
    person.press()
    assert person.view.kind is StepKind.READ


def test_help_that_is_asked_for_in_a_pause_is_in_the_row_of_its_block(opened: Opened, begin: Begin) -> None:
    study = opened()
    person = begin(study)
    person.until(StepKind.DRIVE)
    person.drive(5)
    assert person.session is not None
    for _ in range(2):
        person.session.ask_for_help()
    person.press()  # ended early, without another tick
    assert _participant_rows(study)[0]["helps"] == "1", "one call a tick counts"


def test_arrivals_end_a_part(opened: Opened, begin: Begin) -> None:
    text = STUDY.replace('name = "alone"', 'name = "alone"\narrivals = 1')
    person = begin(opened(1, text))
    person.until(StepKind.READ)
    person.press()
    person.drive()
    person.press()
    assert person.view.arrivals_left == 1 and person.session is not None
    person.session.metrics = person.session.metrics._replace(arrivals=1)
    assert person.drive() == 1
    person.answer(0, 0)
    assert _participant_rows(opened(1, text))[1]["ended"] == "arrivals"
    person.close()


def test_answers_that_cannot_be_written_are_asked_for_again(
    opened: Opened, begin: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = opened()
    person = begin(study)
    with monkeypatch.context() as full:
        full.setattr(study_lead, "append_row", lambda *_: (_ for _ in ()).throw(DiskFullError("no room")))
        person.until(StepKind.ASK)
        with pytest.raises(DiskFullError):
            person.answer(0, 0)
    assert any("no room" in line and "kpi" not in line for line in person.said), "the figures are not lost"
    person.answer(0, 0)
    assert column(study) == ["more"]
    person.close()


def test_a_street_that_cannot_be_opened_may_be_tried_again(
    opened: Opened, begin: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    person = begin(opened())
    with monkeypatch.context() as gone:
        gone.setattr(study_lead, "study_start", lambda *_: (_ for _ in ()).throw(TownError("the town is gone")))
        person.press()
        assert (person.view.button, person.view.trouble) == ("Try again", "the town is gone")
        person.press()
        assert person.view.trouble
    person.press()
    assert person.view.ready and not person.view.trouble and person.session is not None
    person.close()


@pytest.mark.parametrize(
    "change, error, told",
    [
        (('name = "tiny"', 'name = "tiny"\nnmae = 1'), ConfigError, "unknown key 'nmae'"),
        (("level = 1.5", "level = 2.5"), ConfigError, "block more has level 2.5, but policy dwa has levels of 0 to 2"),
        (('title = "A tiny study"', 'title = "A"\npolicy = "follow"'), ConfigError, "policy follow has no levels"),
        (('title = "A tiny study"', 'title = "A"\npolicy = "nobody-there"'), PolicyError, "nobody-there"),
        (("seed = 4", "seed = 4\nblock = 1"), ConfigError, "block does not belong to this kind of place"),
        (("seed = 4", 'suite = "guard"'), ConfigError, "either a town"),
        (('town = "{town}"\nseed = 4', 'suite = "guard"\nblock = 700'), ConfigError, "expected 0 to 9"),
        (('town = "{town}"', 'town = "atlantis"'), TownError, "atlantis"),
        (('title = "A tiny study"', 'title = "A"\nprofile = "nobody"'), ConfigError, "unknown user profile"),
        (('title = "A tiny study"', 'title = "A"\nprofile = "recorded:a.csv"'), ConfigError, "cannot be kept|a.csv"),
        (('name = "more"', 'name = "alone"'), ConfigError, "two blocks are called alone"),
        (("minutes = 0.05", "minutes = 0"), ConfigError, "minutes.*at least 0.05"),
        (('low = "easy"\n', ""), ConfigError, "a question of kind scale has low and high"),
        (('choices = ["alone", "with more"]', 'choices = ["alone"]'), ConfigError, "2 to 8 different answers"),
        (("assistance = false", "assistance = false\nlevel = 1"), ConfigError, "without assistance has no level"),
        (("pause_s = 5", "pause_s = -5"), ConfigError, "pause_s"),
        (("[practice]", "[[places]]\ntown = 'a'\n[[places]]\ntown = 'b'\n[practice]"), ConfigError, "3 places for 2"),
    ],
)
def test_what_cannot_be_is_refused_before_anybody_drives(
    opened: Opened, change: tuple[str, str], error: type[Exception], told: str
) -> None:
    assert change[0] in STUDY
    with pytest.raises(error, match=told) as refused:
        opened(1, STUDY.replace(*change))
    assert "\n" not in str(refused.value)


def test_a_study_that_is_not_there_or_another_one_is_refused(opened: Opened, begin: Begin) -> None:
    for name in ("nothing", "a" * 5000, "~nobody-is-called-so/study.toml"):
        with pytest.raises(ConfigError, match="there is no such study; expected assistance"):
            open_study(name, 1)
    with pytest.raises(ConfigError, match="--participant 0: expected 1 to 9999"):
        open_study("assistance", 0)
    person = begin(opened())
    person.until(StepKind.ASK)
    person.close()
    with pytest.raises(ConfigError, match="belongs to another study file"):
        opened(3, STUDY.replace("Thanks.", "Thank you."))
    with pytest.raises(ConfigError, match="its columns are not those of this study"):
        opened(3, STUDY.replace('name = "effort"', 'name = "work"'))


def test_a_class_that_a_study_names_is_loaded_only_when_it_is_named_again(
    corner: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "stranger.py").write_text("raise RuntimeError('loaded')\n")
    monkeypatch.chdir(tmp_path)
    path = str(write_study(tmp_path, corner, STUDY.replace("pause_s = 5", 'pause_s = 5\npolicy = "stranger:Own"')))
    with pytest.raises(ConfigError, match="loading it runs its code; if you trust it, name it"):
        open_study(path, 1, tmp_path / "out")
    with pytest.raises(ConfigError, match="says policy = 'stranger:Own'; leave --policy out"):
        open_study(path, 1, tmp_path / "out", "follow")
    with pytest.raises(Exception, match="loaded"):
        open_study(path, 1, tmp_path / "out", "stranger:Own")


def test_the_study_that_is_shipped_can_begin(tmp_path: Path) -> None:
    assert _shipped_studies() == ("assistance",)
    study = open_study("assistance", 2, tmp_path)
    assert study.order == "less>more>alone"
    assert parse_json(StudyFile, study.file.model_dump_json(), "again") == study.file
    assert read_rows(study.table, table_columns(study.file)) == ()


def test_each_part_is_in_the_table_where_questions_come_at_the_end_alone(opened: Opened, begin: Begin) -> None:
    first, *_ = STUDY.split("[[questions]]")
    text = f"{first}[[questions]]{STUDY.split('[[questions]]')[3]}"
    study = opened(text=text)
    person = begin(study)
    person.until(StepKind.END)
    assert column(study) == ["practice", "more", "alone", "end"]
