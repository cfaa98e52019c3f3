"""Section `[danger]`: the danger head, how it learns and how its numbers become actions (`learn.head = "danger"`)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from wcsim.config.base import Model, NotNegative, Positive, Share


class DangerConfig(Model):
    """The danger network: its parts, its training, and its rule."""

    eye: Literal["map", "picture", "both"] = "map"  # Input: the street map, camera images (`learn.network`), or both.
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
    at_once: Share = 0.0  # Danger that blocks the user's action in one tick. Below it two in a row do. 0: always one.
    warn: Share = 0.3  # Warns above this danger of the user's own stick, smoothed over about three ticks.
