"""The plan of a study for a participant: in which order, where, and what comes after what. Pure."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import StrEnum

from wcsim.config.study import StudyBlock, StudyFile, StudyPlace, StudyQuestion

END = "end"
"""The row of a table that holds the answers after all blocks."""


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


def latin_square(count: int) -> tuple[tuple[int, ...], ...]:
    """Orders of so many things in which each is as often at each place, and as often right after each other one.

    Williams' design: `count` orders for an even number, twice as many for an odd one.

    >>> latin_square(4)
    ((0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1))
    >>> latin_square(3)
    ((0, 1, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0), (0, 2, 1), (1, 0, 2))
    """
    first = [0]
    for step in range(1, count):
        first.append((step + 1) // 2 if step % 2 else count - step // 2)
    rows = [tuple((item + shift) % count for item in first) for shift in range(count)]
    return tuple(rows if count % 2 == 0 else rows + [row[::-1] for row in rows])


def parts_of(study: StudyFile, participant: int) -> tuple[StudyPart, ...]:
    """The blocks in this participant's order, the practice first; `participant` is 1 or more."""
    orders = latin_square(len(study.blocks)) if study.balanced else (tuple(range(len(study.blocks))),)
    order = orders[(participant - 1) % len(orders)]
    found = [
        StudyPart(number=at + 1, block=study.blocks[index], place=study.places[at % len(study.places)])
        for at, index in enumerate(order)
    ]
    if study.practice is not None:
        place = study.practice_place or study.places[0]
        found.insert(0, StudyPart(number=0, block=study.practice, place=place))
    return tuple(found)


def order_words(study: StudyFile, participant: int) -> str:
    """The order of the blocks that count, in a word.

    >>> from wcsim.config.study import StudyBlock, StudyPlace
    >>> blocks = tuple(StudyBlock(name=name, title=name, assistance=False) for name in "abc")
    >>> study = StudyFile(name="s", title="s", told=(), places=(StudyPlace(town="t"),), blocks=blocks)
    >>> order_words(study, 1), order_words(study, 4), order_words(study, 7)
    ('a>b>c', 'c>b>a', 'a>b>c')
    """
    return ">".join(part.block.name for part in parts_of(study, participant) if part.number)


def questions_of(study: StudyFile, step: StudyStep) -> tuple[StudyQuestion, ...]:
    """What is asked in a step."""
    after = "end" if step.part is None else "block"
    return tuple(question for question in study.questions if question.after == after)


def steps_of(
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
    left = [part for part in parts_of(study, participant) if part.block.name not in done]
    asks = any(question.after == "block" for question in study.questions)
    for part in left:
        if steps and part.number > 1 and study.pause_s > 0.0:
            steps.append(StudyStep(kind=StepKind.REST))
        if part.block.name not in driven:
            steps += [StudyStep(kind=StepKind.READ, part=part), StudyStep(kind=StepKind.DRIVE, part=part)]
        if asks and part.number:
            steps.append(StudyStep(kind=StepKind.ASK, part=part))
    if END not in done and any(question.after == "end" for question in study.questions):
        steps.append(StudyStep(kind=StepKind.ASK))
    if steps:
        steps.insert(0, StudyStep(kind=StepKind.WELCOME))
    return (*steps, StudyStep(kind=StepKind.END))
