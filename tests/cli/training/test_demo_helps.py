"""What the help of `wcsim demo` is worth: five seeds, pooled, beside the user alone and placebos."""

import numpy as np
import pytest

from tests.cli.training.placebo import NAMES
from wcsim.agents.evaluation.suite.records import CRASHED
from wcsim.agents.evaluation.suite.result_files import read_result
from wcsim.agents.evaluation.suite.run import SuiteOrder, run_suite
from wcsim.agents.opening.list_file import open_suite
from wcsim.agents.policy_api import UNAIDED
from wcsim.cli.main import main
from wcsim.cli.shared.consoles import print_note
from wcsim.towns.scene_folders.families import LISTED

SEEDS = range(1, 6)
DRAWS = 20_000


def gained(alone, helped):
    """How many fewer of the drives have a crash, as a share, and its 95 % interval, by drawing runs, then drives."""
    fewer = alone.astype(float) - helped
    runs, drives = fewer.shape
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, runs, (DRAWS, runs, 1)), rng.integers(0, drives, (DRAWS, 1, drives))
    return fewer.mean(), np.percentile(fewer[drawn].mean(axis=(1, 2)), (2.5, 97.5))


def crashed(records):
    return [record.status == CRASHED for record in records]


def test_help_that_always_helps_is_worth_a_drive_each_and_none_is_worth_nothing():
    alone = np.array([True] * 7 + [False] * 7)
    assert gained(alone, np.zeros((5, 14), bool))[0] == pytest.approx(0.5)
    share, (low, high) = gained(alone, np.tile(alone, (5, 1)))
    assert (share, low, high) == (0.0, 0.0, 0.0)


def test_the_list_is_what_its_page_says():
    file = open_suite("demo").file
    assert (file.suite, file.set) == ("street-help-v2", "demo")
    parts = [(block.part, len(block.episodes)) for block in file.blocks]
    seats = {part: sum(many for name, many in parts if name == part) for part, _ in parts}
    assert seats == {"hazard": 3, "tight": 4, "free": 7}
    assert {block.town for block in file.blocks if block.part == "tight"} < set(LISTED)
    others = [open_suite(name).file for name in ("guard", "hard", "dev2", "validation2", "v1")]
    assert not {town.sha256 for town in file.towns} & {town.sha256 for other in others for town in other.towns}
    drawn = {(block.town, block.seed) for other in others for block in other.blocks}
    assert not drawn & {(block.town, block.seed) for block in file.blocks}


@pytest.mark.proof
@pytest.mark.timeout(3600)
def test_five_seeds_crash_less_than_the_user_alone_and_than_placebos(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for seed in SEEDS:
        assert main(["demo", "--seed", str(seed), "--out", f"seed-{seed}"]) == 0
    results = [read_result(tmp_path / f"seed-{seed}" / "test").episodes for seed in SEEDS]
    order = SuiteOrder(suite=open_suite("demo"), out=tmp_path / "placebo", jobs=2, forks=0)
    placebos = run_suite(order, NAMES, lambda *_: None)
    alone = np.array(crashed(results[0][UNAIDED]))
    groups = {
        "network": np.array([crashed(found[f"seed-{seed}"]) for found, seed in zip(results, SEEDS, strict=True)]),
        "placebo": np.array([crashed(records) for records in placebos.values()]),
    }
    worth = {name: gained(alone, helped) for name, helped in groups.items()}
    with capsys.disabled():
        print_note(f"\nuser alone: a crash in {alone.sum()} of {alone.size} drives")
        for name, (share, (low, high)) in worth.items():
            print_note(
                f"{name}: {groups[name].sum(axis=1)} of {alone.size}, {share:+.2f} fewer ({low:+.2f} to {high:+.2f})"
            )
    assert worth["network"][1][0] > 0.0, "the interval lies above nothing"
    assert worth["network"][0] > worth["placebo"][0]
