"""Section `[collect]`: driving that is recorded to be learned from."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from wcsim.config.base import Model, Share, Text

Count = Annotated[int, Field(ge=1, le=100_000)]


class CollectConfig(Model):
    """Driving for training data: where, by which users, and with how many perturbations."""

    rounds: Annotated[int, Field(ge=1, le=100_000)] = 2  # Rounds of driving and learning.
    segments: Annotated[int, Field(ge=0, le=100_000)] = (
        6  # Segments of driving in a round. 0: learn only from recorded data.
    )
    ticks: Annotated[int, Field(ge=10, le=100_000)] = 400  # Ticks in a segment.
    chairs: Annotated[int, Field(ge=1, le=12)] = 6  # Chairs in its world.
    episode_steps: Count = 300  # Longest episode.
    towns: Annotated[tuple[Text, ...], Field(max_length=64)] = ()  # Towns used in turn with those of --town.
    made_towns: Annotated[int, Field(ge=0, le=1000)] = (
        0  # Number of towns that `wcsim town make` generates for this run.
    )
    data: Annotated[tuple[Text, ...], Field(max_length=64)] = ()  # Folders of `wcsim collect` to learn from as well.
    scene_share: Share = 0.3  # Share of segments in generated scenes: hidden road users and narrow places.
    profiles: Annotated[tuple[Text, ...], Field(min_length=1, max_length=64)] = (  # Simulated users to draw from.
        "inattentive", "tremor", "slow", "competent", "switch",
    )  # fmt: skip
    variants: Annotated[tuple[Text, ...], Field(max_length=64)] = ()  # Settings separated by blanks, drawn per segment.
    follow_share: Share = (
        0.4  # Of episodes without the network: share that the user drives. The oracle drives the rest.
    )
    network_share: Share = 0.75  # Share of episodes that the network drives, once there is one.
    astray_share: Share = 0.33  # Share of time with a random offset on the stick.
