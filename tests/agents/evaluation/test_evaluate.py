import io
import json
import math
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from rich.console import Console

from tests.agents.toy import ToyStreet, toy_camera
from tests.drive.lookers import Remembers
from wcsim.agents.evaluation.evaluate import evaluate
from wcsim.agents.evaluation.matrix import TestPlan, TestResult, open_policy, run_test
from wcsim.agents.policies.baselines import baseline
from wcsim.config import RunConfig, resolve
from wcsim.errors import ConfigError, PolicyError
from wcsim.types import Events, Joystick, Truth

KEYS = (
    "policy", "episodes", "kpi1_mean", "kpi1_within", "kpi1_free_mean", "kpi1_moving_mean", "kpi1_moving_within",
    "free_share", "blocked_share", "freezes", "kpi2_mean_steps", "crashes", "crash_reasons", "crashed", "km",
    "crashes_per_km",
    "speed_mps", "routes_completed", "routes_given_up", "crossings", "crossings_per_km", "standing_on_carriageway_s",
    "red_entries", "crashes_own", "crashes_other", "crashes_per_km_ci", "kpi1_moving_within_ci", "kpi2_median",
    "alive_at_end", "alive_at_end_ci", "accel_rms_mps2", "stick_travel_per_s", "asked_travel_per_s", "helps",
)  # fmt: skip
CAMERA = toy_camera(24, 32)
CONFIG = RunConfig(cameras=(CAMERA,))


class Script(gym.Env):
    """Distances 0, 0.1, 0.2, ... of an episode; danger whenever the distance about to be answered is at least 0.2."""

    def __init__(self, crash_at=6, speed_mps=1.0, truth=True):
        self.crash_at, self.speed_mps, self.truth, self.closed = crash_at, speed_mps, truth, False
        self.seeds = []

    def _info(self, distance):
        truth = Truth(
            intent=Joystick(0, 0), danger=self.k >= 2, first_s=np.full(81, np.inf), clearance_m=1, progress_m=0
        )
        events = Events(
            episode=0, step=self.k, crashed=self.k == self.crash_at, truncated=False, arrived=self.k == 2,
            crash_reason="tilt" if self.k == self.crash_at else "", gave_up=self.k == 3,
            help_asked=self.k == 2, crossed=self.k in (1, 2), entered_red=self.k == 1, on_carriageway=self.k >= 4,
            crash="tilted too far, at x 1.0 y 2.0 in the net, edge e" if self.k == self.crash_at else "",
        )  # fmt: skip
        return {
            "joystick_distance": distance, "speed_mps": self.speed_mps, "truth": truth if self.truth else None,
            "events": events, "asked": Joystick(0.0, 0.2 + 0.2 * self.k), "given": Joystick(0.0, 0.0),
            "help": events.help_asked,
        }  # fmt: skip

    def reset(self, *, seed=None, options=None):
        self.seeds.append(seed)
        self.k = 0
        return {"joystick": np.zeros(2, np.float32)}, self._info(0.0)

    def step(self, action):
        distance = self.k / 10
        self.k += 1
        return {"joystick": np.zeros(2, np.float32)}, 0.0, self.k == self.crash_at, False, self._info(distance)

    def close(self):
        self.closed = True


FOLLOW = baseline("follow", CONFIG)


class NotesLevels(Remembers):
    """Notes its level of each step; a level is kept from episode to episode."""

    def begin(self):
        self.noted = []

    def choose(self, observation):
        self.noted.append(self.level)
        return super().choose(observation)


@pytest.mark.parametrize(("ticks", "raised"), [(0, 0), (3, 3), (9, 4)])
def test_a_request_for_help_raises_the_level_for_a_while_and_for_this_episode(ticks, raised):
    policy = NotesLevels()
    config = resolve(CONFIG, ("world.help_users=true", f"world.help_s={0.1 * ticks}"))
    evaluate(policy, Script(crash_at=6), episodes=2, max_steps=100, seed=7, config=config)
    assert policy.noted == 2 * [1.0, 1.0, *[2.0] * raised, *[1.0] * (4 - raised)]
    assert policy.level == 1.0


def test_the_indicators_of_a_scripted_drive():
    env = Script(crash_at=6)
    row = evaluate(FOLLOW, env, episodes=2, max_steps=100, seed=7, tick_s=10.0)
    assert tuple(row.to_json()) == KEYS
    assert row.kpi1_mean == pytest.approx(0.25)
    assert row.kpi1_within == pytest.approx(2 / 6)
    assert row.kpi1_free_mean == pytest.approx(0.05)  # 0.0 and 0.1: the truth of the moment that was answered
    assert row.free_share == pytest.approx(2 / 6)
    assert (row.kpi2_mean_steps, row.crashes, row.episodes) == (6, 2, 2)
    assert (row.km, row.crashes_per_km) == (pytest.approx(0.12), pytest.approx(2 / 0.12))
    assert env.seeds == [7, None]
    assert row.kpi1_moving_mean == pytest.approx(0.05)  # the stick is out by more than 0.3 in all steps
    assert (row.kpi1_moving_within, row.blocked_share) == (1.0, 1.0)
    assert (row.routes_completed, row.routes_given_up, row.crossings, row.red_entries) == (2, 2, 4, 2)
    assert row.crossings_per_km == pytest.approx(4 / 0.12)
    assert row.crash_reasons == {"tilt": 2}
    told = "tilt, own fault: it tilted too far, at x 1.0 y 2.0 in the net, edge e"
    assert row.crashed == (f"episode 1: {told}", f"episode 2: {told}")
    result = TestResult(town="helsinki", seed=7, profile="ataxic", rows=(row,))
    assert result.crashed[1] == f"follow, episode 2: {told}"
    assert row.helps == 2
    assert (row.freezes, row.standing_on_carriageway_s) == (0, 0.0)  # it never stands


def test_a_policy_that_stands_freezes_on_the_carriageway():
    row = evaluate(FOLLOW, Script(crash_at=6, speed_mps=0.0), episodes=2, max_steps=100, seed=7, tick_s=1.0)
    assert (row.freezes, row.standing_on_carriageway_s) == (2, 6.0)  # one an episode; 3 steps of each on the road


def test_a_cut_episode_survived_and_little_was_measured():
    row = evaluate(FOLLOW, Script(crash_at=99, truth=False), episodes=1, max_steps=5, seed=0)
    assert (row.kpi2_mean_steps, row.crashes, row.crashes_per_km) == (5, 0, None)
    assert row.kpi1_free_mean is None
    assert row.free_share is None
    assert not any(isinstance(v, float) and math.isnan(v) for v in row.to_json().values())
    assert evaluate(FOLLOW, Script(speed_mps=0.0), 1, 5, 0).speed_mps == 0.0


def test_the_oracle_is_shown_the_truth_of_the_moment_it_answers_to():
    class Danger(Script):
        def step(self, action):
            asked.append(int(action))
            return super().step(action)

        def _info(self, distance):
            info = super()._info(distance)
            first_s = np.ones(81)
            first_s[self.k] = np.inf
            return {**info, "truth": replace(info["truth"], first_s=first_s)} if self.truth else info

    asked: list[int] = []
    oracle = baseline("oracle", CONFIG)
    assert evaluate(oracle, Danger(crash_at=4), episodes=1, max_steps=9, seed=0).kpi2_mean_steps == 4
    assert asked == [0, 1, 2, 3]
    with pytest.raises(PolicyError, match=r"env\.truth"):
        evaluate(oracle, Danger(truth=False), episodes=1, max_steps=9, seed=0)


def shown(result, width=120):
    console = Console(width=width, file=io.StringIO())
    console.print(*result.tables(width))
    return console.file.getvalue()


def cells(text):
    return [line.split() for line in text.splitlines() if line.split()[:1] == ["follow"]]


def test_the_table_calls_the_oracle_an_upper_bound():
    row = evaluate(FOLLOW, Script(), episodes=1, max_steps=5, seed=0)
    result = TestResult(town="a", seed=0, profile="b", rows=(row, replace(row, policy="oracle")))
    assert "upper bound" in shown(result)
    assert "upper bound" not in shown(replace(result, rows=(row,)))
    both = shown(replace(result, rows=(row, *(replace(row, policy=name) for name in ("oracle-visible", "oracle")))))
    assert "upper bound" in both and "road users in its cameras" in " ".join(both.split())


def test_the_tables_show_what_was_counted_and_drops_when_there_are_some():
    row = evaluate(FOLLOW, Script(), episodes=2, max_steps=9, seed=0, tick_s=10.0)
    result = TestResult(town="a", seed=0, profile="b", rows=(row,))
    text = shown(result, width=80)
    assert max(map(len, text.splitlines())) <= 80
    following, there = cells(text)
    assert following[1:] == ["0.250", "33%", "0.050", "0.050", "100%", "33%", "100.0%", "0", "6", "1.00"]
    assert there[1:] == ["2", "0", "0.12", "16.67", "2.0-60.2", "2", "4", "2", "0", "2"]
    fell = replace(result, rows=(row, replace(row, crash_reasons={"drop": 3, "tilt": 2})))
    assert "drop" not in text and "drop" in shown(fell)
    assert [row[-1] for row in cells(shown(fell))[2:]] == ["0", "3"]


def test_a_drive_is_uneventful_when_nobody_crashed_and_all_followers_have_the_same_figures():
    calm = evaluate(FOLLOW, Script(crash_at=99), episodes=1, max_steps=5, seed=0)
    helped, heedless = replace(calm, policy="shipped"), replace(calm, policy="random", kpi1_mean=1.0)
    result = TestResult(town="a", seed=0, profile="b", rows=(helped, calm, heedless))
    assert result.uneventful
    assert not replace(result, rows=(calm, heedless)).uneventful
    assert not replace(result, rows=(replace(helped, kpi1_mean=0.9), calm)).uneventful
    assert not replace(result, rows=(replace(helped, km=9.0), calm)).uneventful
    crashed = evaluate(FOLLOW, Script(crash_at=3), episodes=1, max_steps=5, seed=0)
    assert not replace(result, rows=(crashed, replace(crashed, policy="shipped"))).uneventful


@pytest.mark.parametrize("width", [80, 100, 120])
def test_no_name_and_no_number_is_broken_however_long(width):
    row = evaluate(FOLLOW, Script(), episodes=2, max_steps=9, seed=0, tick_s=10.0)
    row = replace(row, crashes_own=123, crashes_other=123, km=123.45, crashes_per_km=12.34, routes_completed=123)
    row = replace(row, crossings=123, standing_on_carriageway_s=1234.0, kpi2_mean_steps=10000.0, freezes=123)
    far = "/somewhere/experiments/2026-11/assistive-networks/runs"
    names = ["runs/demo", "runs/demo:phase1", "oracle-visible", f"{far}/a:phase1", f"{far}/b/two", "c/two"]
    names += [f"{far}/{'d' * 60}"]
    rows = tuple(replace(row, policy=name, crash_reasons={"drop": 3}) for name in names)
    text = shown(TestResult(town="a", seed=0, profile="b", rows=rows), width)
    lines = [line.rstrip() for line in text.splitlines()]
    assert max(map(len, lines)) <= width and "…" not in text
    counts = [line.partition(" 0.250")[0].rstrip() for line in lines if " 0.250" in line]
    assert len(set(counts)) == len(names)
    joined = "".join(lines)
    for label, name in zip(counts, names, strict=True):
        assert label == name or f"{label}: {name}" in joined
        assert sum(line.startswith(f"{label} ") and " 1234 " in line for line in lines) == 1
    assert counts[2:] == ["oracle-visible", "a:phase1", "policy 5", "c/two", "policy 7"]
    assert counts[:2] == ["runs/demo", "demo:phase1" if width == 80 else "runs/demo:phase1"]


def test_nonsense_is_refused():
    with pytest.raises(ConfigError, match="at least 1"):
        evaluate(FOLLOW, Script(), episodes=0, max_steps=5, seed=0)


PLAN = TestPlan(towns=("a", "b"), profiles=("blind",), episodes=2, max_steps=30, seed=4)


def test_a_test_of_several_policies_towns_and_profiles():
    made = []

    def make_env(town, profile, senses):
        made.append((town, profile, senses))
        return ToyStreet(CAMERA, max_steps=40)

    policies = [open_policy(name, CONFIG, seed=1) for name in ("follow", "zero")]
    results = run_test(policies, make_env, PLAN)
    assert [(r.town, r.profile, r.seed) for r in results] == [("a", "blind", 4), ("b", "blind", 4)]
    data = results[0].to_json()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert list(data) == ["town", "seed", "profile", "rows"]
    assert [row["policy"] for row in data["rows"]] == ["follow", "zero"]
    assert results[0].rows == results[1].rows  # the same seed gives the same drive
    assert [table.row_count for table in results[0].tables()] == [2, 2]
    assert made == [("a", "blind", ()), ("b", "blind", ())]  # one for all who sense the same
    made.clear()
    mixed = [open_policy(name, CONFIG, seed=1) for name in ("follow", "dwa", "zero")]
    (result,) = run_test(mixed, make_env, replace(PLAN, towns=("a",), episodes=1, max_steps=3))
    assert made == [("a", "blind", ()), ("a", "blind", ("odometry", "gyro"))]
    assert [row.policy for row in result.rows] == ["follow", "dwa", "zero"]


class Own:
    """A policy of the user's own that fails where it is told to."""

    name = "own"

    def __init__(self, fails_in):
        self.fails_in = fails_in

    def begin(self):
        self._run("begin")

    def reset(self):
        self._run("reset")

    def act(self, observation):
        self._run("act")
        return 0

    def _run(self, what):
        if what == self.fails_in:
            raise RuntimeError("my weights are gone")


@pytest.mark.parametrize("method", ["begin", "reset", "act"])
def test_a_policy_of_ones_own_that_fails_is_told_with_its_line_and_the_environment_closed(method):
    env = Script()
    with pytest.raises(PolicyError, match=rf"'own' failed in {method}: RuntimeError: my weights are gone .*line \d+"):
        run_test([Own(method)], lambda *_: env, PLAN)
    assert env.closed


def test_what_wcsim_itself_does_wrong_comes_with_its_traceback(monkeypatch):
    env = Script()
    monkeypatch.setattr(type(FOLLOW), "act", lambda self, observation: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        run_test([FOLLOW], lambda *_: env, PLAN)
    assert env.closed


def test_an_unknown_policy_is_explained(tmp_path):
    with pytest.raises(PolicyError, match="not a run"):
        open_policy(str(tmp_path / "nowhere"), CONFIG)
