"""The numbers of a drive as it goes: the two KPIs, how far, how fast, how long, and how often what happened."""

from __future__ import annotations

from dataclasses import dataclass, field

from wcsim.drive.driven import DrivenTick
from wcsim.supervisor.kpi import STANDS_MPS


@dataclass(slots=True, kw_only=True)
class DriveTally:
    """Sums over all ticks of a drive; `add` is called with each."""

    ticks: int = 0
    distance_sum: float = 0.0  # of joystick distances
    way_m: float = 0.0
    moving_ticks: int = 0
    arrivals: int = 0
    given_up: int = 0
    crashes: int = 0
    helps: int = 0  # counted as they are heard
    overrules: int = 0  # presses
    warnings: int = 0  # stretches of ticks, as the next
    interventions: int = 0
    episode_steps: list[int] = field(default_factory=list)  # of those that have ended
    steps: int = 0  # of the episode that is on, from a handover on; 0 once it has ended
    _before: tuple[bool, bool, bool] = (False, False, False)

    def add(self, driven: DrivenTick, tick_s: float) -> None:
        """One tick."""
        self.ticks += 1
        self.steps += 1
        self.distance_sum += driven.joystick_distance
        self.way_m += abs(driven.speed_mps) * tick_s
        self.moving_ticks += abs(driven.speed_mps) > STANDS_MPS
        self.arrivals += driven.arrived
        self.given_up += driven.gave_up
        self.crashes += driven.crashed
        now = (driven.warning, driven.intervening, driven.overruled)
        begun = [is_on and not was for is_on, was in zip(now, self._before, strict=True)]
        self.warnings += begun[0]
        self.interventions += begun[1]
        self.overrules += begun[2]
        self._before = now
        if driven.crashed or driven.truncated:  # a drive may end before the next episode begins
            self.end_episode()

    def end_episode(self) -> None:
        """The episode is over, by a crash, its step limit, or because somebody began another."""
        if self.steps:
            self.episode_steps.append(self.steps)
        self.steps = 0

    @property
    def kpi1(self) -> float | None:
        """Mean joystick distance, KPI 1; None before the first tick."""
        return self.distance_sum / self.ticks if self.ticks else None

    @property
    def kpi2(self) -> float:
        """Mean steps that an episode lived, KPI 2; of the one that is on while none has ended."""
        ended = self.episode_steps
        return sum(ended) / len(ended) if ended else float(self.steps)
