"""`town.toml` of a town, and `scene.toml`: a short scene with a fixed seed and expected results."""

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from wcsim.config.base import Finite, Model, Name, NotNegative, Seed, Share, Text, Word, within
from wcsim.config.world import StreetName

Stick = Annotated[float, within(-1.0, 1.0)]
Window = tuple[Finite, Finite]
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}\.csv$")]
ScriptStep = tuple[NotNegative, Stick, Stick]  # from this second on: right, forward
KerbHeight = Annotated[float, within(0.0, 0.4)]
ChairWay = Literal["sidewalk", "crossing", "cycleway", "shared"]
NetMetre = Annotated[int, Field(ge=-(10**9), le=10**9)]

_Between = Window | None


class TownFile(Model):
    """`town.toml`: what SUMO does not store about a town."""

    name: Name  # Letters, digits, _ and -.
    # Use of the town. train and test refuse each other's towns.
    split: Literal["train", "test", "scene"]
    # Net coordinates of the world's origin. Far nets: the middle of the net.
    origin_m: tuple[NetMetre, NetMetre] = (0, 0)
    kerb_height_m: KerbHeight = 0.12  # Height of pavements above the road.
    # Height of lowered kerbs, at crossings and where the map has them.
    lowered_kerb_m: Annotated[float, within(0.0, 0.1)] = 0.0
    # Ways that users drive on.
    chair_ways: Annotated[tuple[ChairWay, ...], Field(max_length=16)] = (
        "sidewalk", "crossing", "shared",
    )  # fmt: skip
    # Time that SUMO simulates before the first step, unless you set world.warmup_s.
    warmup_s: Annotated[float, within(0.0, 3600.0)] | None = None
    sumocfg: Text = ""  # Path of the scenario, if it is not the only .sumocfg here.
    source: Text = ""  # Source of the map.
    attribution: Text = ""  # Attribution that pictures of the town must show.
    rebuild: Text = ""  # Command that builds the town again from its folder.
    # SHA-256 of its files, by name.
    hashes: Annotated[dict[Text, Word], Field(max_length=4096)] = Field(default_factory=dict)


class SceneSeat(Model):
    """A wheelchair of the scene. A user with a goal, a fixed stick or a script drives it."""

    start_m: tuple[Finite, Finite]  # Start in net coordinates.
    heading_deg: Finite  # Heading as in SUMO, clockwise from north.
    goal_m: tuple[Finite, Finite] | None = None  # Goal in net coordinates.
    profile: Text = "competent"  # Simulated user who drives to the goal.
    # Recorded joystick instead of a profile: a .csv file in this folder.
    recording: FileName | None = None
    joystick: tuple[Stick, Stick] | None = None  # Constant stick: right, forward.
    # Rows of seconds, right, forward.
    script: Annotated[tuple[ScriptStep, ...], Field(max_length=4096)] = ()

    @model_validator(mode="after")
    def _is_driven_by_one(self) -> Self:
        driven = [self.goal_m is not None, self.joystick is not None, bool(self.script)]
        if sum(driven) != 1:
            raise ValueError(
                "a seat is driven by exactly one of goal_m (with a profile or a recording), "
                "joystick and script"
            )
        if self.recording is not None and (
            self.goal_m is None or "profile" in self.model_fields_set
        ):
            raise ValueError("a recording needs a goal_m and no profile")
        times_s = [step[0] for step in self.script]
        if any(later <= sooner for sooner, later in pairwise(times_s)):
            raise ValueError(f"the times of script must rise, got {times_s}")
        return self


class SceneExpectations(Model):
    """Expected results over all seats, as lowest and highest value.

    A missing key is not checked.
    """

    crashed: bool | None = None  # Whether any chair crashed.
    arrivals: _Between = None  # Chairs that reached their goals.
    travelled_m: _Between = None  # Distance that all chairs drove together.
    climb_m: _Between = None  # Highest rise of a chair above its start.
    drop_m: _Between = None  # Deepest fall of a chair below its start.
    rolled_back_m: _Between = None  # Longest distance that a chair rolled back at once.
    aside_m: _Between = None  # Distance of a chair from the straight line to its goal, or ahead.
    narrowest_m: _Between = None  # Smallest free width of the pavement across a chair.
    max_roll_deg: _Between = None  # Largest roll of a chair.
    max_pitch_deg: _Between = None  # Largest pitch of a chair.
    jolt_mps2: _Between = None  # Largest acceleration of an IMU.
    standing_s: _Between = None  # Time that chairs stood before they arrived.
    red_starts: _Between = None  # Times that a chair entered a crossing without green.
    green_starts: _Between = None  # Times that a chair entered a crossing at green.
    closest_actor_m: _Between = None  # Smallest gap between a chair and any road user.
    closest_vehicle_m: _Between = None  # Smallest gap to a car, bus, tram or similar.
    closest_rider_m: _Between = None  # Smallest gap to a cyclist, scooter or motorcyclist.
    closest_person_m: _Between = None  # Smallest gap to a pedestrian.
    closest_chair_m: _Between = None  # Smallest gap to another wheelchair.
    overtaken: _Between = None  # Road users that overtook a chair.
    slowest_mps: _Between = None  # Lowest speed of a vehicle near a chair, once it moved.
    gave_way: _Between = None  # Vehicles that slowed below walking pace near a chair.
    went_on: _Between = None  # Number of those that drove on.
    made_way_m: _Between = None  # Largest distance that a pedestrian stepped aside.
    actors_seen: _Between = None  # Road users that came near a chair.

    @model_validator(mode="after")
    def _windows_are_open(self) -> Self:
        for name in type(self).model_fields:
            window = getattr(self, name)
            if isinstance(window, tuple) and window[0] > window[1]:
                raise ValueError(
                    f"{name} is [{window[0]:g}, {window[1]:g}]; expected the lower bound first"
                )
        return self


class SceneFile(Model):
    """`scene.toml`: a short street scene. `[[seats]]` and `[expect]` are separate tables."""

    name: Name  # Letters, digits, _ and -.
    shows: Text  # What the scene is about, in a sentence.
    seed: Seed  # Seed of traffic and users.
    duration_s: Annotated[float, within(0.1, 60.0)]  # Simulated time after the warm-up.
    kerb_height_m: KerbHeight = 0.12  # Height of pavements above the road.
    lefthand: bool = False  # Whether traffic keeps left.
    # Time that SUMO simulates before the first step.
    warmup_s: Annotated[float, within(0.0, 600.0)] = 0.0
    attention_share: Share = 1.0  # Share of road users who look for wheelchairs.
    street: StreetName = "usual"  # Street as in world.street.
    seats: Annotated[tuple[SceneSeat, ...], Field(min_length=1, max_length=64)]
    expect: SceneExpectations = SceneExpectations()
