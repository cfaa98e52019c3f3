from __future__ import annotations

from dataclasses import replace

from wcsim.towns.street import load_street


def test_what_is_driven_once_is_not_kept(corner_town, own_cache):
    passing = load_street(replace(corner_town, passing=True))
    assert not list(own_cache.rglob("street-*"))
    assert len(passing.walk.edges) == len(load_street(corner_town, lambda told: None).walk.edges) > 0
    assert list(own_cache.rglob("street-*"))
