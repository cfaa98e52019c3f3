"""Which parts of the walkable ground nobody can walk to."""

from pathlib import Path

import shapely

from tests.towns.made.nets import edge, lane, write_net
from wcsim.towns.walking.islands import cut_off


def test_raised_ground_of_a_net_without_pavements_is_no_part_that_is_cut_off(tmp_path: Path) -> None:
    net = write_net(tmp_path, edge("s", lane("0,0 60,0"), lane("0,3.2 60,3.2")))
    assert cut_off(net, [shapely.box(0.0, 0.0, 5.0, 5.0), shapely.box(9.0, 0.0, 12.0, 5.0)]) == ()
