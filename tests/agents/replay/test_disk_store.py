"""Frames on disk: what is read is what was written, whatever was done to the process or to the files."""

import inspect
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.agents.replay.test_buffer import ENDS, SPACE, Reference, check, fill
from wcsim.agents.replay import disk_store
from wcsim.agents.replay.buffer import FrameReplay, ReplaySettings
from wcsim.agents.replay.disk_store import RECORD, STORE_JSON, DiskFrames, blobs_path, index_path, segments_in
from wcsim.agents.replay.state import replay_arrays, require_fit, restore_replay
from wcsim.errors import DiskFullError, PolicyError

SIZE = 300


def frame(number, size=SIZE):
    return np.random.default_rng(number).integers(0, 2 + number % 200, size, dtype=np.uint8)


def store(folder, steps=100, seats=1, size=SIZE, layout="x"):
    return DiskFrames(folder, steps, seats, size, layout)


def write(frames, count, first=0):
    for number in range(first, first + count):
        frames.write(number, 0, frame(number))


def same(frames, numbers):
    index = np.array(list(numbers))
    return [np.array_equal(row, frame(n)) for row, n in zip(frames.read(index, 0 * index), index, strict=True)]


@pytest.fixture
def short(monkeypatch):
    """Segments of eight frames."""
    monkeypatch.setattr(disk_store, "SEGMENT_BLOBS", 8)


def test_what_is_read_is_what_was_written_also_when_it_is_opened_again(short, tmp_path):
    with store(tmp_path / "r") as frames:
        write(frames, 30)
        assert all(same(frames, range(30)))
    with store(tmp_path / "r") as frames:
        assert (frames.next_number, frames.notes) == (30, [])
        assert all(same(frames, range(30)))
        write(frames, 5, 30)
        assert all(same(frames, range(35)))
        assert not frames.read(np.array([35, 999, -1]), np.array([0, 0, 0])).any()


def test_the_oldest_segments_files_go_and_a_checkpoint_can_hold_them(short, tmp_path):
    with store(tmp_path, steps=20) as frames:
        write(frames, 100)
        assert segments_in(tmp_path) == [9, 10, 11, 12]
        assert all(same(frames, range(80, 100)))
        assert not any(same(frames, range(60, 80)))
        frames.hold(75)
        write(frames, 60, 100)
        assert segments_in(tmp_path)[0] == 9
        frames.hold(None)
        assert segments_in(tmp_path)[0] == 140 // 8
    with store(tmp_path, steps=20) as frames:
        assert all(same(frames, range(140, 160)))
        assert not any(same(frames, range(120, 140)))


def test_more_frames_than_any_limit_of_open_files_and_no_more_memory(short, monkeypatch, tmp_path):
    monkeypatch.setattr(disk_store, "_MOST_OPEN", 4)
    with store(tmp_path, steps=200) as frames:
        held = frames.index_bytes
        write(frames, 400)
        assert frames.index_bytes == held == 200 * 16
        assert len(segments_in(tmp_path)) > 20
        order = np.random.default_rng(0).permutation(np.arange(200, 400))
        assert all(same(frames, order))
        assert len(frames._reader._open) <= 4
        on_disk = sum(path.stat().st_size for path in tmp_path.glob("*.blobs"))
        assert on_disk > held


@pytest.mark.parametrize("number", [0, 5, 8, 21, 29])
def test_what_is_written_again_takes_the_place_of_all_that_came_after(short, tmp_path, number):
    with store(tmp_path) as frames:
        write(frames, 30)
        frames.write(number, 0, frame(77))
        assert frames.next_number == number + 1
        assert all(same(frames, range(number)))
        assert np.array_equal(frames.read(np.array([number]), np.array([0]))[0], frame(77))
    with store(tmp_path) as frames:
        assert frames.next_number == number + 1
        assert all(same(frames, range(number)))


def test_a_gap_begins_anew(short, tmp_path):
    with store(tmp_path) as frames:
        write(frames, 10)
        write(frames, 10, 500)
        assert all(same(frames, range(500, 510)))
        assert not any(same(frames, range(10)))
    with store(tmp_path) as frames:
        assert frames.next_number == 510
        assert all(same(frames, range(500, 510)))


WRITER = f"""
import sys
from pathlib import Path
import numpy as np
from wcsim.agents.replay.disk_store import DiskFrames
SIZE = {SIZE}
{inspect.getsource(frame)}
with DiskFrames(Path(sys.argv[1]), 100_000, 1, 20_000, "x") as frames:
    number = frames.next_number
    while True:
        frames.write(number, 0, frame(number, 20_000))
        number += 1
        print(number, flush=True)
"""


def test_a_killed_process_leaves_every_whole_frame(tmp_path):
    told = 0
    for _ in range(3):
        wanted = told + 150
        with subprocess.Popen(
            [sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True
        ) as writer:
            for line in writer.stdout:
                told = int(line) if line.endswith("\n") else told
                if told == wanted:
                    writer.send_signal(signal.SIGKILL)
        assert writer.returncode == -signal.SIGKILL
        assert told >= wanted
        with store(tmp_path, steps=100_000, size=20_000) as frames:
            assert told <= frames.next_number <= told + 1
            index = np.arange(frames.next_number)
            read = frames.read(index, 0 * index)
            assert all(np.array_equal(row, frame(n, 20_000)) for n, row in enumerate(read))
        told = frames.next_number


def test_a_store_can_be_cut_short_anywhere(short, tmp_path):
    """Of the newest segment, whole frames stay, and what was torn off is told."""
    with store(tmp_path / "whole") as frames:
        write(frames, 21)
    blobs, index = blobs_path(tmp_path / "whole", 2).read_bytes(), index_path(tmp_path / "whole", 2).read_bytes()
    ends = np.frombuffer(index, RECORD)["offset"] + np.frombuffer(index, RECORD)["length"]
    cuts = [(len(blobs), k) for k in range(0, len(index), 5)] + [(k, len(index)) for k in range(0, len(blobs), 37)]
    for number, (data, records) in enumerate(cuts):
        folder = tmp_path / str(number)
        folder.mkdir()
        for path in (tmp_path / "whole").iterdir():
            (folder / path.name).write_bytes(path.read_bytes())
        blobs_path(folder, 2).write_bytes(blobs[:data])
        index_path(folder, 2).write_bytes(index[:records])
        with store(folder) as frames:
            left = 16 + min(records // RECORD.itemsize, int((ends <= data).sum()))
            assert frames.next_number == left
            assert all(same(frames, range(left)))
            exact = data == (ends[left - 17] if left > 16 else 0) and records == (left - 16) * RECORD.itemsize
            assert bool(frames.notes) == (not exact)
            write(frames, 10, left)
            assert all(same(frames, range(left + 10)))


def test_a_changed_byte_in_the_newest_segment_is_cut_off_and_in_another_refused(short, tmp_path):
    with store(tmp_path) as frames:
        write(frames, 20)
    for segment, path in ((2, blobs_path(tmp_path, 2)), (0, blobs_path(tmp_path, 0))):
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(data)
        with store(tmp_path) as frames:
            if segment == 2:
                assert 16 <= frames.next_number < 20
                assert "truncated frame were removed" in frames.notes[0]
                assert all(same(frames, range(frames.next_number)))
            else:
                with pytest.raises(
                    PolicyError, match=r"segment-00000000\.blobs: frame \d is damaged .*start a new run"
                ):
                    frames.read(np.arange(8), np.zeros(8, int))


@pytest.mark.parametrize("lose", ["index", "blobs", "cut"])
def test_a_lost_segment_in_the_middle_is_missed_by_whoever_counts_on_it(short, tmp_path, lose):
    with store(tmp_path) as frames:
        write(frames, 30)
        sealed = frames.seal(10, 30)
    path = {"index": index_path, "blobs": blobs_path, "cut": index_path}[lose](tmp_path, 2)
    if lose == "cut":
        path.write_bytes(path.read_bytes()[:-40])
    else:
        path.unlink()
    with store(tmp_path) as frames:
        assert isinstance(sealed, int)
        lost = 2 if lose == "cut" else 8
        with pytest.raises(PolicyError, match=f"lacks {lost} of the frames 10 to 30"):
            frames.seal(10, 30)
        assert not any(same(frames, range(24 - lost, 24)))
        assert frames.seal(24, 30) > 0
        with pytest.raises(PolicyError, match="lacks 1 of the frames 24 to 31"):
            frames.seal(24, 31)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"size": 200}, "frame_bytes"), ({"seats": 2}, "seats"), ({"layout": "y"}, "layout"), ({}, "version"),
    ],
)  # fmt: skip
def test_another_layout_or_version_is_refused(tmp_path, change, told):
    with store(tmp_path) as frames:
        write(frames, 3)
    if not change:
        data = json.loads((tmp_path / STORE_JSON).read_text())
        (tmp_path / STORE_JSON).write_text(json.dumps({**data, "version": 2}))
    with pytest.raises(PolicyError, match=rf"{told} .* instead of .*start a new run"):
        store(tmp_path, **change)


@pytest.mark.parametrize("how", ["gone", "torn", "list"])
def test_a_folder_without_a_sound_description_is_refused(tmp_path, how):
    with store(tmp_path) as frames:
        write(frames, 3)
    path = tmp_path / STORE_JSON
    if how == "gone":
        path.unlink()
    else:
        path.write_text(path.read_text()[:-9] if how == "torn" else "[]")
    with pytest.raises(PolicyError, match=r"store\.json"):
        store(tmp_path)
    path.unlink(missing_ok=True)
    assert len(segments_in(tmp_path)) == 1


def test_two_at_a_time_are_refused(tmp_path):
    with store(tmp_path), pytest.raises(PolicyError, match="open in another process"):
        store(tmp_path)
    with store(tmp_path) as frames:
        frames.close()
        store(tmp_path).close()


def test_a_full_disk_leaves_what_was_written(tmp_path, monkeypatch):
    with store(tmp_path) as frames:
        write(frames, 3)
        real, calls = disk_store._write, []

        def torn(descriptor, data):
            calls.append(len(data))
            real(descriptor, data[: len(data) // 2])
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(disk_store, "_write", torn)
        with pytest.raises(DiskFullError, match="No space left"):
            write(frames, 1, 3)
        monkeypatch.setattr(disk_store, "_write", real)
        assert calls
        write(frames, 3, 3)
        assert all(same(frames, range(6)))
    with store(tmp_path) as frames:
        assert (frames.next_number, frames.notes) == (6, [])


def open_files():
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.parametrize("place", [blobs_path, index_path])
def test_a_disk_that_is_full_when_a_segment_begins_leaves_what_was_written(short, tmp_path, monkeypatch, place):
    with store(tmp_path) as frames:
        write(frames, 8)
        real, before = os.open, open_files()

        def full(path, *how):
            if path == place(tmp_path, 1):
                raise OSError(28, "No space left on device")
            return real(path, *how)

        monkeypatch.setattr(os, "open", full)
        for _ in range(2):
            with pytest.raises(DiskFullError, match=r"No space left on device.*make room and --resume"):
                write(frames, 1, 8)
        monkeypatch.setattr(os, "open", real)
        assert open_files() < before, "the segment before is closed, and nothing else open"
        write(frames, 3, 8)
        assert all(same(frames, range(11)))
    with store(tmp_path) as frames:
        assert (frames.next_number, frames.notes) == (11, [])


# --- the memory over it ---


def on_disk(folder, rows=40, seats=1, **chosen):
    chosen = ReplaySettings(**{"n_step": 3, "gamma": 0.9, "seed": 1, **chosen}, folder=folder)
    return FrameReplay(rows * seats, SPACE, gym.spaces.Discrete(81), device="cpu", n_envs=seats, settings=chosen)


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_every_draw_is_the_references_transition(tmp_path_factory, data):
    seats, rows = data.draw(st.integers(1, 3)), data.draw(st.integers(4, 40))
    ends = st.lists(st.sampled_from(ENDS), min_size=seats, max_size=seats)
    plan = data.draw(st.lists(ends, min_size=2, max_size=60))
    plan[-1] = ["go" if e == "reset" else e for e in plan[-1]]
    buffer = on_disk(tmp_path_factory.mktemp("r"), rows, seats, precrash_share=0.5, precrash_window=5)
    reference = Reference(seats)
    fill(buffer, reference, plan, seats)
    check(buffer, reference, *buffer.draw(64))
    buffer.close()


def test_a_memory_goes_on_from_its_frames_and_forgets_those_after(tmp_path):
    g = np.random.default_rng(3)
    plan = [[ENDS[g.integers(len(ENDS))], ENDS[g.integers(len(ENDS))]] for _ in range(70)] + [["go", "crash"]]
    buffer, reference = on_disk(tmp_path, 40, 2), Reference(2)
    fill(buffer, reference, plan, 2)
    kept = replay_arrays(buffer)
    assert kept["frames"].size == 0
    buffer.disk.hold(int(kept["disk"][0]))
    for _ in range(30):  # forgotten by a kill
        fill(buffer, Reference(2), [["go", "go"]], 2)
    buffer.close()
    again = on_disk(tmp_path, 40, 2)
    require_fit(again, kept)
    restore_replay(again, kept)
    check(again, reference, *again.draw(64))
    assert again.disk.next_number == 2 * buffer.layout.window * 71
    again.close()


def test_a_checkpoint_of_other_frames_or_another_store_is_refused(tmp_path):
    plan = [["go"]] * 20
    buffer = on_disk(tmp_path / "a")
    fill(buffer, Reference(1), plan, 1)
    kept = replay_arrays(buffer)
    buffer.close()
    other = on_disk(tmp_path / "b")
    with pytest.raises(PolicyError, match="lacks 20 of the frames 0 to 20"):
        require_fit(other, kept)
    fill(other, Reference(1), [["crash"]] * 20, 1)
    with pytest.raises(ValueError, match="not those that it was saved with"):
        require_fit(other, kept)
    other.close()
    memory = FrameReplay(40, SPACE, gym.spaces.Discrete(81), device="cpu", settings=ReplaySettings())
    with pytest.raises(ValueError, match=r"learn\.replay_store=disk; this is memory"):
        require_fit(memory, kept)


def test_a_store_whose_process_died_as_it_began_can_be_begun_again(tmp_path):
    (tmp_path / f".{STORE_JSON}.tmp").write_text("{")
    with store(tmp_path) as frames:
        write(frames, 3)
    assert len(segments_in(tmp_path)) == 1
