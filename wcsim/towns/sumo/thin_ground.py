"""Ground of a net that has no width: netconvert makes walking areas and junctions of two points."""

from xml.etree.ElementTree import Element

from shapely import LineString

from wcsim.towns.sumo.xml_io import xml_bytes

_HALF_M = 0.05  # of the width that it gets


def widen_ground(root: Element) -> bytes:
    """The net of `root`, which is changed, with a little width where its ground has none.

    At the ends of some streets there is such ground. SUMO 1.28 dies of it when it joins the
    ground for JuPedSim.
    """
    areas = root.iterfind("edge[@function='walkingarea']/lane")
    for item in [*areas, *root.iterfind("junction")]:
        ends = [end.split(",") for end in dict.fromkeys(item.get("shape", "").split())]
        if len(ends) == 2:
            line = LineString([(float(end[0]), float(end[1])) for end in ends])
            outline = line.buffer(_HALF_M, cap_style="flat").exterior.coords[:-1]
            points = (",".join([f"{x:.2f}", f"{y:.2f}", *ends[0][2:]]) for x, y in outline)
            item.set("shape", " ".join(points))
    return xml_bytes(root)
