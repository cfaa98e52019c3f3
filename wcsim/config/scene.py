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

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]  # letters, digits, _ and -
    split: Literal["train", "test", "scene"]  # what it may be used for; train and test refuse each other's towns
    origin_m: tuple[NetMetre, NetMetre] = (0, 0)  # net coordinates of W's origin; else that of a far net is its middle
    kerb_height_m: Annotated[float, Field(ge=0.0, le=0.4)] = 0.12  # of pavements above the carriageway
    lowered_kerb_m: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0  # where it is lowered: at crossings, and by the map
    chair_ways: Annotated[tuple[ChairWay, ...], Field(max_length=16)] = (  # where users drive
        "sidewalk", "crossing", "shared",
    )  # fmt: skip
    warmup_s: Annotated[float, Field(ge=0.0, le=3600.0)] | None = None  # before the usual world.warmup_s, not a set one
    sumocfg: Text = ""  # where the scenario lies, when it is not the only .sumocfg beside this file
    source: Text = ""  # of its map
    attribution: Text = ""  # that pictures of it have to carry
    rebuild: Text = ""  # the command that makes the town again from what its folder holds
    hashes: Annotated[dict[Text, Word], Field(max_length=4096)] = Field(default_factory=dict)  # of its files, by name


class SceneSeat(Model):
    """Where a scene puts a wheelchair and what drives it: a user with a goal, a stick that is held, or a script."""

    start_m: tuple[Finite, Finite]  # net coordinates
    heading_deg: Finite  # SUMO's: clockwise from north
    goal_m: tuple[Finite, Finite] | None = None  # net coordinates
    profile: Text = "competent"  # of the simulated user who drives to the goal
    recording: FileName | None = None  # of a joystick, a .csv file beside this one: drives in the place of a profile
    joystick: tuple[Stick, Stick] | None = None  # held throughout: right, forward
    script: Annotated[tuple[ScriptStep, ...], Field(max_length=4096)] = ()  # rows of seconds, right, forward

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
    """What a scene must show, over all its seats: lowest and highest value that is right; left out where it is free."""

    crashed: bool | None = None  # whether any chair crashed
    arrivals: Window | None = None  # chairs that reached their goals
    travelled_m: Window | None = None  # way that all chairs drove together
    climb_m: Window | None = None  # the highest rise of a chair above the height it started at
    drop_m: Window | None = None  # the deepest fall below it
    rolled_back_m: Window | None = None  # the longest way that a chair went backwards in one go
    aside_m: Window | None = None  # how far a chair left the straight line from its start to its goal, or ahead
    narrowest_m: Window | None = None  # free width of the pavement across a chair, where it was smallest
    max_roll_deg: Window | None = None  # the most that a chair leaned to a side
    max_pitch_deg: Window | None = None  # the most that a chair leaned ahead or back
    jolt_mps2: Window | None = None  # the largest acceleration that an IMU felt
    standing_s: Window | None = None  # time that chairs stood still before they arrived
    red_starts: Window | None = None  # how often a chair drove onto a crossing whose light was not green
    green_starts: Window | None = None  # how often one drove onto a crossing with green
    closest_actor_m: Window | None = None  # smallest gap between the boxes of a chair and of anything else that moves
    closest_vehicle_m: Window | None = None  # the same by kind: cars, buses, trams and the like
    closest_rider_m: Window | None = None  # cyclists, scooters, motorcyclists
    closest_person_m: Window | None = None  # people on foot
    closest_chair_m: Window | None = None  # other wheelchairs
    overtaken: Window | None = None  # others that came up behind a chair and ended ahead of it
    slowest_mps: Window | None = None  # the lowest speed of a vehicle near a chair, after it has driven
    gave_way: Window | None = None  # vehicles that braked to less than walking pace near a chair
    went_on: Window | None = None  # of those, how many drove on
    made_way_m: Window | None = None  # the farthest that a person stepped aside
    actors_seen: Window | None = None  # others that came near a chair

    @model_validator(mode="after")
    def _windows_are_open(self) -> SceneExpect:
        for name in type(self).model_fields:
            window = getattr(self, name)
            if isinstance(window, tuple) and window[0] > window[1]:
                raise ValueError(f"{name} is [{window[0]:g}, {window[1]:g}]; expected the lower bound first")
        return self


class SceneFile(Model):
    """`scene.toml`: a short street scene; `[[seats]]` and `[expect]` are tables of their own."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]  # letters, digits, _ and -
    shows: Text  # what it is about, in a sentence
    seed: Annotated[int, Field(ge=0, lt=1 << 31)]  # of traffic and users
    duration_s: Annotated[float, Field(ge=0.1, le=60.0)]  # simulated, after the warm-up
    kerb_height_m: Annotated[float, Field(ge=0.0, le=0.4)] = 0.12  # of pavements above the carriageway
    lefthand: bool = False  # whether traffic keeps left
    warmup_s: Annotated[float, Field(ge=0.0, le=600.0)] = 0.0  # traffic that SUMO drives before the first step
    attention_share: Share = 1.0  # of drivers, riders and walkers who look for wheelchairs
    seats: Annotated[tuple[SceneSeat, ...], Field(min_length=1, max_length=64)]
    expect: SceneExpect = SceneExpect()
