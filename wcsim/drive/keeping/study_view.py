"""What a page shows of a study: words, a button, questions with their answers. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from wcsim.config.study import StudyFile, StudyQuestion
from wcsim.core.reading import counted
from wcsim.drive.keeping.study_plan import StepKind, StudyStep, questions_of
from wcsim.drive.keeping.study_table import answers_of

_KEPT = (
    "Saved under a number: how you moved the stick, where the chair drove, what the assistance did, and your answers. "
    "Your name is not saved, and no picture or sound of you is recorded."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class QuestionView:
    """A question and its answers."""

    name: str
    asks: str
    answers: tuple[str, ...]
    low: str = ""  # what the first means, of a scale
    high: str = ""  # what the last means


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyView:
    """A step of a study as a page shows it."""

    step: int
    kind: StepKind
    participant: int
    title: str
    told: tuple[str, ...] = ()
    where: str = ""  # in the study: "Part 2 of 3"
    button: str = ""  # "" for none
    ready: bool = True  # the button may be pressed
    wait_s: float = 0.0  # until it may
    left_s: float | None = None  # of a drive
    arrivals_left: int | None = None
    questions: tuple[QuestionView, ...] = ()
    trouble: str = ""  # what went wrong, and what to do


def view_of(study: StudyFile, step: StudyStep, number: int, participant: int) -> StudyView:
    """A step in words, before anything has happened in it."""
    part, count = step.part, len(study.blocks)
    where = "" if part is None else f"Part {part.number} of {count}" if part.number else "Practice"
    told: tuple[str, ...] = ()
    title, button = study.title, ""
    if step.kind is StepKind.WELCOME:
        told, button = (*study.told, _KEPT), "Continue"
    elif step.kind is StepKind.READ and part is not None:
        title, told, button = part.block.title, (*part.block.told, _how_long(step)), "Start driving"
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
    questions = questions_of(study, step) if step.kind is StepKind.ASK else ()
    return StudyView(
        step=number,
        kind=step.kind,
        participant=participant,
        title=title,
        told=told,
        where=where,
        button=button,
        questions=tuple(map(_question, questions)),
    )


def _how_long(step: StudyStep) -> str:
    if step.part is None:
        return ""
    block = step.part.block
    minutes = f"{block.minutes:g} minute{'' if block.minutes == 1.0 else 's'}"
    if block.arrivals is None:
        return f"You drive for {minutes}. You can pause at any time; pauses do not count."
    places = counted(block.arrivals, "place")
    return f"You drive until you have arrived at {places}, for at most {minutes}. You can pause at any time."


def _question(question: StudyQuestion) -> QuestionView:
    return QuestionView(
        name=question.name, asks=question.asks, answers=answers_of(question), low=question.low, high=question.high
    )
