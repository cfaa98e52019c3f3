"""A controller of one's own, module:Class, driven in a town beside the user alone."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import QUICK

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
"""


@pytest.fixture
def own(folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    module = "own_controller"
    (folder / f"{module}.py").write_text(OWN)
    monkeypatch.delitem(sys.modules, module, raising=False)
    return module


def test_it_has_a_row_beside_the_user_alone(wcsim, folder, corner, own):
    words = ("--town", corner, "--only", "--allow-train-town", "--episodes", "1", "--max-steps", "20", *QUICK)
    assert wcsim("test", f"{own}:Still", *words, "--json", "rows.json").code == 0
    rows = {row["policy"]: row for row in json.loads((folder / "rows.json").read_text())["rows"]}
    assert set(rows) == {"still", "follow"}
    assert rows["still"]["km"] < 0.1 * rows["follow"]["km"]


@pytest.mark.parametrize(
    ("name", "said"),
    [("Nothing", "has no name, begin, reset, act; expected a class with"), ("Nobody", "has no class 'Nobody'")],
)
def test_a_class_that_is_no_controller_is_refused(wcsim, corner, own, name, said):
    told = wcsim("test", f"{own}:{name}", "--town", corner, "--only", "--allow-train-town", *QUICK)
    assert told.code == 2 and said in told.err
