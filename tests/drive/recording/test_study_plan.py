from collections import Counter
from itertools import pairwise

import pytest

from wcsim.config.study import StudyBlock, StudyFile, StudyPlace, StudyQuestion
from wcsim.drive.recording.study_plan import END, StepKind, _latin_square, _study_parts, order_words, remaining_steps


def block(name: str) -> StudyBlock:
    return StudyBlock(name=name, title=name, assistance=False)


def study(**more: object) -> StudyFile:
    given = {
        "blocks": tuple(map(block, "abcd")),
        "places": tuple(StudyPlace(town="t", seed=seed) for seed in range(4)),
        "practice": block("p"),
        "questions": (
            StudyQuestion(name="q", asks="Q?", kind="yes_no"),
            StudyQuestion(name="e", asks="E?", kind="yes_no", after="end"),
        ),
    }
    return StudyFile(name="s", title="S", told=(), **(given | more))  # type: ignore[arg-type]


@pytest.mark.parametrize("count", range(1, 13))
def test_each_stands_everywhere_and_behind_each_other_equally_often(count: int) -> None:
    rows = _latin_square(count)
    assert all(sorted(row) == list(range(count)) for row in rows)
    places = Counter((at, item) for row in rows for at, item in enumerate(row))
    behind = Counter(pair for row in rows for pair in pairwise(row))
    assert len(places) == count**2 and len(set(places.values())) == 1
    assert len(behind) == count * (count - 1) and len(set(behind.values())) <= 1


def test_participants_go_through_all_orders_and_blocks_through_all_places() -> None:
    file = study()
    met = Counter(
        (part.block.name, part.place.seed)
        for number in range(1, 5)
        for part in _study_parts(file, number)
        if part.number
    )
    assert len(met) == 16 and set(met.values()) == {1}
    assert order_words(file, 1) == order_words(file, 5) != order_words(file, 2)
    assert order_words(study(balanced=False), 2) == "a>b>c>d"


def test_the_practice_comes_first_and_nothing_is_asked_about_it() -> None:
    steps = remaining_steps(study(), 1)
    told = [(step.kind, step.part.block.name if step.part else "") for step in steps]
    assert told[:6] == [
        (StepKind.WELCOME, ""),
        (StepKind.READ, "p"),
        (StepKind.DRIVE, "p"),
        (StepKind.READ, "a"),
        (StepKind.DRIVE, "a"),
        (StepKind.ASK, "a"),
    ]
    assert told[6] == (StepKind.REST, "") and told[-2:] == [(StepKind.ASK, ""), (StepKind.END, "")]
    assert sum(kind is StepKind.REST for kind, _ in told) == 3


def test_what_is_done_is_not_done_again() -> None:
    steps = remaining_steps(study(), 1, done={"p", "a"}, driven={"b"})
    told = [(step.kind, step.part.block.name if step.part else "") for step in steps]
    assert told[:4] == [(StepKind.WELCOME, ""), (StepKind.ASK, "b"), (StepKind.REST, ""), (StepKind.READ, "d")]
    assert [step.kind for step in remaining_steps(study(), 1, done=set("pabcd"))] == [
        StepKind.WELCOME,
        StepKind.ASK,
        StepKind.END,
    ]
    assert [step.kind for step in remaining_steps(study(), 1, done={*"pabcd", END})] == [StepKind.END]
