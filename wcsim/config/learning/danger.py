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
    """The network's parts, its supervised learning, and its rule."""

    eye: Literal["map", "picture", "both"] = "map"  # the street map, the camera's pictures (`learn.network`), or both
    memory: bool = True  # false: the street map, its trail and the rival's street are forgotten every tick
    odometry: bool = True  # false: no wheel odometry; speed is reckoned from the commands, turns from the turn rates
    roll_out: bool = True  # cost maps, read along each action's way
    gaps: Gaps = "rival"  # how near to what each action comes
    rival: bool = True  # what the rival remembers of the street, as planes of the street map
    context: bool = True  # the street map as a whole
    width: Annotated[int, Field(ge=4, le=256)] = 20  # channels of its first layer
    updates: Annotated[int, Field(ge=1, le=10**7)] = 1500  # of a round
    batch: Annotated[int, Field(ge=2, le=4096)] = 64  # steps in an update
    learning_rate: Positive = 2e-3  # Adam's
    weight_decay: NotNegative = 1e-3  # Adam's
    tight_share: Share = 0.5  # of a batch, from steps in which something is unsafe
    ahead: Annotated[int, Field(ge=0, le=20)] = 1  # an action is unsafe already, so many steps before it is
    teacher: Annotated[str, Field(pattern="^(visible|truth)$")] = "visible"  # oracle: blinded, or (truth) all-knowing
    threshold: Annotated[float, Field(gt=0.0, le=1.0)] = 0.2  # the assistance level: what is more dangerous is out
    keep: NotNegative = 0.2  # joystick distance by which the last action is nearer, where the user's own is not safe
    lenient: Positive = 1.3  # times the threshold for the last action
    shy: NotNegative = 0.1  # joystick distance that a danger of the whole threshold is worth, there too
    at_once: Share = 0.0  # danger from which one tick takes the user's own away; below it two in a row do; 0: one
    doubt: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0  # times the threshold for what `dwa` holds for unsafe
    trust: Annotated[float, Field(ge=1.0, le=10.0)] = 1.0  # and for what `dwa` would take; 1 and 1: it is not asked
    caution: Annotated[float, Field(ge=0.0, le=2.0)] = 1.0  # the level of that `dwa`
    warn: Share = 0.3  # the danger of the user's own stick, over about three ticks, above which it warns
