"""Section `[vary]`: what differs from episode to episode, as ranges; what is missing stays as it is set elsewhere."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, Field, model_validator

from wcsim.config.base import Finite, Model, Share, Word

Number = TypeVar("Number", int, float)


def _ordered(span: tuple[Number, Number]) -> tuple[Number, Number]:
    low, high = span
    if low > high:
        raise ValueError(f"the range runs from {low} to {high}; expected [low, high] with low <= high")
    return span


Range = Annotated[tuple[Number, Number], AfterValidator(_ordered)]
Factor = Annotated[float, Field(ge=0.05, le=2.0)]
Brightness = Annotated[float, Field(ge=0.1, le=4.0)]
UserMass = Annotated[float, Field(ge=25.0, le=150.0)]
Shift = Annotated[float, Field(ge=-0.5, le=0.5)]
Turn = Annotated[float, Field(ge=-45.0, le=45.0)]
Delay = Annotated[int, Field(ge=0, le=10)]
Span = Range[Finite]
Reaction = Annotated[float, Field(ge=0.0, le=60.0)]
Driver = Literal["car", "truck", "bus", "tram", "motorcycle", "bicycle", "scooter", "other"]
Watcher = Literal[Driver, "pedestrian"]
EVERYBODY = "all"  # who has no range of its own
Shares = Annotated[dict[Literal[Watcher, "all"], Range[Share]], Field(max_length=16)]
Reactions = Annotated[dict[Literal[Driver, "all"], Range[Reaction]], Field(max_length=16)]
Spans = Annotated[dict[Word, Span], Field(max_length=64)]  # by dotted names


class VaryConfig(Model):
    """Ranges [low, high] for domain randomisation, drawn for every episode and seat. "none" removes a range."""

    light: Range[Brightness] | None = None  # Factor on the brightness of colour images.
    friction: Range[Factor] | None = None  # Factor on the friction of wheels and casters.
    user_mass_kg: Range[UserMass] | None = None  # Mass of the user.
    camera_shift_m: Range[Shift] | None = None  # Shift of each camera along x, y and z.
    camera_turn_deg: Range[Turn] | None = None  # Rotation of each camera in yaw and pitch.
    action_delay_ticks: Range[Delay] | None = None  # Delay of actions.
    plant: Spans = Field(default_factory=dict)  # Any number of the plant's file, by dotted name.
    sensors: Annotated[Spans, Field(exclude_if=lambda spans: not spans)] = Field(
        default_factory=dict
    )  # Any number of a sensor, by section.key.
    attention: Shares = Field(default_factory=dict)  # Share of road users who look for this chair, by class.
    reaction: Reactions = Field(default_factory=dict)  # Reaction time in seconds, by class.

    @model_validator(mode="before")
    @classmethod
    def _none_by_name(cls, data: Any) -> Any:
        return {} if data == "none" else data

    @property
    def nothing(self) -> bool:
        """Whether every episode is like the others."""
        return self == VaryConfig()
