"""Checkpoints: which one is resumed from, which ones are kept, and what is refused."""

import json
import shutil
import signal

import pytest
import torch
from stable_baselines3.common.vec_env import DummyVecEnv

from tests.agents.toy import load_checkpoint, train_toy
from tests.attack.files.checkpoints import Bench, config, content, street
from wcsim.agents.learning.build import build_q_learner
from wcsim.agents.learning.checkpoint import save_checkpoint
from wcsim.agents.runs.checkpoint import STATE, list_checkpoints
from wcsim.agents.runs.metrics import read_metrics
from wcsim.agents.runs.run_folder import open_run
from wcsim.core import files
from wcsim.errors import InterruptedRunError, PolicyError

MODEL = "model.safetensors"
BAD = {
    "name": "step-00000080", "n_updates": -5, "episodes": None, "extra": [1], "sha256": {}, "replay_rng": None,
    "explore_rng": {}, "schema_version": 2,
}  # fmt: skip


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return Bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture
def folder(bench, tmp_path):
    bench.fresh()
    return shutil.copytree(bench.sound, tmp_path / "checkpoints")


def names(folder):
    return [path.name for path in list_checkpoints(folder)]


def test_the_newest_is_that_of_the_largest_number(bench, folder):
    load_checkpoint(folder, bench.model)
    for step in (99_990_000, 99_995_000, 99_999_000, 100_000_000, 100_000_001):
        bench.model.num_timesteps = step
        assert save_checkpoint(folder, bench.model, {}).is_dir()
    assert names(folder) == ["step-99999000", "step-100000000", "step-100000001"]
    assert load_checkpoint(folder, bench.model).path.name == "step-100000001"


def test_one_that_is_read_is_heard_of_meanwhile(bench, folder):
    heard = []
    load_checkpoint(folder, bench.model, lambda: heard.append(bench.model.replay_buffer.total))
    assert len(heard) >= 2
    assert max(heard) < bench.model.replay_buffer.total, "before all of it was there"


def test_one_that_was_just_written_is_kept_whatever_others_there_are(bench, folder):
    load_checkpoint(folder, bench.model)
    bench.model.num_timesteps = 7
    assert save_checkpoint(folder, bench.model, {}).is_dir()
    assert names(folder) == ["step-00000007", "step-00000040", "step-00000080", "step-00000120"]


def test_names_that_are_none_are_neither_used_nor_deleted(bench, folder):
    shutil.copytree(folder / "step-00000040", folder / "step-00000120-copy")
    (folder / "step-zzz").symlink_to("/")
    (folder / "step-00000200").symlink_to("step-00000040")
    assert load_checkpoint(folder, bench.model).path.name == "step-00000120"
    bench.model.num_timesteps = 160
    save_checkpoint(folder, bench.model, {})
    assert names(folder) == ["step-00000080", "step-00000120", "step-00000160"]
    assert {"step-00000120-copy", "step-zzz", "step-00000200"} <= {path.name for path in folder.iterdir()}


def test_what_a_killed_process_left_of_one_goes_with_the_next_and_nothing_else_does(bench, folder):
    load_checkpoint(folder, bench.model)
    ours, others = (
        (".step-00000007.9-a.tmp", ".step-00000040.9-a.old"),
        (".step-7.tmp", ".step-00000007.mine", ".a.tmp"),
    )
    for name in (*ours, *others):
        (folder / name).mkdir()
        (folder / name / MODEL).write_bytes(b"begun")
    (folder / ".step-00000008.tmp").symlink_to("step-00000040")
    bench.model.num_timesteps = 160
    save_checkpoint(folder, bench.model, {})
    begun = {path.name for path in folder.iterdir() if path.name.startswith(".")}
    assert begun == {*others, ".step-00000008.tmp"}


@pytest.mark.parametrize("sealed", [False, True])
@pytest.mark.parametrize("key", BAD)
def test_a_state_with_another_value_is_passed_over(bench, folder, key, sealed):
    file = folder / "step-00000120" / STATE
    data = json.loads(file.read_text())
    file.write_text(json.dumps({**data, key: BAD[key]}))
    if sealed:
        del data["seal"]
        files.write_json_with_checksum(file, {**data, key: BAD[key]})
    loaded = load_checkpoint(folder, bench.model)
    assert loaded.path.name == "step-00000080"
    assert [path.name for path in loaded.passed_over] == ["step-00000120"]
    assert content(bench.model, loaded.value.model_dump()) == bench.known[80]


@pytest.mark.parametrize("version", [{}, {"schema_version": 2}, {"schema_version": 3}])
def test_checkpoints_of_an_older_version_are_refused_with_what_to_do(bench, folder, version):
    for path in list_checkpoints(folder):
        data = json.loads((path / STATE).read_text())
        del data["schema_version"], data["seal"]
        (path / STATE).write_text(json.dumps({**data, **version}))
    told = f"is of version {version.get('schema_version')}, expected 4: finish the run with the wcsim that began it"
    with pytest.raises(PolicyError, match=told):
        load_checkpoint(folder, bench.model)


def test_a_learner_is_what_it_was_when_all_are_refused(bench, folder):
    for path in list_checkpoints(folder):
        (path / MODEL).write_bytes(b"")
    with pytest.raises(PolicyError, match="no intact checkpoint that fits") as told:
        load_checkpoint(folder, bench.model)
    assert all(path.name in str(told.value) for path in list_checkpoints(folder))
    assert content(bench.model, {}) == bench.blank


def test_what_was_passed_over_is_said_and_set_aside(tmp_path):
    out, told = tmp_path / "run", []

    def stop(now):
        if now.step >= 90 and not out.joinpath("stopped").exists():
            out.joinpath("stopped").touch()
            raise KeyboardInterrupt

    with pytest.raises(InterruptedRunError):
        train_toy(config(), out, street, stop, progress_every=10)
    newest = list_checkpoints(out / "checkpoints")[-1]
    (newest / STATE).write_text("[" * 100_000)
    train_toy(config(), out, street, resume=True, log=told.append)
    assert open_run(out).manifest.status == "done"
    assert [newest.name in line and "not JSON" in line for line in told] == [True]
    assert newest.with_name(f"{newest.name}.damaged").is_dir()
    assert any(json.loads(line)["event"] == "passed_over" for line in (out / "events.jsonl").read_text().splitlines())


def test_a_storm_of_signals_leaves_a_run_that_can_be_resumed(tmp_path):
    out, before = tmp_path / "run", signal.getsignal(signal.SIGTERM)

    def storm():
        for _ in range(2 if signal.getsignal(signal.SIGTERM) is not before else 0):
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(InterruptedRunError):
        train_toy(config(), out, street, lambda now: now.step >= 60 and storm(), progress_every=10)
    assert open_run(out).manifest.status == "interrupted"
    train_toy(config(), out, street, resume=True)
    assert open_run(out).manifest.status == "done"


def test_a_run_without_a_checkpoint_begins_again(tmp_path):
    """As after a disk that was full before the first one."""
    once, out, told = train_toy(config(), tmp_path / "once", street), tmp_path / "run", []
    shutil.copytree(once, out)
    shutil.rmtree(out / "checkpoints")
    train_toy(config(), out, street, resume=True, log=told.append)
    assert "starts again" in told[0]
    rows = [read_metrics(run / "metrics.csv") for run in (once, out)]
    one, other = ([{k: v for k, v in row.items() if "wall" not in k} for row in some] for some in rows)
    assert one == other


def test_two_cannot_learn_in_one_folder(tmp_path):
    def again(now):
        with pytest.raises(PolicyError, match="by another process"):
            train_toy(config(), tmp_path / "run", street, resume=True)

    train_toy(config(), tmp_path / "run", street, again, progress_every=60)


def learn_on(wrote, folder):
    """The newest of four more checkpoints, of weights alone."""
    for _ in range(4):
        wrote.learn(20, reset_num_timesteps=False)
        newest = save_checkpoint(folder, wrote, {}, replay=False)
    return newest


def test_checkpoints_of_weights_share_the_newest_replay_and_restore(tmp_path):
    wrote = build_q_learner(config(), DummyVecEnv([street]), 1)
    wrote.learn(60)
    first = save_checkpoint(tmp_path, wrote, {})
    newest = learn_on(wrote, tmp_path)
    assert newest.name == "step-00000140"
    assert (newest / "replay.safetensors").samefile(next(tmp_path.glob("step-*")) / "replay.safetensors")
    again = build_q_learner(config(), DummyVecEnv([street]), 2)
    assert load_checkpoint(tmp_path, again).path == newest
    assert (again.num_timesteps, again.replay_buffer.total) == (140, 60)
    assert all(torch.equal(a, b) for a, b in zip(wrote.q_net.parameters(), again.q_net.parameters(), strict=True))
    save_checkpoint(tmp_path, wrote, {})
    newest = learn_on(wrote, tmp_path)
    assert not first.exists()
    (newest / "replay.safetensors").write_bytes(b"damaged")  # all that share it
    found = load_checkpoint(tmp_path, build_q_learner(config(), DummyVecEnv([street]), 2))
    assert found.path.name == "step-00000120" and len(found.passed_over) == 3, "the last one with the replay before"
