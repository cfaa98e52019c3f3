"""`make results`: parts, what is typed, what is left of the user's crashes."""

import numpy as np
import pytest

from tools.results.__main__ import command_of, is_done, main
from tools.results.parts import Part, Step, parts
from tools.results.tables import left_of, page
from wcsim.config import load_run_config


def step_of(folder):
    return Step(words=("train",), again=("train", "--resume"), folder=folder / "run", makes=folder / "run" / "made")


def test_every_part_has_a_name_of_its_own_and_settings_that_exist(tmp_path):
    found = parts(tmp_path)
    assert len({part.name for part in found}) == len(found)
    for part in found:
        for step in part.steps:
            settings = [step.words[at + 1] for at, word in enumerate(step.words) if word == "--set"]
            if "--preset" in step.words:
                load_run_config(step.words[step.words.index("--preset") + 1], tuple(settings))


def test_what_is_made_is_not_made_again_and_what_was_stopped_goes_on(tmp_path):
    step = step_of(tmp_path)
    part = Part(name="p", says="", steps=(step,))
    assert command_of(step)[1:] == ["train"] and not is_done(part)
    (tmp_path / "run").mkdir()
    assert command_of(step)[1:] == ["train", "--resume"]
    (tmp_path / "run" / "made").touch()
    assert is_done(part)


def test_an_unknown_part_is_refused(tmp_path, capsys):
    assert main(["laptpo", "--out", str(tmp_path)]) == 2
    assert "'laptpo' is unknown; expected one of baselines" in capsys.readouterr().out
    assert main(["--list", "quick", "--out", str(tmp_path)]) == 0
    assert "quick" in capsys.readouterr().out


def test_what_is_left_is_none_for_the_oracle_and_all_for_the_user():
    rng = np.random.default_rng(1)
    km = np.ones(200)
    follow, oracle = (np.stack([rng.random(200) < rate, km], 1).astype(float) for rate in (0.5, 0.05))
    assert left_of([oracle], follow, oracle) == pytest.approx((0.0, 0.0, 0.0))
    assert left_of([follow, follow], follow, oracle) == pytest.approx((1.0, 1.0, 1.0))
    value, low, high = left_of([np.stack([rng.random(200) < 0.15, km], 1).astype(float)], follow, oracle)
    assert low < value < high and 0.0 < value < 0.6


def test_a_folder_without_tables_has_none(tmp_path):
    assert page(tmp_path) == ""
