"""Verdicts on nets and scenarios: the newest ones stay."""

import os
from pathlib import Path

from pytest import MonkeyPatch

from wcsim.towns.cache import folder
from wcsim.towns.cache.folder import write_verdict


def test_of_each_kind_the_newest_stay(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    monkeypatch.setattr(folder, "MOST_VERDICTS", 6)
    for number in range(7):
        path = tmp_path / f"net-{number}.ok"
        write_verdict(path)
        os.utime(path, (number, number))
    write_verdict(tmp_path / "scenario-a.ok")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["net-4.ok", "net-5.ok", "net-6.ok", "scenario-a.ok"]
