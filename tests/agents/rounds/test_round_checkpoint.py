"""When a round counts as done: whatever fails before, it is done again to the same weights. Nobody drives here."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from tests.agents.danger.sights import a_segment, lectures, small_config, write_segment
from tests.agents.rounds.small_runs import SMALL, NoiseWorkers, outcome, run_in, train_in
from tests.support.one_process import files_of_at_most
from tests.support.worlds import dqn_config
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.rounds import train_rounds
from wcsim.agents.rounds.train_rounds import RoundProgress, _make_restore, _save_round, train_danger
from wcsim.agents.runs.checkpoint import STATE, _restore_newest, checkpoint_number_from_path, format_checkpoint_name
from wcsim.agents.runs.data_folder import DrivingSegmentKey, segment_path_from_name, write_data_manifest
from wcsim.agents.runs.metrics import read_round_metrics
from wcsim.agents.runs.run_folder import ResolvedRun
from wcsim.agents.runs.weights import write_policy_folder
from wcsim.cli.shared.run_config import settings_from_learner
from wcsim.config import resolve
from wcsim.core import files
from wcsim.errors import ConfigError, DiskFullError, InterruptedRunError, PolicyError
from wcsim.towns.scenario.town import Town

SETTINGS = ("danger.width=8", "collect.segments=1")


@pytest.fixture(autouse=True)
def noise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(train_rounds, "SegmentWorkers", NoiseWorkers)


def test_a_run_learns_from_the_driving_of_others_that_it_began_with_wherever_it_goes_on(
    corner: Path, corner_town: Town, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = (*SETTINGS, 'collect.data=["mine"]', "collect.rounds=2")
    monkeypatch.chdir(tmp_path)
    held = others_drive(Path("mine"), 2)
    learn, drawn = DangerLearner.learn, []

    def drawing(*given: Any) -> float:
        """As a network with dropout."""
        drawn.append(float(torch.rand(1)))
        return learn(*given)

    monkeypatch.setattr(DangerLearner, "learn", drawing)
    straight, stopped = (whole(run_in(corner, tmp_path / name, *words)) for name in ("straight", "stopped"))
    train_danger(straight, corner_town)

    def stop(now: RoundProgress) -> None:
        if now.updates:
            raise KeyboardInterrupt

    with pytest.raises(InterruptedRunError):
        train_danger(stopped, corner_town, progress=stop)
    others_drive(Path("mine"), 3)
    monkeypatch.chdir(tmp_path.parent)
    train_danger(replace(stopped, resume=True), corner_town)
    assert outcome(stopped.out) == outcome(straight.out)
    assert drawn[:2] == [drawn[2], drawn[-1]] and drawn[0] != drawn[1], "as in a run that was not stopped"
    assert json.loads((stopped.out / "learned_data.json").read_text())["folders"] == {str(tmp_path / "mine"): held}


@pytest.mark.parametrize("gone", [True, False])
def test_driving_of_others_that_is_gone_or_another_when_a_run_goes_on_is_told(
    corner: Path, corner_town: Town, tmp_path: Path, gone: bool
) -> None:
    words = (*SETTINGS, f'collect.data=["{tmp_path / "mine"}"]', "collect.rounds=1")
    (name,) = others_drive(tmp_path / "mine", 1)
    train_danger(run_in(corner, tmp_path / "run", *words), corner_town)
    path = tmp_path / "mine" / "segments" / name
    path.unlink() if gone else write_segment(path, a_segment(seed=99))
    told = r"No such file.*learned_data\.json names it" if gone else r"replaced.*learned_data\.json names it"
    with pytest.raises(PolicyError, match=told):
        train_danger(run_in(corner, tmp_path / "run", *words, resume=True), corner_town)


def test_a_run_that_nobody_drives_for_or_nobody_could_is_refused_before_towns_are_made(
    corner: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(train_rounds, "_find_towns", None)
    run, told = tmp_path / "run", r"no data to learn from; expected --data FOLDER, or collect\.segments of 1"
    with pytest.raises(ConfigError, match=told):
        train_in(corner, run, "collect.segments=0")
    with pytest.raises(ConfigError, match="variants: 'nonsense' cannot be used"):
        train_in(corner, run, 'collect.variants=["nonsense"]')
    assert not run.exists()


def test_folders_without_driving_are_refused_where_nobody_drives(
    corner: Path, corner_town: Town, tmp_path: Path
) -> None:
    others_drive(tmp_path / "mine", 0)
    run = run_in(corner, tmp_path / "run", "collect.segments=0", f'collect.data=["{tmp_path / "mine"}"]')
    with pytest.raises(PolicyError, match="mine: holds no data to learn from"):
        train_danger(run, corner_town)


def others_drive(folder: Path, count: int) -> dict[str, str]:
    """A data folder with so many segments of noise; their SHA-256 by file name."""
    paths = [
        segment_path_from_name(folder, DrivingSegmentKey(run=8, round=0, index=index).name) for index in range(count)
    ]
    held = {path.name: write_segment(path, a_segment(seed=50 + number)) for number, path in enumerate(paths)}
    write_data_manifest(folder, dqn_config(*SMALL), {"corner": "0" * 64}, held)
    return held


def whole(run: ResolvedRun) -> ResolvedRun:
    """As the command line resolves it."""
    return replace(run, config=resolve(run.config, settings_from_learner(run.config)))


def a_learner() -> DangerLearner:
    learner = DangerLearner(small_config(), 1, 2)
    learner.loss = 0.5
    return learner


def load_round(folder: Path) -> tuple[int, dict[str, str]]:
    """The round that a run goes on from, and the segments that it had learned from."""
    found = _restore_newest(folder, _make_restore(a_learner()))
    return checkpoint_number_from_path(found.path), found.value


def saved(
    folder: Path, number: int = 0, segments: dict[str, str] | None = None, learner: DangerLearner | None = None
) -> Path:
    """The state of a checkpoint."""
    _save_round(folder, number, learner or a_learner(), segments or {})
    return folder / format_checkpoint_name("round", number) / STATE


@pytest.fixture(scope="module")
def straight(corner: Path, corner_town: Town, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing happened to."""
    run = run_in(corner, tmp_path_factory.mktemp("rounds") / "straight", *SETTINGS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train_rounds, "SegmentWorkers", NoiseWorkers)
        train_danger(run, corner_town)
    return run.out


@pytest.mark.parametrize("step", ["_save_policy", "append_round_metrics", "_save_round"])
def test_a_round_whose_files_cannot_be_written_is_done_again_to_the_same_weights(
    corner: Path, corner_town: Town, straight: Path, tmp_path: Path, step: str
) -> None:

    def full(*words: object) -> None:
        raise DiskFullError("no room")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train_rounds, step, full)
        with pytest.raises(DiskFullError):
            train_danger(run_in(corner, tmp_path / "full", *SETTINGS), corner_town)
    train_danger(run_in(corner, tmp_path / "full", *SETTINGS, resume=True), corner_town)
    assert outcome(tmp_path / "full") == outcome(straight)
    assert [row.round for row in read_round_metrics(tmp_path / "full" / "metrics.csv")] == [0, 1, 2]


def test_a_round_with_very_many_segments_is_kept_and_found(tmp_path: Path) -> None:
    segments = {f"3-{number // 4000:03d}-{number % 4000:04d}.npz.zst": "a" * 64 for number in range(12_000)}
    saved(tmp_path, 0, segments)
    assert load_round(tmp_path) == (0, segments)


@pytest.mark.parametrize("name", ["../../3-000-0000.npz.zst", "3-000.npz.zst", "a-b-c.npz.zst"])
def test_a_checkpoint_that_names_what_is_no_segment_is_refused(tmp_path: Path, name: str) -> None:
    resealed(saved(tmp_path), segments={name: "a" * 64})
    with pytest.raises(PolicyError, match=r"no segment's file|pattern"):
        load_round(tmp_path)


@pytest.mark.parametrize("key", ["updates", "loss", "segments"])
def test_a_checkpoint_whose_state_is_damaged_is_passed_over_for_the_one_before(tmp_path: Path, key: str) -> None:
    _, path = (saved(tmp_path, number, {"3-000-0000.npz.zst": "a" * 64}) for number in range(2))
    state = json.loads(path.read_text())
    changed = {"3-000-0000.npz.zst": "b" * 64} if key == "segments" else state[key] + 1
    path.write_text(json.dumps({**state, key: changed}))
    found = _restore_newest(tmp_path, _make_restore(a_learner()))
    assert checkpoint_number_from_path(found.path) == 0
    assert ["its content does not match its hash" in reason for reason in found.passed_over.values()] == [True]
    seal = state.pop("seal")
    path.write_text(json.dumps({**state, "sea1": seal}))
    assert load_round(tmp_path)[0] == 0, "a seal under another name is none"
    path.write_text(json.dumps(state))
    assert load_round(tmp_path)[0] == 0, "without one, it may be anybody's"


def test_a_full_disk_is_told_in_words(tmp_path: Path) -> None:
    with files_of_at_most(1 << 12):
        with pytest.raises(DiskFullError, match="make room"):
            saved(tmp_path)
        with pytest.raises(DiskFullError, match="make room"):
            write_policy_folder(tmp_path / "policy", torch.nn.Linear(100, 100), {})
    assert not (tmp_path / "policy").exists() and list(tmp_path.glob("round*")) == []


def test_a_sparse_file_in_place_of_arrays_is_never_read(tmp_path: Path) -> None:
    _, newest = (saved(tmp_path, number) for number in range(2))
    for size in ((1 << 42) - 1, 60 << 30):
        os.truncate(newest.with_name("weights.safetensors"), size)
        assert load_round(tmp_path)[0] == 0


@pytest.mark.parametrize(
    "name, change",
    [
        ("weights", lambda value: torch.full_like(value, torch.nan)),
        ("weights", lambda value: value.double()),
        ("moments", lambda value: torch.full_like(value, torch.inf)),
        ("moments", lambda value: value.flatten()[:1]),
    ],
)
def test_arrays_that_are_none_of_a_learner_are_refused_however_right_their_hash(
    tmp_path: Path, name: str, change: Callable[[torch.Tensor], torch.Tensor]
) -> None:
    learner = a_learner()
    learner.learn(lectures(small_config()), 1)
    state = saved(tmp_path, learner=learner)
    path = state.with_name(f"{name}.safetensors")
    held = load_file(path)
    key = next(key for key, value in held.items() if value.numel() > 1)
    save_file({**held, key: change(held[key]).contiguous()}, path)
    arrays = list(path.parent.glob("*.saf*"))
    resealed(
        state,
        sha256={item.name: files.sha256_from_file(item) for item in arrays},
        bytes={item.name: item.stat().st_size for item in arrays},
    )
    with pytest.raises(PolicyError, match=rf"{re.escape(key)}|not finite"):
        _restore_newest(tmp_path, _make_restore(learner))


@pytest.mark.parametrize("changes", [{"updates": "7"}, {"loss": True}, {"segments": []}, {"segments": {"a": 1}}])
def test_a_state_of_other_types_is_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    resealed(saved(tmp_path), **changes)
    with pytest.raises(PolicyError, match=rf"{next(iter(changes))}.*got"):
        load_round(tmp_path)


def resealed(path: Path, **changes: Any) -> None:
    """Say something else, under a seal that fits."""
    state = {**json.loads(path.read_text()), **changes}
    del state["seal"]
    files.write_json_with_checksum(path, state)
