"""A study for one participant: order of blocks, table of results, and what the page shows."""

import contextlib
import csv
import fcntl
import io
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from wcsim.config.study import StudyBlock, StudyFile, StudyPlace, StudyQuestion
from wcsim.core.reading import STUDY_TABLE, escape, pluralize, read_text
from wcsim.errors import ConfigError, DiskFullError

END = "end"
"""The row of a table that holds the answers after all blocks."""
COLUMNS: Final = (
    *("study", "study_sha256", "wcsim", "participant", "order"),
    *("part", "block", "assistance", "level", "policy", "town", "seed", "episode", "recording"),
    *("ended", "minutes", "kpi1", "kpi2", "distance_m", "speed_mps"),
    *("arrivals", "given_up", "crashes", "warnings", "interventions", "helps", "overrulings"),
    "policy_failed",
)
"""What every row has; the answers come after them, `answer_` and the question's name each."""

_MOST_ROWS: Final = 200_000

Row = Mapping[str, str]
_SAVED = (
    "Saved under a number: how you moved the stick, where the chair drove, "
    "what the assistance did, and your answers. "
    "Your name is not saved, and no picture or sound of you is recorded."
)


class StepKind(StrEnum):
    """What a step of a study is."""

    WELCOME = "welcome"
    READ = "read"  # what comes next
    DRIVE = "drive"
    ASK = "ask"
    REST = "rest"
    END = "end"


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyPart:
    """A block in its place."""

    number: int  # 0 of the practice, the first that counts is 1
    block: StudyBlock
    place: StudyPlace


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyStep:
    """One page, or one drive, of a study."""

    kind: StepKind
    part: StudyPart | None = None  # of the whole study where it is None


def order_words(study: StudyFile, participant: int) -> str:
    """The order of the blocks that count, in a word.

    >>> from wcsim.config.study import StudyBlock, StudyPlace
    >>> blocks = tuple(StudyBlock(name=name, title=name, assistance=False) for name in "abc")
    >>> places = (StudyPlace(town="t"),)
    >>> study = StudyFile(name="s", title="s", told=(), places=places, blocks=blocks)
    >>> order_words(study, 1), order_words(study, 4), order_words(study, 7)
    ('a>b>c', 'c>b>a', 'a>b>c')
    """
    return ">".join(part.block.name for part in _study_parts(study, participant) if part.number)


def step_questions(study: StudyFile, step: StudyStep) -> tuple[StudyQuestion, ...]:
    """What is asked in a step."""
    after = "end" if step.part is None else "block"
    return tuple(question for question in study.questions if question.after == after)


def remaining_steps(
    study: StudyFile, participant: int, done: Collection[str] = (), driven: Collection[str] = ()
) -> tuple[StudyStep, ...]:
    """What is left to do.

    Args:
        study: The file.
        participant: Their number, 1 or more.
        done: The blocks' names that are in the table, and `END`.
        driven: Those that were driven, and not asked about yet.
    """
    steps: list[StudyStep] = []
    left = [part for part in _study_parts(study, participant) if part.block.name not in done]
    asks = any(question.after == "block" for question in study.questions)
    for part in left:
        if steps and part.number > 1 and study.pause_s > 0.0:
            steps.append(StudyStep(kind=StepKind.REST))
        if part.block.name not in driven:
            steps += [
                StudyStep(kind=StepKind.READ, part=part),
                StudyStep(kind=StepKind.DRIVE, part=part),
            ]
        if asks and part.number:
            steps.append(StudyStep(kind=StepKind.ASK, part=part))
    if END not in done and any(question.after == "end" for question in study.questions):
        steps.append(StudyStep(kind=StepKind.ASK))
    if steps:
        steps.insert(0, StudyStep(kind=StepKind.WELCOME))
    return (*steps, StudyStep(kind=StepKind.END))


def table_columns(study: StudyFile) -> tuple[str, ...]:
    """The columns of a study's table."""
    return (*COLUMNS, *(question.column for question in study.questions))


def answer_choices(question: StudyQuestion) -> tuple[str, ...]:
    """The answers that a question has, as they stand in the table.

    >>> answer_choices(StudyQuestion(name="a", asks="A?", low="no", high="very", steps=3))
    ('1', '2', '3')
    >>> answer_choices(StudyQuestion(name="b", asks="B?", kind="yes_no"))
    ('yes', 'no')
    """
    if question.kind == "scale":
        return tuple(str(step) for step in range(1, question.steps + 1))
    return ("yes", "no") if question.kind == "yes_no" else question.choices


def read_rows(path: Path, columns: Sequence[str]) -> tuple[dict[str, str], ...]:
    """All rows of a table; none where there is no file.

    Raises:
        ConfigError: It has other columns, or cannot be read as a table.
    """
    if not os.path.lexists(path):
        return ()
    text = read_text(path, STUDY_TABLE)
    if text and not text.endswith("\n"):
        raise ConfigError(f"{escape(path)}: its last line is incomplete; complete it, or remove it")
    try:
        lines = [line for line in csv.reader(io.StringIO(text, newline=""), strict=True) if line]
    except csv.Error:
        lines = []
    if not lines or tuple(lines[0]) != tuple(columns):
        raise ConfigError(
            f"{escape(path)}: its columns are not those of this study; "
            "expected the table of the same study file: name another folder with --out"
        )
    if len(lines) > _MOST_ROWS or any(len(line) != len(columns) for line in lines):
        raise ConfigError(
            f"{escape(path)}: is not a table with {len(columns)} columns; "
            "expected one that wcsim wrote"
        )
    return tuple(dict(zip(columns, line, strict=True)) for line in lines[1:])


def append_row(path: Path, columns: Sequence[str], row: Row) -> None:
    """Append a row to a table, whole or not at all; a new table begins with the column names.

    Raises:
        ConfigError: The file cannot be opened.
        DiskFullError: It could not be written on.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
    except OSError as error:
        raise ConfigError(
            f"{escape(path)}: cannot be written ({error.strerror}); choose another --out"
        ) from None
    try:
        with contextlib.suppress(OSError):  # a file system without locks
            # Another participant's drive may write into it at the same time.
            fcntl.flock(handle, fcntl.LOCK_EX)
        end = os.fstat(handle).st_size
        # An editor may have saved it without the end of its last line.
        truncated = end > 0 and os.pread(handle, 1, end - 1) != b"\n"
        before = b"\n" if truncated else b"" if end else _line(columns)
        data = before + _line([row.get(name, "") for name in columns])
        try:
            written = os.pwrite(handle, data, end)
            reason = "" if written == len(data) else "only a part was written"
        except OSError as error:
            reason = str(error.strerror)
        if reason:
            os.ftruncate(handle, end)
            raise DiskFullError(
                f"{escape(path)}: a row could not be written ({reason}); "
                "free some disk space, and press again"
            )
        os.fsync(handle)
    finally:
        os.close(handle)


def step_view(study: StudyFile, step: StudyStep, number: int, participant: int) -> dict[str, Any]:
    """A step as a page shows it, in words, before anything has happened in it."""
    part, count = step.part, len(study.blocks)
    where = "" if part is None else f"Part {part.number} of {count}" if part.number else "Practice"
    told: tuple[str, ...] = ()
    title, button = study.title, ""
    if step.kind is StepKind.WELCOME:
        told, button = (*study.told, _SAVED), "Continue"
    elif step.kind is StepKind.READ and part is not None:
        title, button = part.block.title, "Start driving"
        told = (*part.block.told, _how_long(part.block))
    elif step.kind is StepKind.DRIVE and part is not None:
        title = part.block.title
    elif step.kind is StepKind.ASK:
        title, button = "How was it?" if part is not None else "Last questions", "Save and continue"
        told = ("There are no right or wrong answers. You may skip a question.",)
    elif step.kind is StepKind.REST:
        title, button = "Take a rest", "Continue"
        told = ("Your answers are saved. Rest as long as you like.",)
    else:
        title, told = "This is the end", (*study.thanks, "Everything is saved.")
    questions = []
    for question in step_questions(study, step) if step.kind is StepKind.ASK else ():
        # `low` and `high` are what the first and the last answer mean, of a scale.
        shown = question.model_dump(include={"name", "asks", "low", "high"})
        questions.append({**shown, "answers": answer_choices(question)})
    return {
        "step": number,
        "kind": step.kind,
        "participant": participant,
        "title": title,
        "told": told,
        "where": where,  # in the study: "Part 2 of 3"
        "button": button,  # "" for none
        "ready": True,  # the button may be pressed
        "wait_s": 0.0,  # until it may
        "left_s": None,  # of a drive
        "arrivals_left": None,
        "questions": questions,
        "trouble": "",  # what went wrong, and what to do
    }


def _study_parts(study: StudyFile, participant: int) -> tuple[StudyPart, ...]:
    """The blocks in this participant's order, the practice first; `participant` is 1 or more."""
    count = len(study.blocks)
    orders = _latin_square(count) if study.balanced else (tuple(range(count)),)
    order = orders[(participant - 1) % len(orders)]
    found = [
        StudyPart(
            number=at + 1, block=study.blocks[index], place=study.places[at % len(study.places)]
        )
        for at, index in enumerate(order)
    ]
    if study.practice is not None:
        place = study.practice_place or study.places[0]
        found.insert(0, StudyPart(number=0, block=study.practice, place=place))
    return tuple(found)


def _latin_square(count: int) -> tuple[tuple[int, ...], ...]:
    """Orders in which each thing is equally often at each place, and right after each other one.

    Williams' design: `count` orders for an even number, twice as many for an odd one.

    >>> _latin_square(4)
    ((0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1))
    >>> _latin_square(3)
    ((0, 1, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0), (0, 2, 1), (1, 0, 2))
    """
    first = [0]
    for step in range(1, count):
        first.append((step + 1) // 2 if step % 2 else count - step // 2)
    rows = [tuple((item + shift) % count for item in first) for shift in range(count)]
    return tuple(rows if count % 2 == 0 else rows + [row[::-1] for row in rows])


def _line(words: Sequence[str]) -> bytes:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(words)
    return line.getvalue().encode()


def _how_long(block: StudyBlock) -> str:
    minutes = f"{block.minutes:g} minute{'' if block.minutes == 1.0 else 's'}"
    if block.arrivals is None:
        return f"You drive for {minutes}. You can pause at any time; pauses do not count."
    places = pluralize(block.arrivals, "place")
    return (
        f"You drive until you have arrived at {places}, for at most {minutes}. "
        "You can pause at any time."
    )
