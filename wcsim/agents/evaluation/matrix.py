"""Tests of several policies in several towns with several user profiles, as rows, tables and JSON."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import gymnasium
import torch
from rich import box
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from wcsim.agents.danger.saved import load_danger
from wcsim.agents.envs.senses import senses_of
from wcsim.agents.evaluation.evaluate import EvalRow, evaluate
from wcsim.agents.learning.saved_policy import JOYSTICK_SIZE, NetPolicy, load_policy
from wcsim.agents.policies import baselines
from wcsim.agents.policies.veto import Veto
from wcsim.agents.policy_api import UPPER_BOUND, UPPER_BOUNDS, VISIBLE_BOUND, Policy, is_baseline
from wcsim.agents.runs.policy_file import SIGHT_KEYS, is_danger
from wcsim.agents.runs.run_folder import policy_path, split_level
from wcsim.config import RunConfig, resolve
from wcsim.errors import PolicyError
from wcsim.supervisor.kpi import DROP
from wcsim.supervisor.observation import imu_size

MakeEnv = Callable[[str, str, tuple[str, ...]], gymnasium.Env[Any, Any]]  # (town, profile, senses) -> environment
Progress = Callable[[str], None]
Watch = Callable[[float, str], object]  # (share of the whole test, who drives)

_SHORTEST_NAME, _NUMBERS_WIDTH = 14, 66  # characters that a policy's name has at least, and of the longest numbers
_LEGEND_WIDTH = 70  # less than any of the tables has
_WIDE, _GAPS = 100, 11  # from so many characters on there is a second space between columns

Columns = tuple[tuple[str, str, str], ...]
_FOLLOWING: Columns = (
    ("kpi1_mean", "\n\nKPI 1", "{:.3f}"),
    ("kpi1_within", "close\nto\nuser", "{:.0%}"),
    ("kpi1_free_mean", "KPI 1\nfree\nsteps", "{:.3f}"),
    ("kpi1_moving_mean", "KPI 1\nfree,\nmoving", "{:.3f}"),
    ("kpi1_moving_within", "close,\nfree,\nmoving", "{:.0%}"),
    ("free_share", "\nfree\nsteps", "{:.0%}"),
    ("blocked_share", "\n\nblocked", "{:.1%}"),
    ("freezes", "\ntimes\nfrozen", "{:d}"),
    ("kpi2_mean_steps", "\nKPI 2\nsteps", "{:.0f}"),
    ("speed_mps", "\n\nm/s", "{:.2f}"),
)
_GETTING_THERE: Columns = (
    ("crashes_own", "\nown\ncrash", "{:d}"),
    ("crashes_other", "\nother\ncrash", "{:d}"),
    ("km", "\n\nkm", "{:.2f}"),
    ("crashes_per_km", "own\nper\nkm", "{:.2f}"),
    ("crashes_per_km_ci", "\n\n95 %", "{0[0]:.1f}-{0[1]:.1f}"),
    ("routes_completed", "\ngoals\ndone", "{:d}"),
    ("crossings", "\ncross-\nings", "{:d}"),
    ("red_entries", "\nat\nred", "{:d}"),
    ("standing_on_carriageway_s", "\ns on\nroad", "{:.0f}"),
    ("helps", "\n\nhelp", "{:d}"),
)
_HEEDLESS = ("random", "zero")  # baselines that do not ask what the user wants
_UPPER_BOUND_NOTES = {
    UPPER_BOUND: "oracle knows the true state: an upper bound",
    VISIBLE_BOUND: "oracle-visible: the true state, but only road users in its cameras",
}
_FOLLOWING_LEGEND = (
    "KPI 1: distance between the driven and the user's stick",
    "close: share of steps within 0.177 of the user's command",
    "free: steps without danger; moving: the user's stick is out",
    "blocked: free steps that give less than half of a push ahead",
    "frozen: stood for 3 s or more while the user's stick was out",
    "KPI 2: steps of an episode until a crash or its end",
)
_THERE_LEGEND = (
    "own crash: the chair's fault",
    "at red: entered a crossing at red",
    "s on road: seconds of standing on a carriageway; help: times asked",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class TestPlan:
    """Where, with whom and for how long every policy is tested."""

    __test__ = False  # it is not a test case of pytest

    towns: tuple[str, ...]
    profiles: tuple[str, ...]
    episodes: int
    max_steps: int  # after so many an episode is cut, and counts as survived
    seed: int  # every policy begins from it, in every town with every profile
    tick_s: float = 0.1
    config: RunConfig | None = None  # see `evaluate`


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

    @property
    def uneventful(self) -> bool:
        """Whether nobody crashed, and all who follow the user have the same figures as far as they are shown."""
        followers = [row for row in self.rows if row.policy not in _HEEDLESS]
        shown = {tuple(_texts(row, (*_FOLLOWING, *_GETTING_THERE))) for row in followers}
        return len(followers) > 1 and len(shown) == 1 and not any(row.crashes for row in followers)

    @property
    def crashed(self) -> list[str]:
        """Every crash, with its policy, episode, reason, fault, with whom and where."""
        return [f"{row.policy}, {told}" for row in self.rows for told in row.crashed]

    def tables(self, width: int = 80) -> tuple[Table, Table]:
        """The rows for a console of `width` characters, at least 80: no number is folded, and no name in a row.

        The first is about following the user, the second about getting there. Who has no room for its name goes by the
        end of it or by a number, and the line below the first table says whom that is.
        """
        title = f"{self.town}, {self.profile} user, seed {self.seed}"
        drops = ("drop",) if any(DROP in row.crash_reasons for row in self.rows) else ()
        there = _table("\ngetting there", _GETTING_THERE, width, drops)
        following = _table(f"{title}: following", _FOLLOWING, width)
        labels = _labels([row.policy for row in self.rows], width - _NUMBERS_WIDTH - (_GAPS if width >= _WIDE else 0))
        named = zip(labels, self.rows, strict=True)
        legend = [_broken(f"{label}: {row.policy}") for label, row in named if label != row.policy]
        lines = Text("\n".join((*legend, *_FOLLOWING_LEGEND)), overflow="fold")
        following.caption, following.caption_justify = lines, "left"
        bounds = [name for name in UPPER_BOUNDS if any(row.policy == name for row in self.rows)]
        notes = [_UPPER_BOUND_NOTES[name] for name in bounds]
        there.caption, there.caption_justify = "\n".join((*_THERE_LEGEND, *notes)), "left"
        for label, row in zip(labels, self.rows, strict=True):
            following.add_row(Text(label), *_cells(row, _FOLLOWING))
            fallen = [str(row.crash_reasons.get(DROP, 0)) for _ in drops]
            there.add_row(Text(label), *_cells(row, _GETTING_THERE), *fallen)
        return following, there


def run_test(
    policies: Sequence[Policy],
    make_env: MakeEnv,
    plan: TestPlan,
    progress: Progress | None = None,
    watch: Watch = lambda share, who: None,
) -> list[TestResult]:
    """Every policy in every town with every profile, each from the same seed.

    Policies with the same senses share the environment of a town and profile. `progress` is told who is through,
    `watch` after each step how far all of it is.
    """
    results: list[TestResult] = []
    alike = {senses_of(policy): [p for p in policies if senses_of(p) == senses_of(policy)] for policy in policies}
    many, through = len(policies) * len(plan.towns) * len(plan.profiles), 0
    for town, profile in product(plan.towns, plan.profiles):
        rows: dict[int, EvalRow] = {}
        for senses, group in alike.items():
            env = make_env(town, profile, senses)
            try:
                for policy in group:
                    seen = partial(_tell, watch, policy.name, through, many)
                    row = evaluate(
                        policy, env, plan.episodes, plan.max_steps, plan.seed, plan.tick_s, plan.config, seen
                    )
                    rows[id(policy)] = row
                    through += 1
                    if progress is not None:
                        progress(f"{town}, {profile}: {policy.name}")
            finally:
                env.close()
        in_order = tuple(rows[id(policy)] for policy in policies)
        results.append(TestResult(town=town, seed=plan.seed, profile=profile, rows=in_order))
    return results


def _tell(watch: Watch, who: str, through: int, of: int, share: float) -> None:
    watch((through + share) / of, who)


def open_policy(name: str, config: RunConfig, seed: int = 0, network: str | None = None) -> Policy:
    """A policy by what a user calls it: a baseline's name, a run folder, `RUN:phase1`, or a policy folder.

    From a network on torch works on one thread in this process: one picture is too little for two, and where others use
    the cores they wait for one another, fifty times as long as the work takes.

    Raises PolicyError when there is none; `network` as in `load_policy`.
    """
    if is_baseline(name):
        return baselines.baseline(name, config, seed)
    torch.set_num_threads(1)
    path = policy_path(name)
    if is_danger(path):
        return load_danger(path, name, config, split_level(name)[1], network)
    policy = load_policy(path, network)
    camera, file = config.eye, policy.file
    if file.image_hw_px != (camera.height_px, camera.width_px) or file.net.actions != config.env.actions:
        raise PolicyError(
            f"policy {name!r} needs {file.image_hw_px[1]}x{file.image_hw_px[0]} images and actions {file.net.actions}; "
            f"this test has {camera.width_px}x{camera.height_px} and {config.env.actions}: test it alone"
        )
    numbers = imu_size(config.env.observe_gyro, config.env.observe_yaw) + JOYSTICK_SIZE
    wanted = file.vector_size - sum(file.sensors.values())
    if wanted != numbers:
        raise PolicyError(
            f"policy {name!r} needs {wanted} numbers from IMU and joystick, this test gives {numbers}: "
            "set env.observe_gyro and env.observe_yaw as in its training"
        )
    given = {key: len(measure.parts) for key, measure in config.sensors.measures().items()}
    if not file.sensors.items() <= given.items():
        raise PolicyError(
            f"policy {name!r} needs the sensors {file.sensors} (numbers of each), this test has {given}: "
            "set their sections of [sensors] as in its training"
        )
    other = [key for key in SIGHT_KEYS if getattr(file.camera, key) != getattr(camera, key)]
    forms = file.observation, config.env.observation
    if forms[0] != forms[1] and not (forms[0] == "compact" and forms[1] == "compact_rgb"):
        raise PolicyError(
            f"policy {name!r} sees env.observation={forms[0]}, this test has {forms[1]}: set it as in its training"
        )
    if other or file.net.classes != config.env.classes:
        raise PolicyError(
            f"policy {name!r} was trained with another camera or other classes than this test has "
            f"({', '.join(other) or 'env.classes'} differ): test it alone"
        )
    policy.name = name
    return policy


def window_for(policies: Sequence[Policy]) -> int:
    """Images that an observation must hold so that each of the policies sees enough; the others see the newest."""
    own = [policy.inner if isinstance(policy, Veto) else policy for policy in policies]
    return max((policy.file.window for policy in own if isinstance(policy, NetPolicy)), default=1)


def with_window(config: RunConfig, policies: Sequence[Policy]) -> RunConfig:
    """The configuration with as many images in an observation as the policies need, or more where they are set."""
    return resolve(config, (f"env.window={max(window_for(policies), config.env.frames)}",))


def _labels(names: Sequence[str], longest: int) -> list[str]:
    """What each policy is called in a row: its name, the end of its path, or its number."""
    longest = max(longest, _SHORTEST_NAME)
    ends = [name.rstrip("/").rpartition("/")[2] for name in names]
    found = []
    for number, (name, end) in enumerate(zip(names, ends, strict=True), 1):
        alone = end not in names and ends.count(end) == 1 and len(end) <= longest
        found.append(name if len(name) <= longest else end if alone else f"policy {number}")
    return found


def _broken(line: str) -> str:
    """A line that is broken behind a / where it is too long for a table."""
    lines = [""]
    for part in re.findall(r"[^/]*/|[^/]+", line):
        if lines[-1] and len(lines[-1] + part) > _LEGEND_WIDTH:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


def _table(title: str, columns: Columns, width: int, more: Sequence[str] = ()) -> Table:
    gap = (0, 1 if width >= _WIDE else 0, 0, 0)
    plain = escape(title)
    table = Table(title=plain, title_justify="left", box=box.SIMPLE_HEAD, padding=gap, pad_edge=False, show_edge=False)
    table.add_column("\n\npolicy", no_wrap=True)
    for heading in (*(heading for _, heading, _ in columns), *(f"\n\n{heading}" for heading in more)):
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _cells(row: EvalRow, columns: Columns) -> list[Text]:
    return [Text(cell) for cell in _texts(row, columns)]


def _texts(row: EvalRow, columns: Columns) -> list[str]:
    values = [(getattr(row, key), text) for key, _, text in columns]
    return ["-" if value is None else text.format(value) for value, text in values]
