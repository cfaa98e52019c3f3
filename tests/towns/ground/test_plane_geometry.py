"""Areas of somebody else's streets stay whole, whatever is done to them."""

import shapely

from wcsim.towns.ground.plane_geometry import Patches, buffered

HOLE = ((0.09, 0.43), (0.1, 0.05), (0.26, 0.47), (-0.06, 0.56))
AREA = shapely.set_precision(shapely.Polygon(shapely.box(-2, -2, 2, 2).exterior, [HOLE]), 0.01)


def test_what_a_buffer_breaks_on_a_grid_is_mended_so_that_it_can_be_cut() -> None:
    assert AREA.is_valid and not AREA.buffer(0.05, join_style="mitre").is_valid
    wider = buffered(AREA, 0.05, join_style="mitre")
    assert wider.is_valid and wider.geom_type == "Polygon" and wider.covers(AREA)
    near = Patches(wider).near((0.0, 0.0, 1.0, 1.0))
    assert near.intersection(shapely.box(0.0, 0.0, 1.0, 1.0)).area > 0.9
