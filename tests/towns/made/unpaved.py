"""A scenario as engineers write them: no pavements; stops, detectors and signal programs by lane; a late begin."""

from pathlib import Path

from tests.towns.conftest import tool_output

BEGIN_S = 50300.0
_CONFIG = """<configuration>
    <input><net-file value="u.net.xml"/><route-files value="u.rou.xml"/>
        <additional-files value="u.add.xml,signals/u.tll.xml"/></input>
    <time><begin value="50300"/><end value="50900"/></time>
</configuration>"""
_THINGS = """<?xml version="1.0" encoding="UTF-8"?>
<!-- kept as it is -->
<additional>
    <busStop id="stop" lane="A1B1_0" startPos="40" endPos="60"/>
    <busStop id="at-the-end" lane="B1C1_0" startPos="-21" endPos="-1"/>
    <chargingStation id="plug" lane="C1B1_1" startPos="10" endPos="20"/>
    <parkingArea id="park" lane="B0A0_0" startPos="30" endPos="50" roadsideCapacity="3"/>
    <inductionLoop id="loop" lane="B1C1_1" pos="-1" freq="60" file="loop.xml"/>
    <instantInductionLoop id="instant" lane='A1B1_1' pos="30" file="instant.xml"/>
    <laneAreaDetector id="area" lane="C1B1_0" pos="20" length="60" freq="60" file="area.xml"/>
    <laneAreaDetector id="long" lanes="A1B1_1 B1C1_1" pos="70" endPos="30" freq="60" file="area.xml"/>
    <entryExitDetector id="cut" freq="60" file="cut.xml">
        <detEntry lane="B1C1_0" pos="15"/><detExit lane="B1C1_0" pos="70"/>
    </entryExitDetector>
    <calibrator id="calibrator" lane="B2C2_1" pos="5" period="60" output="calibrator.xml">
        <flow begin="50300" end="50400" route="way" vehsPerHour="100" speed="8"/>
    </calibrator>
    <rerouter id="closed" edges="A1B1"><interval begin="60000" end="60010">
        <closingLaneReroute id="B1C1_0"/></interval></rerouter>
    <variableSpeedSign id="sign" lanes="A1B1_0 A1B1_1"><step time="60000" speed="5"/></variableSpeedSign>
    <taz id="district" edges="A1B1 B1C1"/>
    <poi id="thing" type="x" lane="A1B1_0" pos="50"/>
    <route id="way" edges="B2C2 C2C1"/>
</additional>
"""
_DEMAND = """<routes>
    <flow id="cars" begin="50300" end="50400" period="5" from="A0B0" to="B1C1" departLane="best"/>
    <vehicle id="bus" depart="50300" departLane="0" departPos="20"><route edges="A1B1 B1C1"/>
        <stop busStop="stop" duration="5"/><stop lane="B1C1_0" startPos="20" endPos="40" duration="5"/></vehicle>
    <vehicle id="named" route="way" depart="50301" departLane="1" arrivalLane="1" arrivalPos="-1"/>
</routes>"""
_PHASES = ((42, 0, "G"), (3, 0, "y"), (42, 1, "G"), (3, 1, "y"))  # seconds, which street, its letter


def write_unpaved(folder: Path, *, lefthand: bool = False, signals: str = "static") -> Path:
    """Write the scenario into a folder, and return its .sumocfg."""
    (folder / "signals").mkdir(parents=True)
    options = ["--grid", "--grid.number", "3", "--grid.length", "120", "-j", "traffic_light", "-L", "2"]
    options += ["--default.speed", "13.8", "--no-turnarounds", "--default.junctions.radius", "0.5"]
    options += ["--tls.default-type", signals, "-o", "u.net.xml", *(["--lefthand"] * lefthand)]
    tool_output("netgenerate", options, folder)
    phases = "".join(
        f'<phase duration="{seconds}" state="{"".join((letter if k % 2 == street else "r") * 4 for k in range(4))}"/>'
        for seconds, street, letter in _PHASES
    )
    logic = f'<tlLogic id="B1" type="static" programID="own" offset="0">{phases}</tlLogic>'
    (folder / "signals" / "u.tll.xml").write_text(f"<additional>{logic}</additional>")
    (folder / "u.add.xml").write_text(_THINGS)
    (folder / "u.rou.xml").write_text(_DEMAND)
    (folder / "u.sumocfg").write_text(_CONFIG)
    return folder / "u.sumocfg"
