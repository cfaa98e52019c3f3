"""`town.toml`, what a town says of itself, and `scene.toml`, a short scene with a fixed seed and what it must show."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from wcsim.config.base import Finite, Model, NotNegative, Share, Text, Word

Stick = Annotated[float, Field(ge=-1.0, le=1.0)]
Window = tuple[Finite, Finite]
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}\.csv$")]
ScriptStep = tuple[NotNegative, Stick, Stick]  # from this second on: right, forward
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


class SceneSeat(Model):
    """Where a scene puts a wheelchair and what drives it: a user with a goal, a stick that is held, or a script."""

    start_m: tuple[Finite, Finite]  # net coordinates
    heading_deg: Finite  # SUMO's: clockwise from north
    goal_m: tuple[Finite, Finite] | None = None
    profile: Text = "competent"
    recording: FileName | None = None  # of a joystick, a .csv file beside this one: drives in the place of a profile
    joystick: tuple[Stick, Stick] | None = None  # right, forward
    script: Annotated[tuple[ScriptStep, ...], Field(max_length=4096)] = ()

    @model_validator(mode="after")
    def _is_driven_by_one(self) -> SceneSeat:
        driven = [self.goal_m is not None, self.joystick is not None, bool(self.script)]
        if sum(driven) != 1:
            raise ValueError(
                "a seat is driven by exactly one of goal_m (with a profile or a recording), joystick and script"
            )
        if self.recording is not None and (self.goal_m is None or "profile" in self.model_fields_set):
            raise ValueError("a recording goes with a goal_m, and without a profile")
        times_s = [step[0] for step in self.script]
        if any(later <= sooner for sooner, later in pairwise(times_s)):
            raise ValueError(f"the times of script must rise, got {times_s}")
        return self


class SceneExpect(Model):
    """What a scene must show: each window holds the lowest and highest value that is right.

    What is measured is said where `scenes/facts.py` lists it under the same names.
    """

    crashed: bool | None = None
    arrivals: Window | None = None
    travelled_m: Window | None = None
    climb_m: Window | None = None
    drop_m: Window | None = None
    rolled_back_m: Window | None = None
    aside_m: Window | None = None
    narrowest_m: Window | None = None
    max_roll_deg: Window | None = None
    max_pitch_deg: Window | None = None
    jolt_mps2: Window | None = None
    standing_s: Window | None = None
    red_starts: Window | None = None
    green_starts: Window | None = None
    closest_actor_m: Window | None = None
    closest_vehicle_m: Window | None = None
    closest_rider_m: Window | None = None
    closest_person_m: Window | None = None
    closest_chair_m: Window | None = None
    overtaken: Window | None = None
    slowest_mps: Window | None = None
    gave_way: Window | None = None
    went_on: Window | None = None
    made_way_m: Window | None = None
    actors_seen: Window | None = None

    @model_validator(mode="after")
    def _windows_are_open(self) -> SceneExpect:
        for name in type(self).model_fields:
            window = getattr(self, name)
            if isinstance(window, tuple) and window[0] > window[1]:
                raise ValueError(f"{name} is [{window[0]:g}, {window[1]:g}]; expected the lower bound first")
        return self


class SceneFile(Model):
    """The whole file."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    shows: Text
    seed: Annotated[int, Field(ge=0, lt=1 << 31)]
    duration_s: Annotated[float, Field(gt=0.0, le=60.0)]
    kerb_height_m: Annotated[float, Field(ge=0.0, le=0.4)] = 0.12
    lefthand: bool = False
    warmup_s: Annotated[float, Field(ge=0.0, le=600.0)] = 0.0
    attention_share: Share = 1.0
    seats: Annotated[tuple[SceneSeat, ...], Field(min_length=1, max_length=64)]
    expect: SceneExpect = SceneExpect()
