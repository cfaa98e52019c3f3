"""Section `[danger]`: the danger head, how it learns and how its numbers become actions (`learn.head = "danger"`)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from wcsim.config.base import Model, NotNegative, Positive, Share


def _named_gaps(value: Any) -> Any:
    """What files of before said with true and false."""
    return {True: "rival", False: "none"}[value] if isinstance(value, bool) else value


Gaps = Annotated[Literal["rival", "map", "none"], BeforeValidator(_named_gaps)]
"""From what the numbers of each action are made: the rival's senses, the network's own street map, or not at all."""


class DangerConfig(Model):
    """The danger network: its parts, its training, and its rule."""

    eye: Literal["map", "picture", "both"] = "map"  # Input: the street map, camera images (`learn.network`), or both.
    memory: bool = True  # Whether the street map persists. False: it is cleared every tick.
    odometry: bool = True  # Whether it reads wheel odometry. False: speed from commands, turns from the gyroscope.
    roll_out: bool = True  # Whether it reads cost maps along each action's path.
    gaps: Gaps = "rival"  # Source of clearance features of each action: dwa's map (rival), its own map, or none.
    rival: bool = True  # Whether the map of `dwa` is an input.
    context: bool = True  # Whether the whole street map is an input.
    width: Annotated[int, Field(ge=4, le=256)] = 20  # Channels of the first layer.
    updates: Annotated[int, Field(ge=1, le=10**7)] = 1500  # Updates in a round.
    batch: Annotated[int, Field(ge=2, le=4096)] = 64  # Steps in a batch.
    learning_rate: Positive = 2e-3  # Learning rate of Adam.
    weight_decay: NotNegative = 1e-3  # Weight decay of Adam.
    tight_share: Share = 0.5  # Share of a batch from steps with an unsafe action.
    ahead: Annotated[int, Field(ge=0, le=20)] = 1  # Steps before danger in which an action already counts as unsafe.
    teacher: Annotated[str, Field(pattern="^(visible|truth)$")] = (
        "visible"  # Labels from an oracle limited to what cameras showed (visible), or all-knowing (truth).
    )
    threshold: Annotated[float, Field(gt=0.0, le=1.0)] = (
        0.2  # Assistance level. Actions with a higher danger are blocked.
    )
    keep: NotNegative = 0.2  # Bonus of the last action, as joystick distance, if the user's action is blocked.
    lenient: Positive = 1.3  # Factor on the threshold for the last action.
    shy: NotNegative = 0.1  # Cost of a danger at the threshold, as joystick distance, if the user's action is blocked.
    at_once: Share = 0.0  # Danger that blocks the user's action in one tick. Below it two in a row do. 0: always one.
    doubt: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0  # Factor on the threshold for actions that `dwa` rejects.
    trust: Annotated[float, Field(ge=1.0, le=10.0)] = (
        1.0  # Factor on the threshold for actions that `dwa` accepts. If both are 1, `dwa` is not used.
    )
    caution: Annotated[float, Field(ge=0.0, le=2.0)] = 1.0  # Assistance level of that `dwa`, from 0 to 2.
    warn: Share = 0.3  # Warns above this danger of the user's own stick, smoothed over about three ticks.
