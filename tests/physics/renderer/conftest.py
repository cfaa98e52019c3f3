"""The sample street as the rasteriser has it; whoever adds to it gets one for a file of tests."""

import pytest

from tests.support.samples import strip_street
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.raster import RasterRenderer


@pytest.fixture(scope="module")
def store() -> GeometryStore:
    return GeometryStore(strip_street().mesh)


@pytest.fixture(scope="module")
def raster(store: GeometryStore) -> RasterRenderer:
    return RasterRenderer(store)
