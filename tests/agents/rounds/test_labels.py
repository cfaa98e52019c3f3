import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from wcsim.agents.runs.data_folder import SAFE, crash_times_to_codes, mask_soon_unsafe_actions


@given(st.lists(st.floats(0.0, 1e9) | st.just(float("inf")), min_size=1, max_size=20))
def test_only_what_ends_well_is_coded_as_safe(seconds):
    codes = crash_times_to_codes(np.array(seconds))
    assert ((codes == SAFE) == np.isinf(seconds)).all()
    short = np.array(seconds) < 12.0
    assert np.allclose(0.05 * codes[short], np.array(seconds)[short], atol=0.026)


def test_what_will_be_unsafe_is_so_already_as_long_as_something_is_left():
    now = np.array([[SAFE, SAFE], [SAFE, 3], [3, 3]], np.uint8)
    ends = np.array([False, False, True])
    assert mask_soon_unsafe_actions(now, ends, 0).tolist() == [[False, False], [False, True], [True, True]]
    assert mask_soon_unsafe_actions(now, ends, 1).tolist() == [[False, True], [False, True], [True, True]]
    assert mask_soon_unsafe_actions(now, ends, 2).tolist() == [[False, True], [False, True], [True, True]]


def test_the_next_episode_says_nothing_of_this_one():
    now = np.array([[SAFE, SAFE], [SAFE, 3]], np.uint8)
    assert not mask_soon_unsafe_actions(now, np.array([True, True]), 2)[0].any()


@given(hnp.arrays(np.uint8, (12, 5), elements=st.sampled_from([3, SAFE])), hnp.arrays(np.bool_, 12), st.integers(0, 4))
def test_looking_ahead_makes_more_unsafe_but_never_everything(codes, ends, ahead):
    now, later = mask_soon_unsafe_actions(codes, ends, 0), mask_soon_unsafe_actions(codes, ends, ahead)
    assert (later >= now).all()
    assert (later.all(axis=1) == now.all(axis=1)).all()
