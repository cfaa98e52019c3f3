"""The two key performance indicators of a policy in an environment, and what keeps them honest."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import gymnasium

from wcsim.agents.protocol import Policy, SeesTruth
from wcsim.errors import ConfigError
from wcsim.supervisor.kpi import KpiMeter

MIN_KM = 0.05  # below this a number of crashes per kilometre says nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class EvalRow:
    """One policy's row of a result table; None where nothing was measured."""

    policy: str
    episodes: int
    kpi1_mean: float | None  # mean joystick distance (KPI 1 of the paper)
    kpi1_within: float | None  # share of steps with a distance of at most 0.1768
    kpi1_free_mean: float | None  # KPI 1 over the steps that were free of danger when the agent answered
    free_share: float | None  # of the steps for which the truth is known
    kpi2_mean_steps: float | None  # steps an episode lived (KPI 2)
    crashes: int
    km: float
    crashes_per_km: float | None
    speed_mps: float | None

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
    row = meter.row()
    return EvalRow(
        policy=policy.name,
        episodes=episodes,
        kpi1_mean=row.distance_mean,
        kpi1_within=row.share_within,
        kpi1_free_mean=row.distance_free_mean,
        free_share=row.free_share,
        kpi2_mean_steps=row.steps_alive_mean,
        crashes=row.crashes,
        km=row.km,
        crashes_per_km=row.crashes / row.km if row.km >= MIN_KM else None,
        speed_mps=row.speed_mean_mps,
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
        free = None if truth is None else not truth.danger
        meter.add(float(info["joystick_distance"]), free, float(info["speed_mps"]), tick_s)
        if terminated or truncated or step == max_steps:
            meter.end_episode(step, bool(terminated))
            return
