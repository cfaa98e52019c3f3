"""Ground of a net that has no width: netconvert makes walking areas and junctions of two points."""

from math import dist
from xml.etree.ElementTree import Element

from wcsim.towns.sumo.xml_io import xml_bytes

_HALF_M = 0.05  # of the width that it gets


def widen_ground(root: Element) -> bytes | None:
    """The net of `root` with a little width where its ground has none; None where all has some.

    `root` is changed. At the ends of some streets there is such ground. SUMO 1.28 dies of it when
    it joins the ground for JuPedSim.
    """
    is_changed = False
    areas = root.iterfind("edge[@function='walkingarea']/lane")
    for item in [*areas, *root.iterfind("junction")]:
        ends = [end.split(",") for end in item.get("shape", "").split()]
        try:
            places = {(float(end[0]), float(end[1])): end[2:] for end in ends}
        except (IndexError, ValueError):  # SUMO says what is wrong with it
            continue
        if len(places) == 2:
            ((x, y), height), ((x2, y2), _) = places.items()
            side = _HALF_M / dist((x, y), (x2, y2))
            east_m, north_m = side * (y2 - y), side * (x - x2)
            corners = (
                (x + east_m, y + north_m),
                (x2 + east_m, y2 + north_m),
                (x2 - east_m, y2 - north_m),
                (x - east_m, y - north_m),
            )
            points = (",".join([f"{u:.2f}", f"{v:.2f}", *height]) for u, v in corners)
            item.set("shape", " ".join(points))
            is_changed = True
    return xml_bytes(root) if is_changed else None
