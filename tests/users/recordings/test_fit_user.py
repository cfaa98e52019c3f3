"""A recorded user is fitted: what it was drawn with is found, what cannot be found is named, and the file drives."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from tests.users.recordings.plane_drives import plane_drive, thinned
from wcsim.config import resolve
from wcsim.core.seeding import make_rng
from wcsim.errors import ConfigError
from wcsim.log.records import with_fields
from wcsim.types import Joystick
from wcsim.users.profiles import (
    _read_profile,
    find_builtin_profile,
    list_profile_names,
    profile_to_toml,
    sample_profile,
)
from wcsim.users.recordings.fit_user import _has_switches, fit_user_to_drives, is_certain_estimate
from wcsim.users.recordings.hand_series import hand_series_from_drives

BASE = find_builtin_profile("competent")
FLOORS = {"bias_x": 0.02, "bias_y": 0.05, "tremor": 0.01, "away_share": 0.06}  # where a drawn number may be zero
UNCERTAIN = {  # docs/user.md says why
    "inattentive": ("away_share", "away_s"),
    "ataxic": ("bias_x", "speed_share"),
    "recorded": ("lag_s", "noise", "noise_rate", "bias_y"),
}
EIGHTHS = [(math.sin(turn * math.pi / 4), math.cos(turn * math.pi / 4)) for turn in range(8)]
KEYS = [(0.0, 0.0), *EIGHTHS, *((0.5 * x, 0.5 * y) for x, y in EIGHTHS)]
SCANNED = [(0.0, 0.0), (0.0, 1.0), (0.0, 0.5), (-0.25, 0.75), (0.25, 0.75), (-0.5, 0.0), (0.5, 0.0), (0.0, -0.5)]


def drawn(name, seed):
    return sample_profile(find_builtin_profile(name), make_rng(seed, "user"))


def numbers(user):
    """A profile's numbers as a fit names them."""
    pairs = {f"{key}_{axis}": getattr(user, key)[k] for key in ("gain", "bias") for k, axis in enumerate("xy")}
    return {**asdict(user), **pairs}


def wrong(fit, user, share=0.15):
    """What is farther off than a share of what was drawn: (fitted, drawn) by name."""
    truth = numbers(user)
    off = {name: (item.value, truth[name]) for name, item in fit.estimates.items()}
    return {
        name: pair
        for name, pair in off.items()
        if abs(pair[0] - pair[1]) > max(share * abs(pair[1]), FLOORS.get(name, 0.0))
    }


@pytest.fixture(scope="module")
def shaking():
    return drawn("tremor", 3), plane_drive(drawn("tremor", 3), 90.0, 1)


@pytest.fixture(scope="module")
def fit(shaking):
    return fit_user_to_drives([shaking[1]], BASE)


def test_a_hand_is_found_in_a_minute_and_a_half(shaking, fit):
    user, _ = shaking
    assert {"reaction_s", "lag_s", "gain_x", "noise", "tremor", "tremor_hz", "away_share"} <= set(fit.estimates)
    assert set(wrong(fit, user)) <= {"noise_rate", "lag_s"}
    assert wrong(fit, user, 0.5) == {}
    assert fit.estimates["tremor_hz"].value == pytest.approx(user.tremor_hz, abs=0.1)
    assert (fit.seconds, fit.profile.spread, fit.profile.discrete) == (pytest.approx(90.0, abs=3.0), 0.0, False)
    assert any(line.startswith("only ") for line in fit.warnings)


def test_a_stick_of_ten_samples_a_second_shows_a_slow_tremor_and_warns_of_fast_ones(shaking):
    user, drive = shaking
    fit = fit_user_to_drives([thinned(drive, 0)], BASE)
    assert fit.estimates["reaction_s"].value == pytest.approx(user.reaction_s, abs=0.06)
    assert any("a tremor above 5 Hz looks slower" in line for line in fit.warnings)


def test_a_steady_hand_has_no_tremor_and_another_reaction_is_found():
    user = replace(drawn("competent", 2), reaction_s=0.7)
    fit = fit_user_to_drives([plane_drive(user, 80.0, 2)], BASE)
    assert fit.estimates["reaction_s"].value == pytest.approx(0.7, abs=0.03)
    assert fit.profile.tremor == 0.0 < fit.estimates["tremor"].high <= 0.02


def test_switches_are_known_and_fitted(shaking):
    user = drawn("switch", 1)
    drive = plane_drive(user, 20.0, 4)
    assert _has_switches(hand_series_from_drives([drive])) and not _has_switches(hand_series_from_drives([shaking[1]]))
    fit = fit_user_to_drives([drive], BASE)
    assert fit.profile.discrete and fit.profile.noise == 0.0
    assert fit.profile.reaction_s == pytest.approx(user.reaction_s, abs=0.02)
    assert fit.estimates["hold_s"].low <= user.hold_s + 0.1


def test_the_file_of_a_fit_is_a_profile(fit, tmp_path):
    (tmp_path / "me.toml").write_text(profile_to_toml(fit.profile, {}))
    assert _read_profile(tmp_path / "me.toml") == fit.profile
    assert sample_profile(fit.profile, make_rng(1, "user")) == fit.profile


def test_intents_of_the_model_show_nothing_of_looks_elsewhere(shaking):
    fit = fit_user_to_drives([shaking[1]], replace(BASE, away_share=0.2), true_intents=False)
    assert "away_share" not in fit.estimates and fit.profile.away_share == 0.2
    assert any("looking away counts as noise" in line for line in fit.warnings)


def test_drives_that_show_too_little_are_refused(shaking):
    drive = shaking[1]
    with pytest.raises(ConfigError, match="no episode of 5 s"):
        fit_user_to_drives([replace(drive, records=drive.ticks[:30])], BASE)
    with pytest.raises(ConfigError, match="ticks without an intent"):
        fit_user_to_drives([replace(drive, records=(with_fields(drive.ticks[0], intent=None), *drive.ticks[1:]))], BASE)


def test_drives_of_other_ticks_or_of_a_chair_that_takes_a_stick_otherwise_are_refused(shaking):
    """Counted together, times are those of the first drive's ticks, and the speed is that of its chair."""
    drive = shaking[1]
    slow = replace(drive, name="slow.drive", header=with_fields(drive.header, tick_s=0.2))
    with pytest.raises(ConfigError, match=r"slow\.drive: was driven with world\.tick_s 0\.2, plane with 0\.1; exp"):
        fit_user_to_drives([drive, slow], BASE)
    dull = resolve("quick", "chair.deadband=0.4").model_dump_json()
    with pytest.raises(ConfigError, match=r"plane: was driven with chair\.deadband 0\.08, .* with 0\.4; expected"):
        fit_user_to_drives([replace(drive, header=with_fields(drive.header, config=dull)), drive], BASE)


def at_positions(drive, positions):
    """The same by somebody who only ever takes the nearest of these, as keys do, once a tick."""
    near = [Joystick(*min(positions, key=lambda p: math.dist(p, (tick.stick.x, tick.stick.y)))) for tick in drive.ticks]
    ticks = (with_fields(tick, stick=at, sticks=np.zeros((0, 2))) for tick, at in zip(drive.ticks, near, strict=True))
    return replace(drive, records=tuple(ticks))


@pytest.mark.parametrize("positions", [KEYS, SCANNED, [(0.0, 0.0), (0.0, 1.0)]])
def test_keys_and_the_switches_of_a_page_show_no_hand(shaking, positions):
    with pytest.raises(ConfigError, match=r"took only \d+ positions?.*expected a drive by gamepad"):
        fit_user_to_drives([shaking[1], at_positions(shaking[1], positions)], BASE)


def test_pushes_to_the_gate_alone_leave_the_hand_of_the_base():
    user = replace(drawn("competent", 1), gain=(3.0, 3.0))
    fit = fit_user_to_drives([plane_drive(user, 60.0, 5)], replace(BASE, lag_s=0.21))
    assert (fit.profile.gain, fit.profile.lag_s, fit.profile.reaction_s) == (BASE.gain, 0.21, BASE.reaction_s)
    assert any("are those of --base" in line for line in fit.warnings)


# --- proofs ---


@pytest.mark.proof
@pytest.mark.parametrize("name", list_profile_names())
def test_ten_minutes_show_a_user_to_15_per_cent(name):
    user = drawn(name, 7)
    fit = fit_user_to_drives([plane_drive(user, 600.0, 8)], BASE)
    assert set(wrong(fit, user)) <= set(UNCERTAIN.get(name, ()))
    assert all(
        is_certain_estimate(key, item) for key, item in fit.estimates.items() if key not in UNCERTAIN.get(name, ())
    )
