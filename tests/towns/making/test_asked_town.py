"""Towns by the words that users type."""

from pathlib import Path

import pytest

from wcsim.errors import ConfigError, TownError
from wcsim.towns.making import asked_town as asked
from wcsim.towns.making import maker
from wcsim.towns.making.asked_town import Wishes, requested_town
from wcsim.towns.scenario.town import Town


@pytest.mark.parametrize("word", ["made:", "made:x", "made:-1", "made:1.5", f"made:{1 << 31}", "made: 1"])
def test_seeds_of_generated_towns_are_checked(word: str) -> None:
    with pytest.raises(ConfigError, match="expected made:SEED with a seed below 2147483648"):
        requested_town(word)


def test_a_generated_town_for_training_is_made_once(
    corner_town: Town, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[tuple[Path, int, str]] = []

    def make(out: Path, seed: int, wishes: Wishes, *, overwrite: bool) -> Town:
        made.append((out, seed, wishes.split))
        out.mkdir(parents=True)
        return corner_town

    monkeypatch.setattr(asked, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(maker, "make_town", make)
    monkeypatch.setattr(asked, "own_work", lambda folder: ())
    monkeypatch.setattr(asked, "open_town", lambda folder: corner_town)
    assert requested_town("made:7") == requested_town("made:7") == corner_town
    assert made == [(tmp_path / "train-towns" / "made-7", 7, "train")]
    with pytest.raises(TownError, match="atlantis"):
        requested_town("atlantis")
