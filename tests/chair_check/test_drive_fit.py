"""A controller is fitted to drives: made ones give their numbers back, and files that are none are refused."""

import gzip
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from wcsim.chair_check import drive_fit
from wcsim.chair_check.drive_fit import (
    compute_motion_errors,
    delay_motion,
    fit_drive_law,
    simulate_drive_law,
    simulate_plant_motion,
)
from wcsim.chair_check.row import TrialSetup
from wcsim.chair_check.stick_drives import STEP_S, RecordedDrive, read_recorded_drives
from wcsim.cli.main import main
from wcsim.config import ChairConfig, resolve
from wcsim.errors import ConfigError

TRUE = {
    "v_max_mps": 1.3,
    "accel_mps2": 0.7,
    "decel_mps2": 1.4,
    "jerk_mps3": 6.0,
    "yaw_rate_max_radps": 1.2,
    "yaw_accel_radps2": 2.2,
    "yaw_slowdown_s_per_m": 0.3,
    "deadband": 0.06,
    "shape_exponent": 1.3,
    "delay_s": 0.21,
}


def sticks(seed, seconds=20.0):
    """A stick (n, 2) that goes to a place, stays, and is let go at times."""
    rng = np.random.default_rng(seed)
    spots = [(0.0, 0.0)]
    while len(spots) < seconds:
        angle, radius = rng.uniform(0.0, np.pi), rng.choice([0.4, 0.7, 1.0])
        spots += [(radius * np.cos(angle), radius * np.sin(angle))] * 2 + [(0.0, 0.0)] * int(rng.integers(0, 2))
    at = np.arange(0.0, len(spots) - 1, STEP_S)
    hand = np.clip((at % 1.0) / 0.25, 0.0, 1.0)[:, None]
    before, after = (np.array(spots)[np.minimum(at.astype(int) + k, len(spots) - 1)] for k in (0, 1))
    return before + hand * (after - before)


def made(seeds, numbers=TRUE, noise=0.0):
    rng = np.random.default_rng(7)
    still = [
        RecordedDrive(name=f"d{seed}", stick=(stick := sticks(seed)), motion=np.zeros_like(stick)) for seed in seeds
    ]
    moved = simulate_drive_law(still, numbers)
    return [replace(a, motion=b + noise * rng.normal(size=b.shape)) for a, b in zip(still, moved, strict=True)]


def test_a_law_gives_its_numbers_back():
    drives = made(range(2))
    fit = fit_drive_law(drives, draws=0)
    for name, value in TRUE.items():
        assert fit.values[name] == pytest.approx(value, rel=0.03), name
    assert compute_motion_errors(drives, simulate_drive_law(drives, fit.values)).speed_rms_mps < 0.003


@settings(max_examples=2, deadline=None, derandomize=True, phases=[Phase.generate])
@given(st.floats(0.4, 1.2), st.floats(0.6, 2.0), st.floats(0.1, 0.3))
def test_numbers_lie_in_their_intervals_under_noise(accel, turn, delay):
    numbers = {**TRUE, "accel_mps2": accel, "yaw_rate_max_radps": turn, "delay_s": delay}
    fit = fit_drive_law(made(range(2), numbers, noise=0.02), draws=4)
    for name in ("v_max_mps", "accel_mps2", "yaw_rate_max_radps", "delay_s"):
        low, high = fit.intervals[name]
        spare = 0.01 if name == "delay_s" else 0.04 * numbers[name]  # four draws make a rough interval
        assert low - spare <= numbers[name] <= high + spare, (name, low, high)


def write(folder, drive, turn=1.0, name=None, **changed):
    at = STEP_S * np.arange(len(drive.stick))
    stick = np.column_stack([at, turn * drive.stick[:, 0], drive.stick[:, 1]])
    path = folder / f"{name or drive.name}.joy.csv"
    for place, rows, head in (
        (path, stick, "t_s,axis0,axis1"),
        (folder / f"{name or drive.name}.odom.csv.gz", np.column_stack([at, drive.motion]), "t_s,v_mps,w_radps"),
    ):
        text = head + "\n" + "\n".join(",".join(f"{value:.5f}" for value in row) for row in rows)
        place.write_bytes(gzip.compress(text.encode()) if place.suffix == ".gz" else text.encode())
    return path


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_files_are_read_whichever_way_the_axis_points(tmp_path, turn):
    (drive,) = made([1])
    (read,) = read_recorded_drives([write(tmp_path, drive, turn)])
    count = len(read.stick)
    assert np.allclose(read.stick, drive.stick[:count], atol=2e-3)
    assert np.allclose(read.motion, drive.motion[:count], atol=2e-3)


@pytest.mark.parametrize(
    "old, new, told",
    [
        (b"t_s,axis0", b"time,x", "begins with"),
        (b"\n0.02000,", b"\nnan,", "three finite numbers"),
        (b"\n0.02000,", b"\n-3,", "three finite numbers"),
        (b"\n0.04000,", b"\nzero,", "is no table"),
        (b"\n0.02000,", b"\n0.02000,7.0,", "is no table"),
        (b"\n0.04000,", b"\n0.04000,3,0\n0.04000,", "stick is at 3"),
    ],
)
def test_bad_files_are_refused(tmp_path, old, new, told):
    path = write(tmp_path, made([1])[0])
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(ConfigError, match=told) as caught:
        read_recorded_drives([path])
    assert str(path) in str(caught.value)


def test_drives_without_turns_and_files_without_odometry_are_refused(tmp_path):
    (drive,) = made([1])
    straight = replace(drive, stick=drive.stick * (0.0, 1.0), motion=drive.motion * (1.0, 0.0))
    with pytest.raises(ConfigError, match="turn too little"):
        read_recorded_drives([write(tmp_path, straight)])
    alone = write(tmp_path, drive)
    (tmp_path / "d1.odom.csv.gz").write_bytes(b"\x1f\x8b broken")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_recorded_drives([alone])
    (tmp_path / "d1.odom.csv.gz").unlink()
    with pytest.raises(ConfigError, match=r"d1\.odom\.csv"):
        read_recorded_drives([alone])


def test_the_plant_in_the_engine_repeats_the_law():
    numbers = {**TRUE, "delay_s": 0.0}
    chair = resolve("quick", {"chair": {name: value for name, value in numbers.items() if name != "delay_s"}}).chair
    (drive,) = made([2], numbers)
    errors = compute_motion_errors([drive], [simulate_plant_motion(drive, TrialSetup(chair=chair, hz=120))])
    assert errors.speed_explained > 0.9 and errors.turn_explained > 0.9
    worse = compute_motion_errors([drive], [delay_motion(drive.motion, 0.3)])
    assert worse.turn_explained < errors.turn_explained


def test_the_command_fits_draws_and_writes_a_chair_that_one_name_sets(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(drive_fit, "fit_drive_law", partial(fit_drive_law, draws=2))
    paths = [str(write(tmp_path, drive)) for drive in made(range(2))]
    out, picture = tmp_path / "mine.toml", tmp_path / "mine.png"
    assert main(["chair", "fit", *paths, "--hold-out", "d1", "--out", str(out), "--picture", str(picture)]) == 0
    assert "d1, left out" in capsys.readouterr().out and picture.read_bytes().startswith(b"\x89PNG")
    chair = resolve("quick", f"chair.plant={out}", "chair.jerk_mps3=5").chair
    assert chair.accel_mps2 == pytest.approx(0.7, rel=0.05) and chair.jerk_mps3 == 5.0


def test_a_named_chair_brings_its_numbers_under_what_is_asked_for():
    whill = resolve("quick", "chair.plant=whill").chair
    assert whill != ChairConfig(plant="whill") and whill.accel_mps2 < 0.5
    assert resolve("quick", "chair.accel_mps2=0.9", "chair.plant=whill").chair.accel_mps2 == 0.9
    assert resolve("quick", {"chair": {"plant": "whill"}}).chair == ChairConfig(plant="whill"), "moved, not chosen"
    assert resolve("quick", "chair.plant=whill", "chair.profile=indoor").chair.v_max_mps == 0.6
    other = resolve(resolve(resolve("quick", "chair.plant=whill"), "chair.jerk_mps3=7"), "chair.plant=rwd").chair
    assert other == ChairConfig(jerk_mps3=7.0), "what the plant before has set is gone"
    paved = resolve("quick", "chair.profile=pavement")
    assert resolve(paved, "chair.plant=whill").chair == whill
