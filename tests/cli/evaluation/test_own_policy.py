"""A controller of one's own, module:Class, driven in a town beside the user alone."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.agents.evaluation.suite.lists import written_list
from tests.cli.conftest import QUICK, parsed
from wcsim.config import resolve

EXAMPLES = Path(__file__).parents[3] / "examples"
EXAMPLE = EXAMPLES / "own_policy.py"

OWN = """
class Still:
    name = "still"

    def __init__(self, config):
        self.rest = 40

    def begin(self):
        pass

    def reset(self):
        pass

    def act(self, observation):
        assert observation["joystick"].shape == (2,)
        return self.rest


class Nothing:
    def __init__(self, config):
        pass


class Plain:
    pass


class Missing(Still):
    def __init__(self, config):
        open("weights.zip")


class Boom(Still):
    def act(self, observation):
        return observation["lidar"]
"""


@pytest.fixture
def own(folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    module = "own_controller"
    (folder / f"{module}.py").write_text(OWN)
    monkeypatch.delitem(sys.modules, module, raising=False)
    return module


@pytest.fixture(scope="module")
def listed(corner, tmp_path_factory):
    return written_list(corner, tmp_path_factory.mktemp("list"), max_steps=5)


def test_it_has_a_row_beside_the_user_alone(wcsim, folder, corner, own):
    words = ("--town", corner, "--only", "--allow-train-town", "--episodes", "1", "--max-steps", "20", *QUICK)
    assert wcsim("test", f"{own}:Still", *words, "--json", "rows.json").code == 0
    rows = {row["policy"]: row for row in parsed(folder / "rows.json")["rows"]}
    assert set(rows) == {f"{own}:Still", "follow"}
    assert rows[f"{own}:Still"]["km"] < 0.1 * rows["follow"]["km"]


def test_policies_that_are_tested_together_take_turns_in_the_chairs_of_one_street(wcsim, folder, corner, own):
    words = (f"{own}:Still", "--together", "--town", corner, "--allow-train-town", "--max-steps", "20", *QUICK)
    assert "two or more policies" in wcsim("test", *words).err
    assert wcsim("test", "random", *words, "--episodes", "2", "--out", "x").code == 0
    driven = parsed(folder / "x" / "episodes.json")
    seats, (_, random_m, still_m) = (
        [[each[key] for each in found] for found in driven.values()] for key in ("seat", "m")
    )
    assert seats == [[0, 1, 0, 1], [0, 1], [1, 0]], "of the user alone all; the others change places"
    assert max(still_m) < 0.1 * min(random_m), "each seat is driven by whom its record is of"


@pytest.mark.parametrize(
    "name, message",
    [("Nothing", "has no name, begin, reset, act; expected a class with"), ("Nobody", "has no class 'Nobody'"),
     ("Plain", "'own_controller:Plain' could not be created with the configuration"), ("Missing", "'weights.zip'")],
)  # fmt: skip
def test_a_class_that_is_no_controller_is_refused(wcsim, corner, own, name, message):
    result = wcsim("test", f"{own}:{name}", "--town", corner, "--only", "--allow-train-town", *QUICK)
    assert result.code == 2 and message in result.err and "Traceback" not in result.err


def test_a_class_that_is_named_by_its_file_is_refused_with_the_name_that_works(wcsim, corner, own):
    result = wcsim("test", f"{own}.py:Still", "--town", corner, "--only", "--allow-train-town", *QUICK)
    assert result.code == 2 and f"expected module:Class, without .py: {own}:Still" in result.err


def test_in_a_suite_a_class_that_cannot_be_built_is_refused_before_anything_is_driven(wcsim, folder, listed, own):
    result = wcsim("test", "--suite", listed, f"{own}:Still", f"{own}:Missing", "--only", "--out", "out")
    assert result.code == 2 and "'own_controller:Missing' could not be created" in result.err
    assert "blocks" not in result.err and not (folder / "out").exists()
    played = wcsim("test", "--suite", listed, f"{own}:Missing", "--play", "0.0", "--out", "out")
    assert played.code == 2 and "'own_controller:Missing' could not be created" in played.err


def test_in_a_suite_a_class_that_always_fails_is_told_with_its_reason(wcsim, folder, listed, own, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    result = wcsim("test", "--suite", listed, f"{own}:Boom", "--only", "--out", "out")
    assert result.code == 1 and "own_controller:Boom: failed in 2 of 2 episodes: KeyError: 'lidar' (" in result.out
    assert f"{own}.py, line " in result.out, "as other commands say where"
    rows = {row["policy"]: row for row in parsed(folder / "out" / "result.json")["pooled"]}
    assert [rows[name]["status"]["policy_failed"] for name in ("follow", f"{own}:Boom")] == [0, 2]


def test_the_example_is_tested_in_a_town_and_creeps_before_what_is_near(wcsim, folder, corner, monkeypatch):
    """As a user does it, beside the file."""
    (folder / EXAMPLE.name).write_bytes(EXAMPLE.read_bytes())
    monkeypatch.delitem(sys.modules, "own_policy", raising=False)
    words = ("--town", corner, "--only", "--allow-train-town", "--episodes", "1", "--max-steps", "10", *QUICK)
    assert wcsim("test", "own_policy:Careful", *words, "--json", "rows.json").code == 0
    assert {row["policy"] for row in parsed(folder / "rows.json")["rows"]} == {*("follow", "own_policy:Careful")}

    policy = sys.modules["own_policy"].Careful(resolve("quick"))
    seen = {"depth": np.zeros((1, 24, 32), np.uint8), "joystick": np.array([0.0, 1.0], np.float32)}
    given, warned = [], []
    for code in (0, 255, 60):  # nothing measured, far, near
        seen["depth"][:] = code
        given.append(policy.actions.points[policy.act(seen)].tolist())
        warned.append(policy.warning)
    assert (given, warned) == ([[0.0, 1.0], [0.0, 1.0], [0.0, 0.25]], [False, False, True])


def test_a_controller_that_sees_numbers_drives_a_list_as_its_training_ended(wcsim, folder, listed, monkeypatch):
    for name in ("cleanrl_ppo", "state_policy"):
        (folder / f"{name}.py").write_bytes((EXAMPLES / f"{name}.py").read_bytes())
        monkeypatch.delitem(sys.modules, name, raising=False)
    missing = wcsim("test", "--suite", listed, "state_policy:Trained", "--only")
    assert missing.code == 2 and "cleanrl_ppo.pt" in missing.err
    agent = sys.modules["cleanrl_ppo"].Agent()
    torch.nn.init.zeros_(agent.actor.out.weight)
    agent.actor.out.bias.data = torch.eye(10)[7] * 9.0  # backwards is by far the likeliest
    torch.save(agent.state_dict(), folder / "cleanrl_ppo.pt")
    for refused in ("veto:state_policy:Trained", "dwa"):
        result = wcsim("test", "--suite", listed, refused, "--only", "--set", "env.observation=state", "--out", refused)
        assert result.code == 2 and "Traceback" not in result.err and "pictures" in result.err, refused
    assert wcsim("test", "--suite", listed, "state_policy:Trained", "--only", "--out", "out").code == 0
    rows = {row["policy"]: row for row in parsed(folder / "out" / "result.json")["pooled"]}
    assert rows["state_policy:Trained"]["status"]["policy_failed"] == 0
    assert rows["follow"]["kpi1"] < 0.1 < 0.4 < rows["state_policy:Trained"]["kpi1"]
    assert wcsim("report", "out", "--own", "state_policy:Trained").code == 0
    page = (folder / "out" / "report.html").read_text()
    shown = re.findall(r'<details class="(failure[^"]*)"[^>]*data-policy="([^"]+)"', page)
    assert set(shown) == {("failure pictured", name) for name in ("follow", "state_policy:Trained")}
    assert wcsim("test", "state_policy:Trained", "--suite", listed, "--play", "0.0", "--out", "out").code == 0
