"""What is said while a list is made."""

from __future__ import annotations

import pytest

from wcsim.cli.evaluation.judged_suite import PartTimes, make_list
from wcsim.errors import ConfigError


def test_each_part_says_how_long_it_still_takes():
    now_s, lines = [0.0], []
    times = PartTimes(lines.append, clock=lambda: now_s[0])
    for at_s, text, share in (
        (50.0, "2 blocks are drawn", 0.0), (80.0, "ways: 1 of 2", 0.5), (100.0, "ways: 2 of 2", 1.0),
        (110.0, "attempts: 1 of 4", 0.25), (120.0, "attempts: 2 of 4", 0.5), (130.0, "found", 0.0),
    ):  # fmt: skip
        now_s[0] = at_s
        times.say(text, share)
    assert lines == [
        "2 blocks are drawn", "ways: 1 of 2, about 30 s left", "ways: 2 of 2",
        "attempts: 1 of 4, about 30 s left", "attempts: 2 of 4, about 20 s left", "found",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--suite-file", "My_Town.json"), "--suite-file: got the name 'My_Town'; .* such as my-town"),
        (("--suite-file", f"{'a' * 33}.json"), "at most 32 .* such as a{32}$"),
        (("--name", "Own suite"), "--name: got the name 'Own suite'; .* at most 64 .* such as own-suite"),
        (("--name", "__"), "lower-case letters, digits and -$"),
    ],
)
def test_a_name_that_no_list_can_have_is_refused_before_anything_is_drawn(words, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=said):
        make_list(["--make-suite", "helsinki", *words])
