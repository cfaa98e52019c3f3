from __future__ import annotations

from tests.server.links.test_links import ledger, order
from wcsim.server.links.child_world import ProcessLink
from wcsim.server.links.local import LocalLink
from wcsim.server.links.open import open_link


def test_the_second_world_gets_a_process_of_its_own(corner):
    with open_link(order(corner)) as first, open_link(order(corner)) as second:
        assert isinstance(first, LocalLink)
        assert isinstance(second, ProcessLink)
        assert ledger(second, 10) == ledger(first, 10)
