"""`town.toml`: what a town says of itself."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from wcsim.config.base import Model, Text, Word

ChairWay = Literal["sidewalk", "crossing", "cycleway", "shared"]

NetMetre = Annotated[int, Field(ge=-(10**9), le=10**9)]


class TownFile(Model):
    """`town.toml`: what SUMO does not know about a town."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    split: Literal["train", "test", "scene"]
    origin_m: tuple[NetMetre, NetMetre] = (0, 0)  # net coordinates of W's origin
    kerb_height_m: Annotated[float, Field(ge=0.0, le=0.4)] = 0.12
    lowered_kerb_m: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    chair_ways: Annotated[tuple[ChairWay, ...], Field(max_length=16)] = ("sidewalk", "crossing", "shared")
    warmup_s: Annotated[float, Field(ge=0.0, le=3600.0)] | None = None
    sumocfg: Text = ""  # where the scenario lies, when it is not the only .sumocfg beside this file
    source: Text = ""
    attribution: Text = ""
    rebuild: Text = ""  # the command that makes the town again from what its folder holds
    hashes: Annotated[dict[Text, Word], Field(max_length=4096)] = Field(default_factory=dict)
