"""The wrapper `veto:POLICY`: whose action is taken, what it passes on, and by which names it is found."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.agents.danger.sights import observation
from tests.agents.danger.test_street_map import observation as sight
from tests.agents.policies.test_baselines import box, ground
from tests.support.samples import ACTIONS
from wcsim.agents.evaluation.suite.run import _identity_of, _policy_at
from wcsim.agents.opening.named_policy import open_named_policy, resolve_policy_config
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.agents.policies.dwa import VetoPolicy
from wcsim.agents.policy_api import HearsSent, Levelled, NeedsSenses, TellsUnsafe, Warns
from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.config import CameraConfig, RunConfig
from wcsim.errors import PolicyError

CONFIG = RunConfig(cameras=(CameraConfig(width_px=96, height_px=72),))
AHEAD = np.array([0.0, 1.0], np.float32)
WALL = box(1.3, 3.0, -3, 3, 0, 2)  # 0.5 m ahead: driving on at 0.8 m/s would be too late


def seen(surface):
    return {**sight(surface, speed=0.8), "joystick": AHEAD}


class Doubter:
    """Wants to drive on, holds some for unsafe, and writes down what is sent."""

    name, senses = "doubter", ("brake",)

    def __init__(self, doubts=()):
        self.wants, self.told, self.warning = ACTIONS.nearest(AHEAD), [], True
        self.unsafe = np.array([tuple(point) in doubts for point in ACTIONS.points.tolist()])

    def begin(self):
        self.told.append("begin")

    def reset(self):
        self.told.append("reset")

    def set_delay(self, ticks):
        self.told.append(ticks)

    def act(self, observation):
        raise AssertionError("whoever hears what is sent is asked to choose")

    def choose(self, observation):
        return self.wants

    def sent(self, action):
        self.told.append(action)

    def close(self):
        self.told.append("closed")


def veto(inner):
    return VetoPolicy(f"veto:{inner.name}", inner, CONFIG)


def follows():
    return veto(make_baseline_policy("follow", CONFIG))


def test_where_dwa_forbids_nothing_the_policy_drives():
    policy = follows()
    assert policy.act(seen(ground)) == ACTIONS.nearest(AHEAD)
    assert not policy.unsafe[ACTIONS.nearest(AHEAD)]


def test_before_a_wall_the_nearest_action_that_is_allowed_is_taken():
    policy = follows()
    chosen = ACTIONS.points[policy.act(seen(WALL))]
    assert policy.unsafe[ACTIONS.nearest(AHEAD)] and not policy.unsafe[ACTIONS.nearest(chosen)]
    distance = ACTIONS.distances(AHEAD[None].astype(np.float64))[0]
    assert ACTIONS.distance(ACTIONS.nearest(chosen), AHEAD) == distance[~policy.unsafe].min()


def test_what_the_policy_itself_holds_for_unsafe_is_not_put_in_the_place():
    first = veto(Doubter()).act(seen(WALL))
    doubter = Doubter({tuple(ACTIONS.points[first].tolist())})
    assert veto(doubter).act(seen(WALL)) != first


def test_where_all_is_unsafe_to_one_of_both_the_veto_counts():
    everything = {tuple(point) for point in ACTIONS.points.tolist()}
    first = veto(Doubter()).act(seen(WALL))
    assert veto(Doubter(everything)).act(seen(WALL)) == first


def test_where_dwa_would_take_nothing_the_policy_decides(monkeypatch):
    policy = veto(Doubter())
    monkeypatch.setattr(policy._dwa, "choose", lambda observation: 0)
    policy._dwa.unsafe = np.ones(81, np.bool_)
    assert policy.act(seen(WALL)) == ACTIONS.nearest(AHEAD)


def test_it_has_the_senses_of_both_and_tells_the_policy_what_happens():
    inner = Doubter()
    policy = veto(inner)
    assert all(isinstance(policy, what) for what in (HearsSent, Levelled, NeedsSenses, TellsUnsafe, Warns))
    assert policy.senses == ("odometry", "gyro", "brake") and policy.warning
    policy.begin()
    policy.set_delay(2)
    policy.reset()
    action = policy.act(seen(WALL))
    policy.close()
    assert inner.told == ["begin", 2, "reset", action, "closed"] and action != inner.wants


def test_its_level_is_that_of_dwa():
    policy = follows()
    allowed = []
    for level in (0.0, 1.0, 2.0):
        policy.set_level(level)
        policy.reset()
        policy.act(seen(WALL))
        allowed.append(int((~policy.unsafe).sum()))
        assert policy.level == level
    assert allowed[0] > allowed[2]
    with pytest.raises(PolicyError, match="expected 0 to 2"):
        policy.set_level(3.0)


def test_names():
    kinds = {"dwa@0.5": "baseline", "tcp:5000": "served", "follow": "baseline", "mine:Policy": "class"}
    kinds |= {"runs/a:phase1": "folder", "runs/a@0.2": "folder", "shipped@0.2": "shipped"}
    for name, kind in kinds.items():
        named = parse_policy_name(f"veto:{name}")
        assert (named.veto, named.inner, named.kind) == (True, name, kind) and not parse_policy_name(name).veto
    named = parse_policy_name("veto:runs/a:phase1@0.2")
    assert (named.place, str(named.folder), named.stage, named.level) == ("runs/a:phase1", "runs/a", "phase1", 0.2)
    assert (parse_policy_name("b@home").place, parse_policy_name("dwa@0.5").level) == ("b@home", 0.5)
    assert _policy_at("veto:runs/a@0.2", lambda address: f"/far/{address}") == "veto:/far/runs/a@0.2"
    assert _identity_of("veto:dwa", "quick") == ["veto", "baseline", "dwa", "quick"] != _identity_of("dwa", "quick")
    assert resolve_policy_config("veto:dwa", "quick", ()) == resolve_policy_config("dwa", "quick", ())


def test_a_policy_that_sees_the_truth_needs_no_veto():
    with pytest.raises(PolicyError, match="sees the truth"):
        open_named_policy("veto:oracle", CONFIG, 0)
    rows = SimpleNamespace(name="rows", senses=("state",))
    with pytest.raises(PolicyError, match="rows sees the truth; expected one that sees pictures"):
        veto(rows)


def test_the_shipped_policy_drives_behind_a_veto():
    config = resolve_policy_config("veto:shipped", "quick", ())
    policy = open_named_policy("veto:shipped", config, 0)
    assert policy.name == "veto:shipped"
    policy.begin()
    policy.reset()
    assert 0 <= policy.act(observation(config)) < 81
