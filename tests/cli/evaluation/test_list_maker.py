"""Names of lists that are made."""

import pytest

from wcsim.cli.evaluation.judged_suite import run_make_suite_command
from wcsim.errors import ConfigError


@pytest.mark.parametrize(
    "words, message",
    [
        (("--suite-file", "My_Town.json"), "--suite-file: got the name 'My_Town'; .* such as my-town"),
        (("--suite-file", f"{'a' * 33}.json"), "at most 32 .* such as a{32}$"),
    ],
)
def test_a_name_that_no_list_can_have_is_refused_before_anything_is_drawn(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=message):
        run_make_suite_command(["--make-suite", "helsinki", *words])
