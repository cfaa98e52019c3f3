"""A street's rasters: read only where and as far as somebody asks, kept while they are asked for, given up then."""

import numpy as np
import pytest

from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.ground import tiles
from wcsim.towns.ground.tiles import RASTER_M, Packed, TileStore
from wcsim.towns.scenario.town import Town
from wcsim.types import Street


@pytest.fixture(scope="module")
def packed(corner_town: Town) -> Packed:
    return build_street(corner_town)


@pytest.fixture
def street(packed: Packed) -> Street:
    return unpack_street(packed)


def store_of(street: Street) -> TileStore:
    assert isinstance(street.grid, TileStore)
    return street.grid


def held(store: TileStore) -> int:
    """Rasters in memory."""
    layers = [(g.height_cm, g.ground_class, g.clearance_dm) for g in store._cached.values()]
    return sum(raster.size > 0 for grid in layers for raster in grid)


def middles(store: TileStore) -> np.ndarray:
    """A place (n, 2) on each raster of the town."""
    (west, south), (east, north) = store._first, store._last
    return np.array(
        [((x + 0.5) * RASTER_M, (y + 0.5) * RASTER_M) for x in range(west, east + 1) for y in range(south, north + 1)]
    )


def test_for_heights_nothing_else_is_read(street: Street) -> None:
    store = store_of(street)
    x_m, y_m = middles(store)[0].tolist()
    height_m = store.height_here(x_m, y_m)
    assert held(store) == 1
    class_id = store.class_here(x_m, y_m)
    assert held(store) == 3
    assert (store.height_here(x_m, y_m), store.class_here(x_m, y_m)) == (height_m, class_id)
    assert float(store.around(np.array((x_m, y_m))).height_at(np.array((x_m, y_m)))) == height_m


def test_what_was_asked_for_lately_stays_and_the_rest_goes(street: Street, monkeypatch: pytest.MonkeyPatch) -> None:
    store, read = store_of(street), []
    monkeypatch.setattr(tiles, "_CACHED", 2)
    monkeypatch.setattr(tiles, "_RECENT_REQUESTS", 4)
    monkeypatch.setattr(TileStore, "_unpacked", lambda self, *a, of=TileStore._unpacked: read.append(1) or of(self, *a))
    here, there, last = (tuple(p.tolist()) for p in middles(store)[:3])
    for _ in range(3):  # three are in use, though only two would be kept
        for place in (here, there, last):
            store.height_here(*place)
    assert (len(read), held(store)) == (3, 3)
    for _ in range(4):
        store.height_here(*last)
    store.around(np.array(last))  # its three are more than are kept; the others are old
    assert set(store._cached) == set(store._used) == {next(reversed(store._cached))}
    assert held(store) == 3


def test_even_of_what_is_asked_for_there_is_a_most(street: Street, monkeypatch: pytest.MonkeyPatch) -> None:
    store = store_of(street)
    monkeypatch.setattr(tiles, "_CACHED", 1)
    monkeypatch.setattr(tiles, "_MOST_CACHED", 4)
    wanted = store.class_at(middles(store))
    for _ in range(2):
        for point, class_id in zip(middles(store), wanted, strict=True):
            store.height_here(*point.tolist())  # may throw out what the next line needs
            assert store.class_here(*point.tolist()) == class_id
            assert held(store) <= 4


def test_a_raster_of_another_size_is_refused(packed: Packed) -> None:
    store = TileStore(packed, store_of(unpack_street(packed))._relief)
    name = next(name for name in packed if name.endswith("height_cm"))
    with pytest.raises(ValueError, match="not of"):
        tiles._raster_of(packed[name], (10, 10))
    assert held(store) == 0
