"""A recorded drive in the place of a user: where it can be replayed, and what is said elsewhere."""

from pathlib import Path

from tests.log.drives import tick, write_drive
from wcsim.towns.scenario.town import content_hash, find_town


def driven(wcsim, **there):
    write_drive(Path("a.drive"), [tick(1), tick(2)], town_name="helsinki", **there)
    return wcsim("test", "stop", "--profile", "recorded:a.drive")  # in monaco, unless it is said


def test_a_drive_of_another_town_is_refused_with_the_words_that_work(wcsim):
    result = driven(wcsim, town_sha256=content_hash(find_town("helsinki")))
    assert result.code == 2 and "was driven in helsinki" in result.err
    assert result.err.rstrip().endswith("Use --town helsinki --allow-train-town")


def test_nothing_is_proposed_for_a_town_that_is_not_here_as_it_was(wcsim):
    result = driven(wcsim)
    assert result.code == 2 and result.err.rstrip().endswith("expected the same town: name it, or restore its files")
