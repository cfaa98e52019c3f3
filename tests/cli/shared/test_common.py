"""What commands share: how many processes they start."""

import os

import pytest

from wcsim.cli.shared.common import resolve_worker_count


@pytest.mark.parametrize("cores, worlds", [(1, 1), (2, 2), (64, 4)])
def test_a_world_for_each_core_where_nobody_says_how_many(
    cores: int, worlds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(cores)))
    assert resolve_worker_count(None) == worlds


def test_as_many_worlds_as_asked() -> None:
    assert resolve_worker_count(3) == 3
