"""A suite of test episodes, as it lies in a file: frozen models, every field with its bounds."""

from typing import Annotated, Final, Self

from pydantic import Field, model_validator

from wcsim.config.base import Finite, Model, NotNegative, Seed, Text, Texts, within
from wcsim.config.env import EpisodeSteps
from wcsim.config.run_file import Sha256

MOST_SEATS: Final = 12
# Characters of a list's name, and of that of its set.
MOST_NAME: Final = 64
MOST_SET: Final = 32
# Such as free, crossing, or a town and its user.
Part = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ,.-]{0,127}$")]


def make_suite_name_pattern(most: int) -> str:
    """What the name of a list or a set is like that has at most so many characters."""
    return rf"^[a-z0-9][a-z0-9-]{{0,{most - 1}}}$"


class SuiteEpisode(Model):
    """One way of one wheelchair."""

    # In W. None where the block's world draws it, and one goal after the other.
    start_m: tuple[Finite, Finite] | None
    heading_rad: Finite
    goal_m: tuple[Finite, Finite] | None  # W; None as the start is
    profile: Text  # of the user
    max_steps: EpisodeSteps
    route_m: NotNegative  # from start to goal
    reference_s: Annotated[float, Field(gt=0.0, le=1e6)]  # the way's time with nothing to hinder it
    handover_step: Annotated[int, within(0, 1_000_000)] = 0  # until here the user drives alone

    @model_validator(mode="after")
    def _is_given_or_drawn(self) -> Self:
        if (self.start_m is None) is not (self.goal_m is None):
            raise ValueError(
                "an episode has both start_m and goal_m, or null for both, which draws them"
            )
        return self


class SuiteBlock(Model):
    """Some episodes that share a world, a chair each."""

    part: Part
    town: Text  # its name; of a generated scene its family
    scene_sha256: Sha256 | None = None  # of a generated scene's files
    seed: Seed  # of the world; of a generated scene its own
    settings: Texts = ()  # section.key=value, over those of the suite
    episodes: Annotated[tuple[SuiteEpisode, ...], Field(min_length=1, max_length=MOST_SEATS)]


class SuiteRecipe(Model):
    """What a list is drawn from; with towns and a seed it gives the same list again."""

    # Its name, with its version.
    suite: Annotated[str, Field(pattern=make_suite_name_pattern(MOST_NAME))]
    # Blocks of up to six ways along pavements, and over crossings, for each town.
    free: Annotated[int, within(0, 10_000)] = 0
    crossings: Annotated[int, within(0, 10_000)] = 0
    # Ways on which the user alone crashes, for each town.
    hazards: Annotated[int, within(0, 10_000)] = 0
    # Users of all of these, in turn.
    profiles: Annotated[Texts, Field(min_length=1)]
    # Generated scenes by family.
    scenes: dict[Text, Annotated[int, within(0, 10_000)]] = Field(default_factory=dict)
    # Why these: the share of a pilot's draws in which each policy crashed, by family.
    pilot: dict[Text, dict[Text, Annotated[float, Field(ge=0.0, le=1.0)]]] = Field(
        default_factory=dict
    )


class SuiteTown(Model):
    """A town that must be there as it was when the list was made."""

    name: Text
    sha256: Sha256  # of its net, traffic and furniture
    made_seed: Seed | None = None  # made of this seed by `wcsim town make`


class SuiteFile(Model):
    """The whole file; what it hashes to is the suite's identity."""

    # With its version: street-assist-v1.
    suite: Annotated[str, Field(pattern=make_suite_name_pattern(MOST_NAME))]
    set: Annotated[
        str, Field(pattern=make_suite_name_pattern(MOST_SET))
    ]  # guard, hard, or a file's
    # The only version of wcsim that has its towns; None: any that does. Not part of the identity.
    version: Text | None = None
    settings: Texts  # section.key=value, over the policy's own
    towns: Annotated[tuple[SuiteTown, ...], Field(min_length=1, max_length=64)]
    # Episodes whose interventions are judged, at most.
    forks: Annotated[int, within(0, 1_000_000)] = 1_000_000
    blocks: Annotated[tuple[SuiteBlock, ...], Field(min_length=1, max_length=100_000)]
