"""Section `[world]`: town, step, and how the others watch out."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from wcsim.config.base import Model, Share
from wcsim.config.randomization import Driver, Reaction, Watcher

STREETS: dict[str, tuple[float, float] | None] = {"usual": None, "careless": (0.7, 1.5)}
"""Streets by name: the share of those who look and their reaction time in seconds; None: as the settings say."""


EPOCH_TICKS = 6_000
"""Ticks of an epoch: as many as a world does again from its journal within five minutes (docs/clients.md)."""

EPOCH_GROWTH_MB = 1_000.0
"""What a world's process may grow by in an epoch."""

SUMO_STEP_S = 0.001
"""What SUMO counts time in; it rounds every other step to it."""

_USUAL_HZ, _CONTACT_HZ = 120.0, 240.0


class WorldConfig(Model):
    """Clocks, mirror and street reaction."""

    tick_s: Annotated[float, Field(ge=0.02, le=1.0)] = (
        0.1  # a step of the world, in whole milliseconds; SUMO and the action take one each
    )
    substeps: Annotated[int, Field(ge=1, le=480)] | None = None  # of the physics, in a tick; None: 120 a second
    contact_substeps: Annotated[int, Field(ge=1, le=480)] | None = None  # where something is met; None: 240
    warmup_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 240.0  # traffic that SUMO drives before the first step
    town_warmup: Annotated[bool, Field(exclude_if=lambda on: on)] = (
        True  # a town's own `warmup_s` counts before this one; false where somebody sets `warmup_s`
    )
    demand_scale: Annotated[float, Field(ge=0.0, le=10.0)] = 1.0  # of the town's own traffic
    mirror_radius_m: Annotated[float, Field(ge=5.0, le=300.0)] = 50.0  # around a chair: who is drawn and may react
    jam_teleport_s: Annotated[float, Field(ge=-1.0, le=36000.0)] | None = None  # None keeps the scenario's own
    action_step_s: Annotated[float, Field(ge=0.02, le=10.0)] | None = (
        None  # how often SUMO's drivers decide: a multiple of tick_s
    )
    street: Literal["usual", "careless"] = "usual"  # a careless one sets the next two
    attention_share: Share = 0.95  # of the others who look at the chair
    reaction_s: Reaction = 0.7  # from seeing it to braking
    attention: Annotated[dict[Watcher, Share], Field(max_length=16)] = Field(default_factory=dict)  # by class
    reaction: Annotated[dict[Driver, Reaction], Field(max_length=16)] = Field(default_factory=dict)  # seconds, by class
    brake_mps2: Annotated[float, Field(gt=0.0, le=100.0)] = 4.5  # that drivers and cyclists plan to brake with
    clear_spawn_m: Annotated[float, Field(gt=0.0, le=1000.0)] = 2.0  # kept free around a chair that appears
    crossing_share: Share = 0.5  # of destinations that are drawn beyond a crossing nearby
    button: bool = True  # a chair that stands at a red crossing of its route asks for green
    button_after_s: Annotated[float, Field(ge=0.0, le=600.0)] = 2.0  # of standing there
    action_delay_ticks: Annotated[int, Field(ge=0, le=10)] = 0  # from an action to the chair that obeys it
    visible_px: Annotated[float, Field(ge=1.0, le=76800.0)] = 16.0  # of 320x240, from which on an actor is visible
    visible_s: Annotated[float, Field(ge=0.0, le=60.0)] = 1.0  # for which it stays known when it is not any more
    epoch_ticks: Annotated[int, Field(ge=0, le=10**9, exclude_if=lambda ticks: ticks == EPOCH_TICKS)] = (
        EPOCH_TICKS  # after which a shared world is replaced by a fresh one; 0: never
    )
    epoch_growth_mb: Annotated[float, Field(ge=10.0, le=10**6, exclude_if=lambda mb: mb == EPOCH_GROWTH_MB)] = (
        EPOCH_GROWTH_MB  # of memory that its process may take in an epoch, before it is replaced
    )
    draw_threads: Annotated[int, Field(ge=0, le=64)] = 0  # for the cameras' pictures; 0: as many as there are cores

    @model_validator(mode="after")
    def _substep_is_sane(self) -> WorldConfig:
        for name, substeps in (("substeps", self.usual_substeps), ("contact_substeps", self.finest_substeps)):
            substep_s = self.tick_s / substeps
            if not 1 / 1000 <= substep_s <= 1 / 100:
                raise ValueError(
                    f"tick_s {self.tick_s} / {name} {substeps} gives a physics step of {substep_s:.5f} s; "
                    f"expected 0.001 to 0.01 s: change world.{name}"
                )
        return self

    @model_validator(mode="after")
    def _tick_is_one_of_sumos(self) -> WorldConfig:
        if not _is_whole(self.tick_s / SUMO_STEP_S):
            rounded_s = round(self.tick_s / SUMO_STEP_S) * SUMO_STEP_S
            raise ValueError(
                f"tick_s is {self.tick_s} s, and SUMO knows whole milliseconds alone: its clock would run apart from "
                f"that of the chairs; expected such a time: {rounded_s:g}"
            )
        return self

    @model_validator(mode="after")
    def _drivers_decide_in_ticks(self) -> WorldConfig:
        ticks = 1.0 if self.action_step_s is None else self.action_step_s / self.tick_s
        if ticks < 1.0 - 1e-6 or not _is_whole(ticks):
            raise ValueError(
                f"action_step_s is {self.action_step_s} s with a tick_s of {self.tick_s} s, and SUMO's drivers decide "
                f"in whole steps alone; expected a multiple of tick_s: {max(1, round(ticks)) * self.tick_s:g}"
            )
        return self

    @property
    def usual_substeps(self) -> int:
        """Steps of the physics in most ticks."""
        return _steps(self.tick_s, _USUAL_HZ) if self.substeps is None else self.substeps

    @property
    def finest_substeps(self) -> int:
        """Steps in a tick in which a wheel is about to meet an edge; never fewer than in the others."""
        fine = _steps(self.tick_s, _CONTACT_HZ) if self.contact_substeps is None else self.contact_substeps
        return max(self.usual_substeps, fine)


def _is_whole(number: float) -> bool:
    return abs(number - round(number)) < 1e-6


def _steps(tick_s: float, hz: float) -> int:
    """The fewest steps of a tick at this rate or a faster one."""
    return math.ceil(tick_s * hz - 1e-9)
