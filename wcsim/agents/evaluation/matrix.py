"""Tests of several policies in several towns with several user profiles, as rows, tables and JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
from rich import box
from rich.table import Table
from rich.text import Text

from wcsim.agents.evaluation.evaluate import EvalRow, evaluate
from wcsim.agents.learning.saved_policy import JOYSTICK_SIZE, NetPolicy, load_policy
from wcsim.agents.policies import baselines
from wcsim.agents.policies.baseline_names import UPPER_BOUND, UPPER_BOUNDS, VISIBLE_BOUND, is_baseline
from wcsim.agents.policy_api import Policy
from wcsim.agents.runs.run_folder import policy_path
from wcsim.config import RunConfig
from wcsim.errors import PolicyError
from wcsim.supervisor.kpi import DROP
from wcsim.supervisor.observation import imu_size

MakeEnv = Callable[[str, str], gymnasium.Env[Any, Any]]  # (town, profile) -> environment
Progress = Callable[[str], None]

CAMERA_KEYS = ("hfov_deg", "range_m", "near_m", "p_BC_m", "yaw_deg", "pitch_deg")
"""What makes the same street look different to a network."""

Columns = tuple[tuple[str, str, str], ...]
FOLLOWING: Columns = (
    ("kpi1_mean", "KPI 1", "{:.3f}"),
    ("kpi1_within", "KPI 1\nwithin", "{:.0%}"),
    ("kpi1_free_mean", "KPI 1\nfree", "{:.3f}"),
    ("kpi1_moving_mean", "moving\nfree", "{:.3f}"),
    ("kpi1_moving_within", "\nwithin", "{:.0%}"),
    ("free_share", "free\nsteps", "{:.0%}"),
    ("blocked_share", "\nblocked", "{:.1%}"),
    ("freezes", "\nfreezes", "{:d}"),
    ("kpi2_mean_steps", "KPI 2\nsteps", "{:.0f}"),
)
GETTING_THERE: Columns = (
    ("crashes", "\ncrashes", "{:d}"),
    ("km", "\nkm", "{:.2f}"),
    ("crashes_per_km", "crash\n/km", "{:.2f}"),
    ("speed_mps", "\nm/s", "{:.2f}"),
    ("routes_completed", "routes\ndone", "{:d}"),
    ("routes_given_up", "given\nup", "{:d}"),
    ("crossings", "cross-\nings", "{:d}"),
    ("crossings_per_km", "\n/km", "{:.1f}"),
    ("red_entries", "at\nred", "{:d}"),
    ("standing_on_carriageway_s", "s stood\non road", "{:.1f}"),
)
UPPER_BOUND_NOTES = {
    UPPER_BOUND: "oracle sees the truth: an upper bound",
    VISIBLE_BOUND: "oracle-visible sees it too, but of the others only those whom its cameras show",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TestResult:
    """All policies in one town with one user profile."""

    __test__ = False  # it is not a test case of pytest

    town: str
    seed: int
    profile: str
    rows: tuple[EvalRow, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values: {"town", "seed", "profile", "rows"}."""
        return {
            "town": self.town,
            "seed": self.seed,
            "profile": self.profile,
            "rows": [row.to_json() for row in self.rows],
        }

    def tables(self) -> tuple[Table, Table]:
        """The rows for a console, 80 columns wide at most: a long path is folded, a number never is.

        The first is about following the user, the second about getting there.
        """
        title = f"{self.town}, {self.profile} user, seed {self.seed}"
        drops = ("drops",) if any(DROP in row.crash_reasons for row in self.rows) else ()
        there = _table("getting there", GETTING_THERE, drops)
        following = _table(f"{title}: following", FOLLOWING)
        bounds = [name for name in UPPER_BOUNDS if any(row.policy == name for row in self.rows)]
        if bounds:
            there.caption, there.caption_justify = "\n".join(UPPER_BOUND_NOTES[name] for name in bounds), "left"
        for row in self.rows:
            following.add_row(*_cells(row, FOLLOWING))
            there.add_row(*_cells(row, GETTING_THERE), *(str(row.crash_reasons.get(DROP, 0)) for _ in drops))
        return following, there


def run_test(
    policies: Sequence[Policy],
    make_env: MakeEnv,
    *,
    towns: Sequence[str],
    profiles: Sequence[str],
    episodes: int,
    max_steps: int,
    seed: int,
    tick_s: float = 0.1,
    progress: Progress | None = None,
) -> list[TestResult]:
    """Every policy in every town with every profile, each from the same seed; one environment a town and profile."""
    results: list[TestResult] = []
    for town in towns:
        for profile in profiles:
            env = make_env(town, profile)
            try:
                rows: list[EvalRow] = []
                for policy in policies:
                    rows.append(evaluate(policy, env, episodes, max_steps, seed, tick_s))
                    if progress is not None:
                        progress(f"{town}, {profile}: {policy.name}")
            finally:
                env.close()
            results.append(TestResult(town=town, seed=seed, profile=profile, rows=tuple(rows)))
    return results


def open_policy(name: str, config: RunConfig, seed: int = 0, network: str | None = None) -> Policy:
    """A policy by what a user calls it: a baseline's name, a run folder, `RUN:phase1`, or a policy folder.

    Raises PolicyError when there is none; `network` as in `load_policy`.
    """
    if is_baseline(name):
        return baselines.baseline(name, config, seed)
    policy = load_policy(policy_path(name), network)
    camera, file = config.cameras[0], policy.file
    if file.image_hw_px != (camera.height_px, camera.width_px) or file.net.actions != config.env.actions:
        raise PolicyError(
            f"policy {name!r} wants {file.image_hw_px[1]}x{file.image_hw_px[0]} images and actions {file.net.actions}; "
            f"this test has {camera.width_px}x{camera.height_px} and {config.env.actions}: test it on its own"
        )
    numbers = imu_size(config.env.observe_gyro, config.env.observe_yaw) + JOYSTICK_SIZE
    wanted = file.vector_size - sum(file.sensors.values())
    if wanted != numbers:
        raise PolicyError(
            f"policy {name!r} wants {wanted} numbers from IMU and joystick, this test gives {numbers}: "
            "set env.observe_gyro and env.observe_yaw as in its training"
        )
    given = {key: len(measure.parts) for key, measure in config.sensors.measures().items()}
    if not file.sensors.items() <= given.items():
        raise PolicyError(
            f"policy {name!r} wants the sensors {file.sensors} (numbers of each), this test has {given}: "
            "set their sections of [sensors] as in its training"
        )
    other = [key for key in CAMERA_KEYS if getattr(file.camera, key) != getattr(camera, key)]
    if other or file.net.classes != config.env.classes:
        raise PolicyError(
            f"policy {name!r} was trained with another camera or class form than this test has "
            f"({', '.join(other) or 'env.classes'} differ): test it on its own"
        )
    policy.name = name
    return policy


def window_for(policies: Sequence[Policy]) -> int:
    """Images that an observation must hold so that each of the policies sees enough; the others see the newest."""
    return max((policy.file.window for policy in policies if isinstance(policy, NetPolicy)), default=1)


def _table(title: str, columns: Columns, more: Sequence[str] = ()) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("\npolicy", overflow="fold", min_width=8)
    for heading in (*(heading for _, heading, _ in columns), *(f"\n{heading}" for heading in more)):
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _cells(row: EvalRow, columns: Columns) -> list[Text]:
    values = [(getattr(row, key), text) for key, _, text in columns]
    return [Text(row.policy), *(Text("-" if value is None else text.format(value)) for value, text in values)]
