"""Sections `[world]` and `[vary]`: clock, traffic, attention, and what varies by episode."""

import math
from typing import Annotated, Any, Final, Literal, Self, TypeVar

from pydantic import AfterValidator, Field, model_validator

from wcsim.config.base import Finite, Model, Share, UserMass, Word, exclude_if, within

Number = TypeVar("Number", int, float)

Factor = Annotated[float, within(0.05, 2.0)]
Brightness = Annotated[float, within(0.1, 4.0)]
Shift = Annotated[float, within(-0.5, 0.5)]
Turn = Annotated[float, within(-45.0, 45.0)]
Delay = Annotated[int, within(0, 10)]
Reaction = Annotated[float, within(0.0, 60.0)]
Driver = Literal["car", "truck", "bus", "tram", "motorcycle", "bicycle", "scooter", "other"]
Watcher = Literal[Driver, "pedestrian"]
# Of road users without a range of their own.
EVERYBODY: Final = "all"
JUPEDSIM: Final = "jupedsim"
"""The street whose people walk by SUMO's JuPedSim, as SUMO calls that model."""
STREETS: Final[dict[str, tuple[float, float] | None]] = {
    "usual": None,
    "careless": (0.7, 1.5),
    JUPEDSIM: None,
}
"""Streets by name: attention share and reaction time in seconds; None: those of the settings."""
StreetName = Literal["usual", "careless", "jupedsim"]
EPOCH_TICKS: Final = 6_000
"""Ticks of an epoch: a world repeats as many from its journal in five minutes (docs/clients.md)."""
SUMO_STEP_S: Final = 0.001
"""What SUMO counts time in; it rounds every other step to it."""
HELP_S: Final = 10.0
"""How long a request for help raises the assistance."""
# At the usual rate a kerb of 20 mm is felt a third too weakly, and a car sinks 7 cm into a chair.
# So ticks with a contact ahead have the other rate (ADR 11).
_USUAL_HZ: Final = 120.0
_CONTACT_HZ: Final = 240.0


def _ordered(span: tuple[Number, Number]) -> tuple[Number, Number]:
    low, high = span
    if low > high:
        raise ValueError(
            f"the range runs from {low} to {high}; expected [low, high] with low <= high"
        )
    return span


Range = Annotated[tuple[Number, Number], AfterValidator(_ordered)]
Span = Range[Finite]
Shares = Annotated[dict[Literal[Watcher, "all"], Range[Share]], Field(max_length=16)]
Reactions = Annotated[dict[Literal[Driver, "all"], Range[Reaction]], Field(max_length=16)]
Spans = Annotated[dict[Word, Span], Field(max_length=64)]  # by dotted names


class VaryConfig(Model):
    """Ranges [low, high] for domain randomisation, drawn for every episode and seat.

    "none" removes a range.
    """

    light: Range[Brightness] | None = None  # Factor on the brightness of colour images.
    friction: Range[Factor] | None = None  # Factor on the friction of wheels and casters.
    user_mass_kg: Range[UserMass] | None = None  # Mass of the user.
    camera_shift_m: Range[Shift] | None = None  # Shift of each camera along x, y and z.
    camera_turn_deg: Range[Turn] | None = None  # Rotation of each camera in yaw and pitch.
    action_delay_ticks: Range[Delay] | None = None  # Delay of actions.
    plant: Spans = Field(default_factory=dict)  # Any number of the plant's file, by dotted name.
    # Any number of a sensor, by section.key.
    sensors: Annotated[Spans, exclude_if({})] = Field(default_factory=dict)
    # Share of road users who look for this chair, by class.
    attention: Shares = Field(default_factory=dict)
    reaction: Reactions = Field(default_factory=dict)  # Reaction time in seconds, by class.

    @model_validator(mode="before")
    @classmethod
    def _none_by_name(cls, data: Any) -> Any:
        return {} if data == "none" else data

    @property
    def nothing(self) -> bool:
        """Whether every episode is like the others."""
        return self == VaryConfig()


class WorldConfig(Model):
    """Clock, traffic, and how road users react to a chair."""

    # Length of a world step, in whole milliseconds. SUMO and each action take one step.
    tick_s: Annotated[float, within(0.02, 1.0)] = 0.1
    # Physics steps per tick. Without a value: 120 per second, and 240 with a contact ahead.
    substeps: Annotated[int, within(1, 480)] | None = None
    # Time that SUMO simulates before the first step. Without a value: the town's own, or 240.
    warmup_s: Annotated[float, within(0.0, 3600.0)] | None = None
    demand_scale: Annotated[float, within(0.0, 10.0)] = 1.0  # Factor on the town's own traffic.
    # Road users within this distance of a chair are drawn and may react.
    mirror_radius_m: Annotated[float, within(5.0, 300.0)] = 50.0
    # SUMO's time to teleport. Without a value: that of the scenario.
    jam_teleport_s: Annotated[float, within(-1.0, 36000.0)] | None = None
    # Time between decisions of SUMO's drivers, a multiple of tick_s.
    action_step_s: Annotated[float, within(0.02, 10.0)] | None = None
    # Careless sets attention_share to 0.7 at most, reaction_s to 1.5; jupedsim has people walk by
    # JuPedSim.
    street: StreetName = "usual"
    attention_share: Share = 0.95  # Share of road users who look for the chair.
    reaction_s: Reaction = 0.7  # Time from seeing the chair to braking.
    # Attention share by class of road user.
    attention: Annotated[dict[Watcher, Share], Field(max_length=16)] = Field(default_factory=dict)
    # Reaction time in seconds by class of road user.
    reaction: Annotated[dict[Driver, Reaction], Field(max_length=16)] = Field(default_factory=dict)
    crossing_share: Share = 0.5  # Share of destinations chosen beyond a nearby crossing.
    # SUMO's actuated signals give an optional green to its own persons alone: 17 of 100 users who
    # obey waited there for 130 s, and then went at red (ADR 10).
    button: bool = True  # Whether a chair that waits at a red crossing of its route requests green.
    # Delay from an action to the motion of the chair.
    action_delay_ticks: Annotated[int, within(0, 10)] = 0
    # Ticks after which a new world replaces a shared one. None: 10 episodes, at least 6,000. 0:
    # never.
    epoch_ticks: Annotated[int | None, within(0, 10**9), exclude_if(None)] = None
    # Time for which a request for help raises the assistance. 0: never.
    help_s: Annotated[float, within(0.0, 600.0), exclude_if(HELP_S)] = HELP_S
    # Whether requests of simulated users do so too. Without it they are only counted.
    help_users: Annotated[bool, exclude_if(False)] = False
    # Whether a chair on a plane with nothing in reach rolls without the physics engine.
    rolling: Annotated[bool, exclude_if(False)] = False
    # Threads that draw camera images. 0: one per core.
    draw_threads: Annotated[int, within(0, 64)] = 0

    @model_validator(mode="after")
    def _substep_is_sane(self) -> Self:
        # The rates at which a chair can be checked, 100 to 1000 Hz (`chair_check/row.py`).
        substep_s = self.tick_s / self.usual_substeps
        if not 1 / 1000 <= substep_s <= 1 / 100:
            raise ValueError(
                f"tick_s {self.tick_s} / substeps {self.usual_substeps} gives a physics step of "
                f"{substep_s:.5f} s; expected 0.001 to 0.01 s: change world.substeps"
            )
        return self

    @model_validator(mode="after")
    def _tick_is_one_of_sumos(self) -> Self:
        if not _is_whole(self.tick_s / SUMO_STEP_S):
            rounded_s = round(self.tick_s / SUMO_STEP_S) * SUMO_STEP_S
            raise ValueError(
                f"tick_s is {self.tick_s} s, but SUMO's clock counts whole milliseconds; expected "
                f"a whole number of milliseconds, for example {rounded_s:g}"
            )
        return self

    @model_validator(mode="after")
    def _drivers_decide_in_ticks(self) -> Self:
        ticks = 1.0 if self.action_step_s is None else self.action_step_s / self.tick_s
        if ticks < 1.0 - 1e-6 or not _is_whole(ticks):
            raise ValueError(
                f"action_step_s is {self.action_step_s} s with a tick_s of {self.tick_s} s, but "
                "SUMO's drivers decide only at whole steps; expected a multiple of tick_s: "
                f"{max(1, round(ticks)) * self.tick_s:g}"
            )
        return self

    @property
    def help_ticks(self) -> int:
        """`help_s` in ticks."""
        return round(self.help_s / self.tick_s)

    @property
    def users_help_ticks(self) -> int:
        """The same for a request of a simulated user."""
        return self.help_ticks if self.help_users else 0

    @property
    def usual_substeps(self) -> int:
        """Steps of the physics in most ticks."""
        return _steps(self.tick_s, _USUAL_HZ) if self.substeps is None else self.substeps

    @property
    def finest_substeps(self) -> int:
        """Physics steps of a tick in which a wheel is about to meet an edge; the most of all."""
        return max(self.usual_substeps, _steps(self.tick_s, _CONTACT_HZ))


def _is_whole(number: float) -> bool:
    return abs(number - round(number)) < 1e-6


def _steps(tick_s: float, hz: float) -> int:
    """The fewest steps of a tick at this rate or a faster one."""
    return math.ceil(tick_s * hz - 1e-9)
