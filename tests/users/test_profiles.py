"""Profiles: names, and what an episode's user may differ in."""

from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.core.seeding import generator
from wcsim.errors import ConfigError
from wcsim.users.profiles import profile, profile_names, sample


def test_all_six_are_there():
    assert profile_names() == ("competent", "slow", "tremor", "ataxic", "inattentive", "switch")
    assert all(profile(name).name == name for name in profile_names())


def test_an_unknown_name_is_answered_with_the_known():
    with pytest.raises(ConfigError, match="competent, slow, tremor"):
        profile("drunk")


@given(st.sampled_from(profile_names()), st.integers(0, 2**20))
def test_a_sample_stays_within_30_percent_and_shares_stay_shares(name, seed):
    base, got = asdict(profile(name)), asdict(sample(profile(name), generator(seed, "user")))
    for key, value in got.items():
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
    first, again, other = (sample(profile("tremor"), generator(seed, "user")) for seed in (1, 1, 2))
    assert first == again != other
