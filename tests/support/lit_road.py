"""A straight road with one crossing under a traffic light, whose program gives people green when it sees them."""

from pathlib import Path

from wcsim.towns.scenario.town import Town
from wcsim.towns.scene_folders.build import build_scene

CROSSING_LINKS = (2,)  # behind the two directions of the road in the colours of light "C"

_FILES = {
    "scene.toml": 'name = "lit-road"\nshows = "A road with a light for people on foot."\nseed = 1\nduration_s = 9.0\n'
    '[[seats]]\nstart_m = [-7.0, -5.0]\nheading_deg = 0.0\ngoal_m = [12.0, 5.0]\nprofile = "competent"\n[expect]\n',
    "street.nod.xml": '<nodes><node id="W" x="-60" y="0"/><node id="E" x="60" y="0"/>'
    '<node id="C" x="0" y="0" type="traffic_light" tlType="{kind}"/></nodes>',
    "street.edg.xml": '<edges><edge id="WC" from="W" to="C" type="road"/><edge id="CW" from="C" to="W" type="road"/>'
    '<edge id="EC" from="E" to="C" type="road"/><edge id="CE" from="C" to="E" type="road"/></edges>',
    "street.con.xml": '<connections><crossing node="C" edges="WC CW" priority="true" width="4"/></connections>',
    "street.typ.xml": '<types><type id="road" numLanes="1" speed="13.9" sidewalkWidth="3.0" width="3.25"/></types>',
    "street.rou.xml": '<routes><vType id="car" vClass="passenger"/><flow id="f" type="car" begin="0" end="3600" '
    'period="7"><route edges="WC CE"/></flow></routes>',
}


def lit_road(folder: Path, kind: str = "actuated") -> Town:
    """Build it in a folder; `kind` is the program's, as netconvert calls it."""
    source = folder / "source"
    source.mkdir()
    for name, text in _FILES.items():
        (source / name).write_text(text.replace("{kind}", kind))
    town, _ = build_scene(source, folder / "town")
    return town
