"""The numbers of a chair up to a tick of a film: sums that the next tick is added to, so that a jump back is exact."""

from __future__ import annotations

import math

import msgspec

from wcsim.drive.playing.film_states import FilmChair, Flag
from wcsim.supervisor.actions import MAX_DISTANCE

_ON = Flag.WARNING | Flag.INTERVENING | Flag.OVERRULED


class ChairSums(msgspec.Struct, frozen=True, array_like=True, kw_only=True):
    """Of one chair since its film began."""

    ticks: int = 0
    judged: int = 0  # ticks of which both sticks are known
    distance_sum: float = 0.0
    way_m: float = 0.0
    crashes: int = 0
    drops: int = 0
    arrivals: int = 0
    given_up: int = 0
    warnings: int = 0  # stretches of ticks, as interventions and overrules
    interventions: int = 0
    overrules: int = 0
    helps: int = 0
    ended: int = 0  # episodes
    ended_steps: int = 0  # of them
    steps: int = 0  # of the episode that is on, from a handover on
    alone: int = 0  # ticks of it before that
    on: int = 0  # flags of the tick before

    @property
    def kpi1(self) -> float | None:
        """Mean joystick distance, None where no tick is known."""
        return self.distance_sum / self.judged if self.judged else None

    @property
    def kpi2(self) -> float:
        """Mean steps that an episode lived; of the one that is on while none has ended."""
        return self.ended_steps / self.ended if self.ended else float(self.steps)

    def plus(self, chair: FilmChair, tick_s: float) -> ChairSums:
        """With one tick more; as in a test, nothing before a handover is judged."""
        flags = Flag(chair.flags)
        is_alone = Flag.ALONE in flags
        alone = (0 if chair.step == 1 else self.alone) + is_alone
        begun = flags & ~Flag(self.on)
        ends = bool(flags & (Flag.CRASHED | Flag.TRUNCATED))
        steps = chair.step - alone if chair.step >= 0 else self.steps + (not is_alone)
        gap = None if is_alone else distance(chair)
        return ChairSums(
            ticks=self.ticks + 1,
            judged=self.judged + (gap is not None),
            distance_sum=self.distance_sum + (gap or 0.0),
            way_m=self.way_m + abs(chair.speed_mps) * tick_s,
            crashes=self.crashes + bool(flags & Flag.CRASHED),
            drops=self.drops + bool(flags & Flag.DROPPED),
            arrivals=self.arrivals + bool(flags & Flag.ARRIVED),
            given_up=self.given_up + bool(flags & Flag.GAVE_UP),
            warnings=self.warnings + bool(begun & Flag.WARNING),
            interventions=self.interventions + bool(begun & Flag.INTERVENING),
            overrules=self.overrules + bool(begun & Flag.OVERRULED),
            helps=self.helps + bool(flags & Flag.HELPED),
            ended=self.ended + (ends and steps > 0),
            ended_steps=self.ended_steps + (steps if ends else 0),
            steps=0 if ends else steps,
            alone=0 if ends else alone,
            on=int(flags & _ON),
        )


def distance(chair: FilmChair) -> float | None:
    """Between the user's stick and the chair's, KPI 1's; None where one of them is not known."""
    if chair.stick is None or chair.commanded is None:
        return None
    return min(math.dist(chair.stick, chair.commanded), MAX_DISTANCE)
