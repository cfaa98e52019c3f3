"""The file of a study with people on the drive's page: blocks, places and questions."""

from collections import Counter
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from wcsim.config.base import Model, Seed, Word, within

MOST_BLOCKS: Final = 12
MOST_QUESTIONS: Final = 20
# Steps of a scale: at most, and usually.
MOST_STEPS: Final = 11
_STEPS: Final = 7
_Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,31}$")]
_Line = Annotated[str, Field(min_length=1, max_length=200)]
_Paragraph = Annotated[str, Field(min_length=1, max_length=1000)]
_StudyTexts = Annotated[tuple[_Paragraph, ...], Field(max_length=12)]
_Minutes = Annotated[float, within(0.05, 120.0)]
_Level = Annotated[float, within(0.0, 100.0)]
_Reference = Annotated[str, Field(min_length=1, max_length=400)]
_Number = Annotated[int, Field(ge=0, lt=1 << 31)]
_Arrivals = Annotated[int, within(1, 100)]
# The keys that a question of each kind must have.
_ANSWERS: Final = {"scale": ("low", "high"), "choice": ("choices",), "yes_no": ()}


class StudyPlace(Model):
    """Where a block is driven: a town with a seed, or an episode of a suite."""

    town: Word = ""
    seed: Seed = 0  # of the town
    suite: Word = ""
    block: _Number = 0  # of the suite
    seat: _Number = 0

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        if bool(self.town) == bool(self.suite):
            raise ValueError(
                "a place has either a town (with a seed) or a suite (with block and seat)"
            )
        wrong = {"seed": self.seed} if self.suite else {"block": self.block, "seat": self.seat}
        given = ", ".join(name for name, value in wrong.items() if value)
        if given:
            raise ValueError(f"{given} does not belong to this kind of place")
        return self


class StudyBlock(Model):
    """Some minutes of driving in one way of being assisted."""

    name: _Name
    title: _Line  # as the participant reads it: it need not say what is compared
    told: _StudyTexts = ()  # before it begins
    assistance: bool
    level: _Level | None = None  # of assistance; None leaves the policy's own
    minutes: _Minutes = 5.0  # of driving, pauses do not count
    arrivals: _Arrivals | None = None  # over after so many already

    @model_validator(mode="after")
    def _has_a_level_that_counts(self) -> Self:
        if self.level is not None and not self.assistance:
            raise ValueError("a block without assistance has no level: remove one of the two")
        return self


class StudyQuestion(Model):
    """What is asked: a scale whose two ends are named, yes or no, or one of some answers."""

    name: _Name
    asks: _Line
    kind: Literal["scale", "yes_no", "choice"] = "scale"
    low: Annotated[str, Field(max_length=60)] = ""  # what 1 means
    high: Annotated[str, Field(max_length=60)] = ""  # what the last step means
    steps: Annotated[int, within(3, MOST_STEPS)] = _STEPS
    choices: Annotated[
        tuple[Annotated[str, Field(min_length=1, max_length=60)], ...], Field(max_length=8)
    ] = ()
    after: Literal["block", "end"] = "block"  # each block but the practice, or all of them

    @property
    def column(self) -> str:
        """The column of its answers."""
        return f"answer_{self.name}"

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Self:
        expected = _ANSWERS[self.kind]
        given = [key for key in ("low", "high", "choices") if getattr(self, key)]
        if sorted(given) != sorted(expected) or (self.steps != _STEPS and self.kind != "scale"):
            raise ValueError(
                f"a question of kind {self.kind} has "
                f"{' and '.join(expected) or 'no answers of its own'}"
            )
        if self.kind == "choice" and (
            len(self.choices) < 2 or len(set(self.choices)) < len(self.choices)
        ):
            raise ValueError("a choice has 2 to 8 different answers")
        return self


class StudyFile(Model):
    """The whole file."""

    name: _Name
    title: _Line
    told: _StudyTexts  # on the first page
    policy: _Reference = "dwa"  # who assists, in every block
    profile: _Reference = "competent"  # of the simulated user beside, who says where the way goes
    balanced: bool = True  # the blocks' order by participant number; else as they stand
    pause_s: Annotated[float, within(0.0, 3600.0)] = 30.0  # at least so long between two blocks
    places: Annotated[tuple[StudyPlace, ...], Field(min_length=1, max_length=MOST_BLOCKS)]
    practice: StudyBlock | None = None
    practice_place: StudyPlace | None = None  # None for the first of `places`
    blocks: Annotated[tuple[StudyBlock, ...], Field(min_length=1, max_length=MOST_BLOCKS)]
    questions: Annotated[tuple[StudyQuestion, ...], Field(max_length=MOST_QUESTIONS)] = ()
    thanks: _StudyTexts = ()  # on the last page

    @model_validator(mode="after")
    def _has_no_name_twice(self) -> Self:
        blocks = [*self.blocks, *([self.practice] if self.practice else [])]
        for what, names in (
            ("blocks", [block.name for block in blocks]),
            ("questions", [question.name for question in self.questions]),
        ):
            twice = [name for name, count in Counter(names).items() if count > 1]
            if twice:
                raise ValueError(f"two {what} are called {twice[0]}; expected names that differ")
        if self.practice_place is not None and self.practice is None:
            raise ValueError("practice_place needs a practice")
        if len(self.blocks) % len(self.places) and len(self.places) > 1:
            raise ValueError(
                f"{len(self.places)} places for {len(self.blocks)} blocks; expected one place, as "
                "many as blocks, or "
                "a divisor of the number of blocks, so that each place is used equally often"
            )
        return self
