"""An engine without a street, and a chair on a flat one."""

from collections.abc import Iterator

import pytest

from tests.physics.rig import Rig, rig
from wcsim.physics.engine import Engine


@pytest.fixture
def engine() -> Iterator[Engine]:
    with Engine(1 / 240) as made:
        yield made


@pytest.fixture
def on_flat() -> Iterator[Rig]:
    with rig() as made:
        yield made
