"""The street in an engine, tile by tile: what nobody is near leaves it, and comes back from shapes that are kept."""

from __future__ import annotations

from collections.abc import Callable

from wcsim.physics.engine import Engine, StreetPiece
from wcsim.types import StreetMesh, TileKey


class StreetBodies:
    """The tiles of one engine; `keys` are those that lie in it now."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._pieces: dict[TileKey, tuple[StreetPiece, ...]] = {}  # of every tile that ever was there
        self.keys: set[TileKey] = set()

    def lay(self, key: TileKey, mesh: Callable[[], StreetMesh]) -> None:
        """Put a tile into the engine that is not there; `mesh` is asked for it the first time only.

        Raises:
            PhysicsError: The mesh holds numbers that are not finite or faces that point at no vertex.
        """
        pieces = self._pieces.get(key)
        self._pieces[key] = self._engine.add_street(mesh()) if pieces is None else self._engine.lay_street(pieces)
        self.keys.add(key)

    def lift(self, key: TileKey) -> None:
        """Take a tile out of the engine. Raises KeyError when it is not there."""
        self.keys.remove(key)
        self._engine.lift_street(self._pieces[key])
