"""Brings the street near the wheelchairs into memory: tiles for the engine and for the pictures."""

from __future__ import annotations

from functools import partial

from wcsim.bridge.stage_timer import Stopwatch
from wcsim.bridge.sumo.actors import moved
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.sensors.camera import CameraRig
from wcsim.physics.street_bodies import StreetBodies
from wcsim.types import F64, TileKey
from wcsim.types.street import StreetTiles

ENGINE_REACH_M = 10.0  # the street so far around a chair is in the engine
SIGHT_MORE_M = 30.0  # and so far beyond its cameras' range in sight
TILE_KEEP_M = 100.0  # and so much more of it is taken along whenever the pictures need another part
MOST_TILES = 64  # in the engine: a body costs a step 0.05 us wherever it is, so these cost a tenth of a chair
ENGINE_KEEP_M = 250.0  # but what is so near a chair stays
_MOVED_M = 1.0  # who has moved less since tiles were looked for needs no others


class TileLoader:
    """Knows which tiles the cameras have; what an engine has, it is told."""

    def __init__(self, tiles: StreetTiles, rig: CameraRig, range_m: float) -> None:
        """Nothing is loaded yet; cameras see `range_m` far."""
        self._tiles, self._rig = tiles, rig
        self._sight_m = range_m + SIGHT_MORE_M
        self._looked: tuple[StreetBodies, F64] | None = None  # for which engine and from where, the last time
        self._drawn: dict[TileKey, GeometryStore] = {}

    def load(self, places_W_m: F64, laid: StreetBodies, stopwatch: Stopwatch) -> None:
        """Have the street around these places (n, 2) there; `laid` are the tiles in the engine.

        Which tiles are there depends on where the chairs were, and on nothing else. What there is to do is measured as
        "street".
        """
        if self._looked is not None and self._looked[0] is laid and not moved(places_W_m, self._looked[1], _MOVED_M):
            return
        self._looked = laid, places_W_m
        under = [key for key in self._tiles.near(places_W_m, ENGINE_REACH_M) if key not in laid.keys]
        drawn = self._drawn.keys() >= set(self._tiles.near(places_W_m, self._sight_m))
        if drawn and not under:
            return
        with stopwatch.measure("street"):
            for key in under:
                laid.lay(key, partial(self._tiles.mesh, key))
            if len(laid.keys) > MOST_TILES:
                for key in sorted(laid.keys.difference(self._tiles.near(places_W_m, ENGINE_KEEP_M))):
                    laid.lift(key)
            if not drawn:
                keys, old = self._tiles.near(places_W_m, self._sight_m + TILE_KEEP_M), self._drawn
                self._drawn = {key: old.get(key) or GeometryStore(self._tiles.mesh(key)) for key in keys}
                self._rig.show(GeometryStore.joined(list(self._drawn.values())))
