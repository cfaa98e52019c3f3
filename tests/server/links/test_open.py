from __future__ import annotations

from tests.server.links.test_links import ledger, order
from tests.server.servers import alone
from wcsim.server.links.local import LocalGroup
from wcsim.server.links.open import open_group
from wcsim.server.links.socket import ProcessGroup


def test_the_second_world_gets_a_process_of_its_own(corner):
    first = open_group(order(corner))
    second = open_group(order(corner))
    assert isinstance(first, LocalGroup)
    assert isinstance(second, ProcessGroup)
    with alone(first) as here, alone(second) as there:
        assert ledger(there, 10) == ledger(here, 10)
