"""The two key performance indicators of a policy in an environment, and what keeps them honest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium

from wcsim.agents.policy_api import Policy, SeesTruth
from wcsim.errors import ConfigError
from wcsim.supervisor.kpi import KpiMeter, KpiRow, KpiStep

_MIN_KM = 0.05  # below this a number of crashes per kilometre says nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class EvalRow:
    """One policy's row of a result table; None where nothing was measured."""

    policy: str
    episodes: int
    kpi1_mean: float | None  # mean joystick distance (KPI 1 of the paper)
    kpi1_within: float | None  # share of steps with a distance of at most 0.1768
    kpi1_free_mean: float | None  # KPI 1 over the steps that were free of danger when the agent answered
    kpi1_moving_mean: float | None  # KPI 1 over the free steps in which the user's stick is out by more than 0.3
    kpi1_moving_within: float | None  # share of those with a distance of at most 0.1768
    free_share: float | None  # of the steps for which the truth is known
    blocked_share: float | None  # of the free steps: the user pushes forward and gets less than half of it
    freezes: int  # times that the chair stood for 3 s and more though the user pushed, because the agent did not
    kpi2_mean_steps: float | None  # steps an episode lived (KPI 2)
    crashes: int
    crash_reasons: Mapping[str, int]
    km: float
    crashes_per_km: float | None
    speed_mps: float | None
    routes_completed: int
    routes_given_up: int
    crossings: int  # completed: in from one pavement, out on the opposite one
    crossings_per_km: float | None
    standing_on_carriageway_s: float
    red_entries: int  # the footplate passed the kerb line of a crossing that had red

    def to_json(self) -> dict[str, Any]:
        """Plain values under the same names."""
        return asdict(self)


def evaluate(
    policy: Policy,
    env: gymnasium.Env[Any, Any],
    episodes: int,
    max_steps: int,
    seed: int,
    tick_s: float = 0.1,
) -> EvalRow:
    """Let a policy drive whole episodes, greedily.

    Args:
        policy: Drives.
        env: wcsim's environment; reset with `seed` first, so that every policy meets the same world at the start.
        episodes: How many episodes.
        max_steps: An episode is cut after this many steps (it counts as survived).
        seed: Of the environment.
        tick_s: Duration of a step.

    Raises:
        ConfigError: `episodes` or `max_steps` is below 1.
        PolicyError: The policy sees the truth and the environment gives none.
    """
    if episodes < 1 or max_steps < 1:
        raise ConfigError(f"episodes={episodes}, max_steps={max_steps}; expected at least 1 of each")
    meter = KpiMeter()
    policy.begin()
    for episode in range(episodes):
        observation, info = env.reset(seed=seed) if episode == 0 else env.reset()
        policy.reset()
        _drive(policy, env, observation, info, max_steps, tick_s, meter)
    return _row(policy.name, meter.row())


def _row(name: str, row: KpiRow) -> EvalRow:
    far_enough = row.km >= _MIN_KM
    return EvalRow(
        policy=name,
        episodes=row.episodes,
        kpi1_mean=row.distance_mean,
        kpi1_within=row.share_within,
        kpi1_free_mean=row.distance_free_mean,
        kpi1_moving_mean=row.distance_moving_mean,
        kpi1_moving_within=row.moving_within,
        free_share=row.free_share,
        blocked_share=row.blocked_share,
        freezes=row.freezes,
        kpi2_mean_steps=row.steps_alive_mean,
        crashes=row.crashes,
        crash_reasons=row.crash_reasons,
        km=row.km,
        crashes_per_km=row.crashes_per_km if far_enough else None,
        speed_mps=row.speed_mean_mps,
        routes_completed=row.routes_completed,
        routes_given_up=row.routes_given_up,
        crossings=row.crossings,
        crossings_per_km=row.crossings_per_km if far_enough else None,
        standing_on_carriageway_s=row.standing_on_carriageway_s,
        red_entries=row.red_entries,
    )


def _drive(
    policy: Policy,
    env: gymnasium.Env[Any, Any],
    observation: Any,
    info: dict[str, Any],
    max_steps: int,
    tick_s: float,
    meter: KpiMeter,
) -> None:
    """One episode into the meter."""
    for step in range(1, max_steps + 1):
        truth = info.get("truth")  # of the moment that the agent answers to
        if isinstance(policy, SeesTruth):
            policy.see(truth)
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        events = info["events"]
        meter.add(
            KpiStep(
                distance=float(info["joystick_distance"]),
                free=None if truth is None else not truth.danger,
                asked=info["asked"],
                given=info["given"],
                speed_mps=float(info["speed_mps"]),
                dt_s=tick_s,
                events=events,
            )
        )
        if terminated or truncated or step == max_steps:
            meter.end_episode(step, events.crash_reason)
            return
