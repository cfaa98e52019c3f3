"""What cameras look at."""

import pytest

from tests.support.samples import strip_street
from wcsim.types.street import StreetMesh


@pytest.fixture(scope="module")
def mesh() -> StreetMesh:
    return strip_street().mesh
