"""Recorded joysticks: what is written comes back, what cannot be used is refused with its place, value and bounds."""

import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.log.drives import tick, write_drive
from tests.support.samples import USUAL_OUTLINE, straight_route, write_recording
from tests.users.kinematics import Chair, Sim
from wcsim.errors import ConfigError
from wcsim.types import Joystick
from wcsim.users.profiles import find_builtin_profile
from wcsim.users.recordings.recorded_user import _JoystickRecording, _RecordedUser, find_user, read_stick_recording

HEAD = "time_s,x,y\n"


def recorded(text, folder):
    file = folder / "stick.csv"
    file.write_text(text)
    return read_stick_recording(file)


def replay(recording, ticks):
    """The joystick after each tick of 0.1 s."""
    user = _RecordedUser(recording, USUAL_OUTLINE)
    return [user.joystick, *(user.move_hand(24, 0.1 / 24) for _ in range(ticks))]


def test_samples_hold_until_the_next_and_the_stick_rests_afterwards(tmp_path):
    sticks = replay(recorded(HEAD + "0.1,0,0.5\n0.25,0.5,0\n0.45,-0.25,1\n0.6,0,0.25\n", tmp_path), 10)
    assert [(j.x, j.y) for j in sticks[:3]] == [(0.0, 0.0), (0.0, 0.5), (0.0, 0.5)]
    assert [(j.x, j.y) for j in sticks[3:5]] == [(0.5, 0.0)] * 2
    assert sticks[5].x == pytest.approx(-0.25 / np.hypot(0.25, 1.0))  # on the disc
    assert [(j.x, j.y) for j in sticks[6:]] == [(0.0, 0.25)] * 2 + [(0.0, 0.0)] * 3


def test_a_table_of_ros_axes_counts_to_the_left_and_may_be_packed(tmp_path):
    rows = "t_s,axis0,axis1\n0,0.5,0.25\n0.1,-1,0\n"
    found = recorded(rows, tmp_path)
    assert found.sticks.tolist() == [[-0.5, 0.25], [1.0, 0.0]] and found.time_s.tolist() == [0.0, 0.1]
    packed = tmp_path / "stick.csv.gz"
    packed.write_bytes(gzip.compress(rows.encode()))
    assert np.array_equal(read_stick_recording(packed).sticks, found.sticks)
    whole = packed.read_bytes()
    for data in (
        b"",
        whole[:-9],
        whole + whole,
        rows.encode(),
        gzip.compress(bytes(65 << 20)),
        gzip.compress(b"\n" * 6_000_000),
    ):
        packed.write_bytes(data)
        with pytest.raises(ConfigError, match=r"stick.csv.gz.*expected"):
            read_stick_recording(packed)
    with pytest.raises(ConfigError, match=r"stick.csv:2: x is -1.5; expected -1 to 1"):
        recorded("t_s,axis0,axis1\n0,-1.5,0\n", tmp_path)


@given(st.lists(st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7)), min_size=2, max_size=30))
def test_what_is_written_is_replayed_tick_by_tick(tmp_path_factory, sticks):
    file = tmp_path_factory.mktemp("rec") / "stick.csv"
    write_recording(file, 0.1 * np.arange(len(sticks)), np.array(sticks))
    replayed = replay(read_stick_recording(file), len(sticks) - 1)
    assert [(j.x, j.y) for j in replayed] == sticks


def test_it_arrives_with_the_chair_and_gives_up_once_at_the_end(tmp_path):
    rows = "".join(f"{0.1 * k:.1f},0,0.8\n" for k in range(101))
    user = _RecordedUser(recorded(HEAD + rows, tmp_path), USUAL_OUTLINE)
    sim = Sim(user, straight_route(), Chair(x=0.3, y=5.5))
    sim.run(60.0)
    assert user.gave_up and not user.arrived
    assert sim.time_s == pytest.approx(10.1, abs=0.11)
    assert user.route_progress_m == pytest.approx(sim.chair.middle()[0], abs=0.01)
    assert user.joystick == user.intent == Joystick(0.0, 0.0)
    user.follow(straight_route())
    for _ in range(5):
        sim.tick()
    assert not user.gave_up
    near = _RecordedUser(recorded(HEAD + rows, tmp_path), USUAL_OUTLINE)
    assert Sim(near, straight_route(), Chair(x=75.0, y=5.5)).run(20.0) and near.arrived and not near.gave_up


@pytest.mark.parametrize(
    "text, message",
    [
        ("", r"stick.csv:1: other column names; expected the line time_s,x,y"),
        ("a,b,c\n0,0,0\n", "stick.csv:1: other column names; expected the line time_s,x,y"),
        (HEAD, "0 samples; expected at least two"),
        (HEAD + "0,0,0\n", "1 samples; expected at least two"),
        (HEAD + "0,0,0\n0.1,nan,0\n", r"stick.csv:3: x is nan; expected -1 to 1"),
        (HEAD + "0,0,0\n0.1,0,1.01\n", r"stick.csv:3: y is 1.01; expected -1 to 1"),
        (HEAD + "0,0,0\n0.1,0,-inf\n", r"stick.csv:3: y is -inf; expected -1 to 1"),
        (HEAD + "0,0,0\nnan,0,0\n", r"stick.csv:3: time_s is nan s after 0.0 s"),
        (HEAD + "0,0,0\n0.1,0,0\n0.1,0,0\n", r"stick.csv:4: time_s is 0.1 s after 0.1 s; expected later"),
        (HEAD + "0,0,0\n0.2,0,0\n0.1,0,0\n", r"stick.csv:4: time_s is 0.1 s after 0.2 s; expected later"),
        (HEAD + "0,0,0\n0.1,0,0\n0.7,0,0\n", r"stick.csv:4: time_s is 0.7 s after 0.1 s; .* by at most 0.5 s"),
        (HEAD + "3,0,0\n3.1,0,0\n", r"stick.csv:2: time_s is 3.0 s; expected the first sample at 0 to 0.5 s"),
        (HEAD + "0,0,0\n\n0.1,up,0\n", r"stick.csv:4: x is not a number; expected -1 to 1"),
        (HEAD + "0,0,0\n0.1,0\n", r"stick.csv:3: 2 values; expected time_s,x,y"),
        (HEAD + "0,0,0\n0.1,0,0\udcff\n", "is not in UTF-8"),
        (HEAD + "0,0,0\n" + "1" * 200_000 + ",0,0\n", r"stick.csv:3: .* a line of more than 65536 letters"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path, text, message):
    (tmp_path / "stick.csv").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(ConfigError, match=message):
        find_user(f"recorded:{tmp_path}/stick.csv")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none.csv: cannot be read \(No such file"):
        find_user(f"recorded:{tmp_path}/none.csv")


def test_a_name_is_a_profile_or_a_recording(tmp_path):
    assert find_user("slow") == find_builtin_profile("slow")
    write_recording(tmp_path / "stick.csv", np.array([0.0, 0.1]), np.zeros((2, 2)))
    assert isinstance(find_user(f"recorded:{tmp_path}/stick.csv"), _JoystickRecording)
    with pytest.raises(ConfigError, match=r"unknown user profile 'drunk'.*competent.*recorded:FILE"):
        find_user("drunk")


@pytest.mark.parametrize("text", ["root:SECRET:0\n", "SECRET\n", HEAD + "SECRET\n", HEAD + "0,SECRET,0\n", "\0SECRET"])
def test_nothing_of_a_file_that_is_no_recording_is_shown(tmp_path, text):
    with pytest.raises(ConfigError) as caught:
        recorded(text, tmp_path)
    assert "SECRET" not in str(caught.value) and "stick.csv" in str(caught.value)


def test_more_samples_than_anybody_records_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("wcsim.users.recordings.recorded_user.MOST_SAMPLES", 3)
    with pytest.raises(ConfigError, match=r"stick.csv:5: more than 3 samples"):
        recorded(HEAD + "".join(f"0.{k},0,0\n" for k in range(5)), tmp_path)


def test_a_drive_is_replayed_with_its_intents_episode_by_episode(tmp_path):
    ticks = [tick(1), tick(2), tick(3, crashed=True), tick(4, episode=1), tick(5, episode=1)]
    path = write_drive(tmp_path / "a.drive", ticks)
    found = find_user(f"recorded:{path}")
    assert (found.town, len(found.episodes)) == ("nowhere", 2)
    user = found.user(0, USUAL_OUTLINE)
    seen = [(user.joystick.x, user.intent.x)]
    for _ in range(5):
        user.move_hand(2, 0.05)
        seen.append((user.joystick.x, user.intent.x))
    assert seen[:3] == [(0.0, 0.01), (0.001, 0.01), (0.002, 0.01)]
    assert seen[3] == (pytest.approx(0.003, abs=1e-7), 0.01)  # the last sample within a tick is a float32
    assert seen[4:] == [(0.0, 0.0)] * 2
    user = found.user(3, USUAL_OUTLINE)
    assert user.joystick.x == 0.003
    assert user.sticks.shape == (1, 2)
    user.move_hand(2, 0.05)
    assert user.sticks[:, 0] == pytest.approx([0.0035, 0.004], abs=1e-7)


def test_a_drive_without_intents_or_samples_has_its_stick_for_both(tmp_path):
    path = write_drive(tmp_path / "a.drive", [tick(k, intent=None, sticks=np.zeros((0, 2))) for k in (1, 2, 3)])
    user = find_user(f"recorded:{path}").user(0, USUAL_OUTLINE)
    sticks = [user.joystick, *(user.move_hand(4, 0.025) for _ in range(3))]
    assert [stick.x for stick in sticks] == [0.0, 0.001, 0.002, 0.002]
    assert user.intent == user.joystick


@pytest.mark.parametrize(
    "header, ticks, message",
    [
        ({"wcsim": "0.0.1"}, [1, 2], r"was driven with wcsim 0\.0\.1, this is \d"),
        ({}, [], "is empty"),
    ],
)
def test_a_drive_of_another_version_or_without_a_tick_is_refused(tmp_path, header, ticks, message):
    path = write_drive(tmp_path / "a.drive", [tick(number) for number in ticks], **header)
    with pytest.raises(ConfigError, match=message):
        find_user(f"recorded:{path}")


def test_a_drive_of_an_earlier_version_with_the_same_motion_is_replayed(tmp_path):
    path = write_drive(tmp_path / "a.drive", [tick(1), tick(2)], wcsim="0.1.0")
    find_user(f"recorded:{path}").require_driven_here("nowhere", lambda: "ab" * 32)


def test_a_drive_of_another_town_is_refused_with_both_named(tmp_path):
    found = find_user(f"recorded:{write_drive(tmp_path / 'a.drive', [tick(1), tick(2)])}")
    with pytest.raises(ConfigError, match=r"was driven in nowhere \(abababababab\), this is monaco \(cdcdcdcdcdcd\)"):
        found.require_driven_here("monaco", lambda: "cd" * 32)
    found.require_driven_here("nowhere", lambda: "ab" * 32)
    recorded(HEAD + "0,0,0\n0.1,0,0\n", tmp_path).require_driven_here("monaco", lambda: 1 / 0)
