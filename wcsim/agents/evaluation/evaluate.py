"""The two key performance indicators of a policy in an environment, and what keeps them honest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import gymnasium

from wcsim.agents.evaluation.episode_meter import EpisodeMeter
from wcsim.agents.evaluation.suite.records import CRASHED, TIMED_OUT, EpisodeRecord
from wcsim.agents.evaluation.suite.rows import Row, row_of
from wcsim.agents.policy_api import Helping, Policy, SeesTruth, calling, tell_delay
from wcsim.config import RunConfig
from wcsim.errors import ConfigError
from wcsim.supervisor.kpi import KpiRow, StepLog, joined, summarise
from wcsim.supervisor.rewards import blamed

Watch = Callable[[float], object]
_AS_IN_SUITES = (
    *("crashes_own", "crashes_other", "crashes_per_km", "crashes_per_km_ci"),
    *("kpi2_median", "alive_at_end", "alive_at_end_ci"),
    *("accel_rms_mps2", "stick_travel_per_s", "asked_travel_per_s", "helps"),
)


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
    crashed: tuple[str, ...]  # each with its episode, reason, fault, with whom, and where in SUMO's net
    km: float
    crashes_per_km: float | None  # of the chair's own
    speed_mps: float | None
    routes_completed: int
    routes_given_up: int
    crossings: int  # completed: in from one pavement, out on the opposite one
    crossings_per_km: float | None
    standing_on_carriageway_s: float
    red_entries: int  # it set out over a crossing that had red
    crashes_own: int
    crashes_other: int  # another's fault, while the chair stood where it may
    crashes_per_km_ci: tuple[float, float] | None  # of the own ones; Garwood's interval, 95 % as all of these
    kpi1_moving_within_ci: tuple[float, float] | None  # bootstrap over episodes
    kpi2_median: float | None
    alive_at_end: float | None  # share of the episodes that no crash ended
    alive_at_end_ci: tuple[float, float] | None
    accel_rms_mps2: float | None  # from step to step
    stick_travel_per_s: float | None  # way of the stick that the chair was given
    asked_travel_per_s: float | None  # and of the user's
    helps: int  # times that the user asked for help

    def to_json(self) -> dict[str, Any]:
        """Plain values under the same names."""
        return {**asdict(self), "crashed": list(self.crashed)}


def evaluate(
    policy: Policy,
    env: gymnasium.Env[Any, Any],
    episodes: int,
    max_steps: int,
    seed: int,
    tick_s: float = 0.1,
    config: RunConfig | None = None,
    watch: Watch = lambda share: None,
) -> EvalRow:
    """Let a policy drive whole episodes, greedily.

    Args:
        policy: Drives.
        env: wcsim's environment; reset with `seed` first, so that every policy meets the same world at the start.
        episodes: How many episodes.
        max_steps: An episode is cut after this many steps (it counts as survived).
        seed: Of the environment.
        tick_s: Duration of a step.
        config: Says what counts as a collision, and whether requests for help raise levels; by default the usual one.
        watch: Told after each step which share of the episodes is done.

    Raises:
        ConfigError: `episodes` or `max_steps` is below 1.
        PolicyError: The policy sees the truth and the environment gives none.
    """
    if episodes < 1 or max_steps < 1:
        raise ConfigError(f"episodes={episodes}, max_steps={max_steps}; expected at least 1 of each")
    logs: list[StepLog] = []
    records: list[EpisodeRecord] = []
    config = config or RunConfig()
    with calling(policy, "begin"):
        policy.begin()
    for episode in range(episodes):
        observation, info = env.reset(seed=seed) if episode == 0 else env.reset()
        tell_delay(policy, info.get("drawn"))
        with calling(policy, "reset"):
            policy.reset()
        meter = EpisodeMeter(tick_s, config.reward)
        seen, helping = partial(_tell, watch, episode, episodes), Helping(policy, config.world.users_help_ticks)
        records.append(_drive(policy, env, (observation, info), max_steps, tick_s, meter, seen, helping))
        with calling(policy, "set_level"):
            helping.end()
        logs.append(meter.log())
    crashed = tuple(
        f"episode {number}: {blamed(record.reason, record.fault, record.crash)}"
        for number, record in enumerate(records, 1)
        if record.status == CRASHED
    )
    return _row(policy.name, summarise(joined(logs)), row_of(policy.name, "", records, ()), crashed)


def _tell(watch: Watch, episode: int, of: int, share: float) -> None:
    watch((episode + share) / of)


def _row(name: str, row: KpiRow, judged: Row, crashed: tuple[str, ...]) -> EvalRow:
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
        crashed=crashed,
        km=row.km,
        speed_mps=row.speed_mean_mps,
        routes_completed=row.routes_completed,
        routes_given_up=row.routes_given_up,
        crossings=row.crossings,
        crossings_per_km=None if judged["crashes_per_km"] is None else row.crossings_per_km,
        standing_on_carriageway_s=row.standing_on_carriageway_s,
        red_entries=row.red_entries,
        kpi1_moving_within_ci=judged["kpi1_free_within_ci"],
        **{key: judged[key] for key in _AS_IN_SUITES},
    )


def _drive(
    policy: Policy,
    env: gymnasium.Env[Any, Any],
    begun: tuple[Any, dict[str, Any]],
    max_steps: int,
    tick_s: float,
    meter: EpisodeMeter,
    watch: Watch,
    helping: Helping,
) -> EpisodeRecord:
    """One episode into the meter."""
    observation, info = begun
    ended: dict[str, Any] = {"status": TIMED_OUT}
    for step in range(1, max_steps + 1):
        truth = info.get("truth")  # of the moment that the agent answers to
        if isinstance(policy, SeesTruth):
            policy.see(truth)
        with calling(policy, "act"):
            if info.get("help"):
                helping.ask()
            action = policy.act(observation)
            helping.tick()
        observation, _, terminated, truncated, info = env.step(action)
        meter.add(info, None if truth is None else not truth.danger)
        if info["events"].crash_reason:
            ended = meter.crash(info)
        watch(step / max_steps)
        if terminated or truncated or step == max_steps:
            break
    sums = meter.sums(ended.get("reason", ""))
    time_s = sums["steps"] * tick_s
    return EpisodeRecord(block=0, seat=0, part="", town="", profile="", time_s=time_s, **ended, **sums)
