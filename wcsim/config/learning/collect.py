"""Section `[collect]`: driving that is recorded to be learned from."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from wcsim.config.base import Model, Positive, Share, Text

Count = Annotated[int, Field(ge=1, le=100_000)]
Held = Annotated[int, Field(ge=1, le=1000)]


class CollectConfig(Model):
    """What is driven, by whom, and how far from the way that a careful user takes."""

    rounds: Annotated[int, Field(ge=0, le=100_000)] = 0  # 0: none, it learns from every step as it drives
    segments: Annotated[int, Field(ge=0, le=100_000)] = 6  # of a round; 0: learn from recorded driving alone
    ticks: Annotated[int, Field(ge=10, le=100_000)] = 400  # of a segment
    chairs: Annotated[int, Field(ge=1, le=12)] = 6  # in its world
    episode_steps: Count = 300  # longest episode
    towns: Annotated[tuple[Text, ...], Field(max_length=64)] = ()  # beside the run's own, in turn
    made_towns: Annotated[int, Field(ge=0, le=1000)] = 0  # drawn by `wcsim town make` for this run, in turn
    data: Annotated[tuple[Text, ...], Field(max_length=64)] = ()  # folders of `wcsim collect`, learned from as well
    scene_share: Share = 0.3  # of the segments, in generated scenes: blind sides and tight places
    profiles: Annotated[tuple[Text, ...], Field(min_length=1, max_length=64)] = (  # users, drawn
        "inattentive", "tremor", "slow", "competent", "switch",
    )  # fmt: skip
    variants: Annotated[tuple[Text, ...], Field(max_length=64)] = ()  # drawn for each segment; blanks part its settings
    follow_share: Share = 0.4  # of the episodes that no network drives; the blinded oracle drives the others
    network_share: Share = 0.75  # of the episodes, as soon as there is one
    astray_share: Share = 0.33  # of the time, an offset is laid over the stick
    astray_sigma: Positive = 0.5  # spread of the offset, in stick units
    astray_ticks: tuple[Held, Held] = (4, 12)  # it is held for so long
    reckless_share: Share = 0.4  # of these offsets, carried out as they are

    @model_validator(mode="after")
    def _ticks_are_ordered(self) -> Self:
        low, high = self.astray_ticks
        if low > high:
            raise ValueError(f"astray_ticks runs from {low} to {high}; expected [low, high]")
        return self
