"""After every tick the mirror holds exactly those that SUMO has, whatever SUMO does with them."""

import re

import libsumo
import pytest

from tests.support.menagerie import MirrorLoop, build_street, ids_in_street, mirror_loop
from wcsim.types import ActorKind

TYPES = """
    <vType id="car" vClass="passenger" length="4.5" width="1.8" height="1.5"/>
    <vType id="bike" vClass="bicycle" length="1.75" width="0.6" height="1.75"/>
    <vType id="lorry" vClass="truck" length="9.5" width="2.5" height="3.6"/>
    <vType id="bus" vClass="bus" length="12" width="2.5" height="3.2"/>
    <vType id="walker" vClass="pedestrian" length="0.28" width="0.48" height="1.75"/>
"""
ADDITIONAL = """
    <busStop id="stop" lane="CE_1" startPos="80" endPos="100"/>
    <parkingArea id="lot" lane="WC_1" startPos="100" endPos="160" roadsideCapacity="6" angle="45"/>
"""
EVENTS = """
    <vehicle id="parked" type="car" depart="0" departPos="stop">
        <route edges="WC CE"/><stop parkingArea="lot" duration="1000"/>
    </vehicle>
    <vehicle id="leaves" type="car" depart="0" departPos="stop">
        <route edges="WC CE"/><stop parkingArea="lot" duration="6"/>
    </vehicle>
    <vehicle id="broken" type="lorry" depart="0" departPos="30" departSpeed="0">
        <route edges="SC CE"/><stop lane="SC_1" endPos="60" duration="1000"/>
    </vehicle>
    <person id="rides" type="walker" depart="0" departPos="75">
        <walk from="CE" busStop="stop"/><ride to="CE" lines="line"/></person>
    <person id="walks" type="walker" depart="0" departPos="200"><walk from="WC" to="CW" arrivalPos="200"/></person>
    <person id="brief" type="walker" depart="1" departPos="20"><walk from="CE" to="CE" arrivalPos="25"/></person>
    <vehicle id="jammed" type="car" depart="2" departSpeed="max"><route edges="SC CE"/></vehicle>
    <vehicle id="line" type="bus" line="line" depart="18" departPos="20">
        <route edges="CE"/><stop busStop="stop" duration="8"/>
    </vehicle>
"""
FLOWS = """
    <flow id="cars" type="car" begin="0" end="5000" probability="0.25" departLane="random" departSpeed="max">
        <route edges="WC CE"/></flow>
    <flow id="turning" type="car" begin="0" end="5000" probability="0.1"><route edges="EC CS"/></flow>
    <flow id="lorries" type="lorry" begin="0" end="5000" probability="0.05"><route edges="SC CE"/></flow>
    <flow id="bikes" type="bike" begin="0" end="5000" probability="0.1"><route edges="EC CW"/></flow>
    <personFlow id="people" type="walker" begin="0" end="5000" probability="0.2" departPos="random">
        <walk from="WC" to="CE" arrivalPos="random"/></personFlow>
"""


def watch(loop: MirrorLoop, ticks: int) -> tuple[set[str], dict[tuple[object, ...], int]]:
    """Everybody who was seen, and of each kind and size the most at once; the sets are compared every tick."""
    seen: set[str] = set()
    most: dict[tuple[object, ...], int] = {}
    for _ in range(ticks):
        actors = loop.tick()
        assert {actor.id for actor in actors} == set(loop.pool.names()) == ids_in_street(loop.radius_m)
        seen |= {actor.id for actor in actors}
        now: dict[tuple[object, ...], int] = {}
        for actor in actors:
            key = (actor.kind, *actor.size_lwh_m)
            now[key] = now.get(key, 0) + 1
        most = {key: max(most.get(key, 0), now.get(key, 0)) for key in most | now}
    return seen, most


def test_departed_arrived_parked_riding_and_teleported_ones(tmp_path, caplog):
    cfg = build_street(tmp_path, TYPES + EVENTS, ADDITIONAL, lanes=1)
    with mirror_loop(cfg, radius_m=250.0, jam_teleport_s=5.0) as loop:
        seen: set[str] = set()
        teleported, rode, came_and_went = set(), False, 0
        before: set[str] = set()
        for _ in range(450):
            now, _ = watch(loop, 1)
            came_and_went += len(now ^ before)
            before = now
            seen |= now
            teleported |= set(libsumo.simulation.getStartingTeleportIDList())
            rode = rode or ("rides" in libsumo.person.getIDList() and libsumo.person.getVehicle("rides") != "")
        assert teleported == {"jammed"} and rode
        assert loop.sumo.mishaps[0] == 1
        (line,) = (record.getMessage() for record in caplog.records if "jam" in record.getMessage())
        assert re.fullmatch(r"jam: SUMO teleported jammed, which stood too long on edge SC, at 1\d\.\d s", line)
        assert {"v:parked", "v:broken"} <= before, "who stands stays in the mirror"
        assert not {"p:brief", "p:rides"} & before
        assert {"v:leaves", "v:line", "p:rides", "p:walks", "p:brief", "v:jammed"} <= seen
        assert came_and_went >= 10
        assert loop.pool.made <= 8


def test_a_parked_car_stands_in_its_lot_and_a_waiting_person_at_the_stop(tmp_path):
    cfg = build_street(tmp_path, TYPES + EVENTS, ADDITIONAL, lanes=1)
    with mirror_loop(cfg) as loop:
        for _ in range(300):
            loop.tick()
            waiting = [a for a in loop.actors if a.id == "p:rides"]
            if waiting and libsumo.person.getSpeed("rides") == 0.0 and libsumo.person.getStage("rides").type == 3:
                break
        assert waiting and waiting[0].kind is ActorKind.PEDESTRIAN
        parked = next(a for a in loop.actors if a.id == "v:parked")
        assert -205.0 < parked.p_W_m[0] < -135.0 and -10.0 < parked.p_W_m[1] < -3.5, "beside the lane"


def test_no_ghosts_and_no_leaks_in_a_while(tmp_path):
    with mirror_loop(build_street(tmp_path, TYPES + FLOWS), radius_m=120.0, demand_scale=1.0) as loop:
        seen, most = watch(loop, 600)
        assert len(seen) > 25
        assert loop.pool.made == sum(most.values())


@pytest.mark.proof
def test_no_ghosts_and_no_leaks_in_ten_thousand_ticks(tmp_path):
    with mirror_loop(build_street(tmp_path, TYPES + FLOWS), radius_m=120.0) as loop:
        seen, most = watch(loop, 10_000)
        assert len(seen) > 400
        assert loop.pool.made == sum(most.values()) < 120, "bodies are used again: never more than were needed at once"
