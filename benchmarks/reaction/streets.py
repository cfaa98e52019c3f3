"""Small streets for the reaction bench, built with netconvert when they are needed.

A straight main street with a zebra in mid-block and a side street, and dense traffic of every kind in both directions
and round the corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wcsim.errors import SumoError
from wcsim.towns.importing.folder_texts import sumocfg_text, town_toml_text
from wcsim.towns.scenario.town import Town, open_town
from wcsim.towns.sumo.tools import run_tool
from wcsim.towns.sumo.xml_io import without_comments, write_gzip

_NODES = """<nodes>
    <node id="A" x="-180" y="0" type="priority"/>
    <node id="C" x="0" y="0" type="priority"/>
    <node id="Z" x="70" y="0" type="priority"/>
    <node id="B" x="230" y="0" type="priority"/>
    <node id="N" x="0" y="130" type="priority"/>
    <node id="S" x="10" y="-130" type="priority"/>
</nodes>"""
_EDGES = """<edges>
    <edge id="AC" from="A" to="C" type="main"/><edge id="CA" from="C" to="A" type="main"/>
    <edge id="CZ" from="C" to="Z" type="main"/><edge id="ZC" from="Z" to="C" type="main"/>
    <edge id="ZB" from="Z" to="B" type="main"/><edge id="BZ" from="B" to="Z" type="main"/>
    <edge id="NC" from="N" to="C" type="side"/><edge id="CN" from="C" to="N" type="side"/>
    <edge id="SC" from="S" to="C" type="side"/><edge id="CS" from="C" to="S" type="side"/>
</edges>"""
_CROSSINGS = """<connections>
    <crossing node="Z" edges="CZ ZC" priority="true" width="4"/>
    <crossing node="C" edges="NC CN" priority="true" width="4"/>
    <crossing node="C" edges="SC CS" priority="true" width="4"/>
</connections>"""
_TYPES = """<types>
    <type id="main" priority="3" numLanes="{lanes}" speed="13.89" width="{width}" sidewalkWidth="{pavement}"
          {bike} disallow="pedestrian wheelchair"/>
    <type id="side" priority="1" numLanes="1" speed="8.33" width="3.25" sidewalkWidth="2.5"
          disallow="pedestrian wheelchair"/>
</types>"""
_VTYPES = """
    <vType id="car" vClass="passenger" length="4.5" width="1.82" height="1.46" sigma="0.5"/>
    <vType id="van" vClass="passenger" length="5.4" width="2.02" height="2.3" accel="2.2" sigma="0.5"/>
    <vType id="truck" vClass="truck" length="9.5" width="2.5" height="3.6"/>
    <vType id="bus" vClass="bus" length="12.0" width="2.55" height="3.2"/>
    <vType id="slow" vClass="bicycle" length="1.75" width="0.6" height="1.7" maxSpeed="4.2"/>
    <vType id="fast" vClass="bicycle" length="1.7" width="0.55" height="1.7" maxSpeed="7.5"/>
    <vType id="adult" vClass="pedestrian" length="0.28" width="0.48" height="1.7" maxSpeed="1.4" speedDev="0.15"/>
    <vType id="child" vClass="pedestrian" length="0.2" width="0.34" height="1.2" maxSpeed="1.2" speedDev="0.2"/>"""
_THROUGH = ("AC CZ ZB", "BZ ZC CA")
_CORNERS = ("NC CZ ZB", "AC CS", "BZ ZC CN", "SC CA", "NC CS")
_WALKS = ("AC CZ ZB", "BZ ZC CA", "ZB CZ AC", "CA ZC BZ", "AC CZ BZ", "NC ZC BZ", "SC CZ ZB")
_PER_HOUR = (("car", 260, _THROUGH), ("van", 60, _THROUGH), ("truck", 30, _THROUGH), ("bus", 30, _THROUGH),
             ("slow", 90, _THROUGH), ("fast", 60, _THROUGH), ("car", 40, _CORNERS), ("truck", 12, _CORNERS),
             ("bus", 12, _CORNERS), ("slow", 25, _CORNERS))  # fmt: skip
_FOREVER_S = 3600  # SUMO makes all persons of a flow at its start


@dataclass(frozen=True, slots=True, kw_only=True)
class SmallStreet:
    """A variant of the small street."""

    name: str
    lanes: int = 1  # each way
    lane_m: float = 3.25
    pavement_m: float = 2.5
    bike_lane_m: float = 1.6  # 0: bicycles ride among the cars
    traffic: float = 1.0  # share of the vehicles
    motors_only: bool = False  # nobody else, whom drivers would wait for


SMALL_STREETS = (
    SmallStreet(name="one-lane"),
    SmallStreet(name="two-lanes", lanes=2, pavement_m=3.5, bike_lane_m=2.0),
    SmallStreet(name="mixed", lane_m=3.6, pavement_m=2.0, bike_lane_m=0.0, traffic=0.6),
)


def build_small_street(street: SmallStreet, work: Path, seed: int) -> Town:
    """Build a small street into `work` and return it as a town. Raises SumoError when netconvert refuses it."""
    work.mkdir(parents=True, exist_ok=True)
    bike = f'bikeLaneWidth="{street.bike_lane_m}"' if street.bike_lane_m else ""
    types = _TYPES.format(lanes=street.lanes, width=street.lane_m, pavement=street.pavement_m, bike=bike)
    for kind, text in (("nod", _NODES), ("edg", _EDGES), ("con", _CROSSINGS), ("typ", types)):
        (work / f"street.{kind}.xml").write_text(text, encoding="utf-8")
    inputs = ["-n", "street.nod.xml", "-e", "street.edg.xml", "-x", "street.con.xml", "-t", "street.typ.xml"]
    options = ["--walkingareas", "--junctions.corner-detail", "5", "--no-turnarounds", "-o", "plain.net.xml"]
    run = run_tool("netconvert", [*inputs, *options, "--offset.disable-normalization"], work)
    if run.returncode:
        raise SumoError(f"bench street {street.name}: no net could be built: {run.reason()}; is eclipse-sumo complete?")
    name = street.name
    write_gzip(work / f"{name}.net.xml.gz", without_comments((work / "plain.net.xml").read_bytes()))
    (work / f"{name}.rou.xml").write_text(_routes(street), encoding="utf-8")
    (work / f"{name}.sumocfg").write_text(sumocfg_text(name, seed, routes=f"{name}.rou.xml", additional=()), "utf-8")
    (work / "town.toml").write_text(town_toml_text(name=name, split="scene"), encoding="utf-8")
    return open_town(work / f"{name}.sumocfg")


def _routes(street: SmallStreet) -> str:
    flows, traffic = [], street.traffic
    for i, (kind, per_hour, ways) in enumerate(_PER_HOUR):
        if street.motors_only and kind in ("slow", "fast"):
            continue
        for j, way in enumerate(ways):
            when = f'begin="0" end="{_FOREVER_S}" period="exp({traffic * per_hour / 3600:.6f})"'
            drive = 'departLane="best" departSpeed="max"'
            flows.append(f'    <flow id="{kind}.{i}.{j}" type="{kind}" {when} {drive}><route edges="{way}"/></flow>')
    for j, way in enumerate(() if street.motors_only else _WALKS):
        for kind, per_hour in (("adult", 90), ("child", 15)):
            when = f'begin="0" end="{_FOREVER_S}" period="exp({per_hour / 3600:.6f})"'
            walk = f'departPos="random"><walk edges="{way}"/>'
            flows.append(f'    <personFlow id="{kind}.{j}" type="{kind}" {when} {walk}</personFlow>')
    return "<routes>" + _VTYPES + "\n" + "\n".join(flows) + "\n</routes>\n"
