"""Scenarios of strangers that would write, read or repeat what they should not, on the streets of a sound town."""

import gzip
from pathlib import Path

from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.xml_io import read_root


def lane_of(town: Town) -> str:
    """A lane that cars may use, at least 20 m long."""
    root = read_root(town.net)
    for edge in root.iterfind("edge"):
        for lane in edge.iterfind("lane"):
            walkers = "pedestrian" in lane.get("allow", "") or edge.get("function")
            if not walkers and float(lane.get("length", "0")) > 20.0 and "passenger" not in lane.get("disallow", ""):
                return lane.get("id", "")
    raise AssertionError("no lane for cars")


def scenario(town: Town, folder: Path, options: str = "", more: str = "", vehicles: str = "") -> Path:
    """A .sumocfg in `folder` with one car, `more` in its additional file and `options` beside its inputs."""
    folder.mkdir(parents=True, exist_ok=True)
    edge = lane_of(town).rpartition("_")[0]
    (folder / "a.net.xml").write_bytes(gzip.decompress(town.net.read_bytes()))
    (folder / "a.add.xml").write_text(f"<additional>{more}</additional>")
    cars = vehicles or f'<vehicle id="one" depart="0"><route edges="{edge}"/></vehicle>'
    (folder / "a.rou.xml").write_text(f"<routes>{cars}</routes>")
    (folder / "a.sumocfg").write_text(
        "<configuration><n value='a.net.xml'/><routes value='a.rou.xml'/><a value='a.add.xml'/>"
        f"{options}</configuration>",
    )
    return folder / "a.sumocfg"


def hostile_additional(lane: str, place: str) -> str:
    """Every kind of element that writes a file, each into the folder `place`."""
    edge = lane.rpartition("_")[0]
    return f"""
    <e1Detector id="e1" lane="{lane}" pos="5" period="5" file="{place}/e1.xml"/>
    <inductionLoop id="e1b" lane="{lane}" pos="6" freq="5" file="{place}/e1.xml"/>
    <instantInductionLoop id="ei" lane="{lane}" pos="5" file="{place}/instant.xml"/>
    <laneAreaDetector id="e2" lane="{lane}" pos="1" endPos="9" period="5" file="{place}/e2.xml"/>
    <entryExitDetector id="e3" period="5" file="{place}/e3.xml">
        <detEntry lane="{lane}" pos="2"/><detExit lane="{lane}" pos="8"/>
    </entryExitDetector>
    <edgeData id="ed" file="{place}/edges.xml" period="5"/>
    <laneData id="ld" file="{place}/sub/lanes.xml" period="5"/>
    <vTypeProbe id="vp" period="1" file="{place}/probe.xml"/>
    <routeProbe id="rp" edge="{edge}" period="5" file="{place}/routes.xml"/>
    <calibrator id="ca" edge="{edge}" pos="0" output="{place}/calibrator.xml">
        <flow begin="0" end="9" vehsPerHour="100" speed="8"/>
    </calibrator>
    <vType id="watched"><param key="has.ssm.device" value="true"/>
        <param key="device.ssm.file" value="{place}/ssm.xml"/></vType>
    <vType id="plain" speedTable="0 5 10 15" maxAccelProfile="0 2 10 1"/>
    """
