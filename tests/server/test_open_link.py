from __future__ import annotations

from tests.server.test_links import ledger, order
from wcsim.server.local import LocalLink
from wcsim.server.open_link import open_link
from wcsim.server.process_link import ProcessLink


def test_the_second_world_gets_a_process_of_its_own(corner):
    with open_link(order(corner)) as first, open_link(order(corner)) as second:
        assert isinstance(first, LocalLink)
        assert isinstance(second, ProcessLink)
        assert ledger(second, 10) == ledger(first, 10)
