"""Profiles: names, what an episode's user may differ in, and files of them, which are refused when out of bounds."""

from dataclasses import asdict, fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.core.seeding import make_rng
from wcsim.errors import ConfigError
from wcsim.users.profiles import (
    PROFILE_LIMITS,
    UserProfile,
    _read_profile,
    filter_user_file_names,
    find_builtin_profile,
    is_user_file_name,
    list_profile_names,
    profile_from_json,
    profile_to_json,
    profile_to_toml,
    sample_profile,
)
from wcsim.users.recordings.recorded_user import find_user


def test_all_are_there():
    assert list_profile_names() == ("competent", "slow", "tremor", "ataxic", "inattentive", "switch", "recorded")
    assert all(find_builtin_profile(name).name == name for name in list_profile_names())


def test_an_unknown_name_is_answered_with_the_known():
    with pytest.raises(ConfigError, match="competent, slow, tremor"):
        find_builtin_profile("drunk")


@given(st.sampled_from(list_profile_names()), st.integers(0, 2**20))
def test_a_sample_stays_within_30_percent_and_shares_stay_shares(name, seed):
    base, drawn = (
        asdict(find_builtin_profile(name)),
        asdict(sample_profile(find_builtin_profile(name), make_rng(seed, "user"))),
    )
    for key, value in drawn.items():
        if key in ("name", "discrete"):
            assert value == base[key]
        elif key in ("see_share", "law_share"):
            assert 0.0 <= value <= 1.0
            assert 0.69 * (1 - base[key]) <= 1 - value <= max(1.31 * (1 - base[key]), 1e-9)
        elif key == "gain":
            np.testing.assert_allclose(np.array(value) - 1.0, np.array(base[key]) - 1.0, rtol=0.31, atol=1e-12)
        else:
            np.testing.assert_allclose(value, base[key], rtol=0.31, atol=1e-12)
            assert "share" not in key or 0.0 <= value <= 1.0


def test_a_sample_depends_on_the_seed_only():
    first, again, other = (sample_profile(find_builtin_profile("tremor"), make_rng(seed, "user")) for seed in (1, 1, 2))
    assert first == again != other


def test_a_bias_ahead_is_spread_as_one_to_the_side_is():
    base = replace(find_builtin_profile("ataxic"), bias=(0.12, 0.1))
    drawn = np.array([sample_profile(base, make_rng(seed, "user")).bias for seed in range(40)]) / base.bias
    assert (drawn.min(axis=0) < 0.8).all() and (drawn.max(axis=0) > 1.2).all()
    assert (np.abs(drawn - 1.0) < base.spread + 1e-9).all()


# --- files ---


@pytest.mark.parametrize("name", list_profile_names())
def test_what_is_written_is_read(tmp_path, name):
    user = replace(sample_profile(find_builtin_profile(name), make_rng(3, "user")), spread=0.1)
    file = tmp_path / "me.toml"
    file.write_text(profile_to_toml(user, {"lag_s": "0.1 to 0.2"}, "a head\nof two lines"))
    assert _read_profile(file) == find_user(str(file)) == user
    assert "# a head\n# of two lines\n" in file.read_text() and "# 0.1 to 0.2\n" in file.read_text()
    assert profile_from_json(profile_to_json(user), "there") == user


def test_every_number_of_a_profile_has_bounds_and_every_profile_is_within_them():
    numbers = {item.name for item in fields(UserProfile)} - {"name", "discrete"}
    assert numbers == set(PROFILE_LIMITS)
    for name in list_profile_names():
        for key, (low, high) in PROFILE_LIMITS.items():
            value = asdict(find_builtin_profile(name))[key]
            assert all(low <= part <= high for part in (value if isinstance(value, tuple) else (value,))), (name, key)


def test_what_is_left_out_is_the_bases(tmp_path):
    file = tmp_path / "my tired user.toml"
    file.write_text('base = "slow"\nreaction_s = 0.9\n')
    assert _read_profile(file) == replace(
        find_builtin_profile("slow"), name="my-tired-user", reaction_s=0.9, spread=0.0
    )
    assert sample_profile(_read_profile(file), make_rng(1, "user")) == _read_profile(file)


@pytest.mark.parametrize(
    "text, message",
    [
        ("reaction_s = 9", "reaction_s: got 9; expected a number, 0 to 3"),
        ("reaction_s = nan", "finite"),
        ('reaction_s = "fast"', "reaction_s: got 'fast'"),
        ("reaction_s = true", "reaction_s: got True"),
        ("gain = 1.0", "gain: got 1.0; expected two numbers, each 0.05 to 5"),
        ("gain = [1.0, 1.0, 1.0]", "gain: got"),
        ("bias = [0.0, -1.5]", "bias: got"),
        ("discrete = 1", "expected true or false"),
        ('name = "../x"', "name: got"),
        ("speed = 1", "unknown key 'speed'; expected one of: base, ask_share"),
        ('base = "drunk"', "unknown user profile 'drunk'"),
        ("base = 1", "base: got 1"),
        ("reaction_s = ", "is not TOML"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path, text, message):
    (tmp_path / "me.toml").write_text(text)
    with pytest.raises(ConfigError, match=r"(?s)" + message.replace("[", r"\[") if "got" in message else message):
        find_user(str(tmp_path / "me.toml"))


def test_a_missing_file_is_named():
    with pytest.raises(ConfigError, match=r"nowhere\.toml: cannot be read"):
        find_user("nowhere.toml")


def test_files_are_distinguished_from_names():
    names = ("slow", "me.toml", "recorded:a.drive", "me.toml")
    assert [is_user_file_name(name) for name in names] == [False, True, True, True]
    assert filter_user_file_names(names) == ("me.toml", "recorded:a.drive")
