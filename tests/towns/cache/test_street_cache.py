import os
import re
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from wcsim.errors import TownError
from wcsim.towns import street
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import cached_street
from wcsim.towns.ground.tiles import Packed
from wcsim.towns.street import load_street

KEY = "0" * 32


def test_what_is_driven_once_is_not_kept(corner_town, own_cache):
    passing = load_street(replace(corner_town, passing=True))
    assert not list(own_cache.rglob("street-*"))
    assert len(passing.walk.edges) == len(load_street(corner_town).walk.edges) > 0
    assert list(own_cache.rglob("street-*"))


def test_worlds_that_begin_together_build_a_street_once(corner_town, own_cache):
    packed, built, at_work = build_street(corner_town), [], threading.Event()

    def build() -> Packed:
        built.append(threading.get_ident())
        at_work.set()
        return packed

    def first() -> Packed:
        other.start()
        assert not at_work.wait(0.5), "the other one waits"
        return build()

    found = []
    other = threading.Thread(target=lambda: found.append(cached_street(KEY, build)))
    found.append(cached_street(KEY, first))
    other.join(30.0)
    assert len(built) == 1 and len(found) == 2
    assert [path.name for path in own_cache.rglob("street-*")] == [f"street-{KEY}.npz"]


def test_a_street_that_cannot_be_built_keeps_nobody_waiting(corner_town, own_cache):
    def broken() -> Packed:
        raise TownError("no lane")

    for _ in range(2):
        with pytest.raises(TownError, match="no lane"):
            cached_street(KEY, broken)
    assert not list(own_cache.rglob("street-*"))


def test_where_no_lock_can_be_had_it_is_built_all_the_same(corner_town, own_cache, monkeypatch):
    opened = os.open

    def refused(path: Path, *more: int) -> int:
        if str(path).endswith(".lock"):
            raise PermissionError("read-only")
        return opened(path, *more)

    monkeypatch.setattr(os, "open", refused)
    assert cached_street(KEY, lambda: build_street(corner_town)).walk.edges


def test_who_waits_for_a_street_hears_which_part_it_is(corner_town, monkeypatch):
    packed, told = build_street(corner_town), []

    def build(town, at):
        for part in ("ground", "tiles"):
            at(part)
            give_up_s = time.monotonic() + 60.0
            while not any(part in line for line in told) and time.monotonic() < give_up_s:
                time.sleep(0.01)
        return packed

    monkeypatch.setattr("wcsim.towns.build_street.build_street", build)
    monkeypatch.setattr(street, "_EVERY_S", 0.05)
    load_street(corner_town, told.append)
    assert " (once, then cached): " in told[0] and not any("cached" in line for line in told[1:])
    assert re.search(r": tiles, after \d+ s$", told[-1])
