"""Where SUMO measures a vehicle and a person: at the middle of the front, both of them; found by measuring."""

import math

import libsumo
import numpy as np
import pytest

from tests.support.menagerie import build_street, mirror_loop
from wcsim.core import frames


@pytest.mark.parametrize("edges, start, end", [("WC CE", 250, 50), ("CE WC", 50, 250)])
def test_a_person_stops_with_its_front_at_the_kerb_whatever_its_length(tmp_path, edges, start, end):
    """People of three lengths wait at a red crossing: SUMO's points are equal, so that a point is the front of each."""
    stood = []
    for length in (0.2, 1.0, 2.0):
        routes = (
            f'<vType id="w" vClass="pedestrian" length="{length}" width="0.4" speedDev="0"/>'
            f'<person id="p" type="w" depart="0" departPos="{start}">'
            f'<walk edges="{edges}" arrivalPos="{end}"/></person>'
        )
        with mirror_loop(build_street(tmp_path / str(length), routes, kind="traffic_light", lanes=1)) as loop:
            before, waits = None, []
            for _ in range(700):
                loop.tick()
                if "p" not in libsumo.person.getIDList():
                    break
                here = libsumo.person.getPosition("p")
                if before is not None and math.dist(here, before) < 1e-4:
                    waits.append(here[0])
                before = here
            actor = next((a for a in loop.actors if a.id == "p:p"), None)
            if actor is not None:
                ahead = frames.forward_vector(actor.yaw_rad, 0.0)
                front = actor.p_W_m + 0.5 * length * ahead
                assert front[:2] == pytest.approx(libsumo.person.getPosition("p"), abs=1e-6)
        stood.append(np.median(waits) if waits else math.nan)
    assert not math.isnan(stood[0]), "nobody had to wait: the measurement says nothing"
    assert stood == pytest.approx([stood[0]] * 3, abs=0.02)


def test_a_vehicle_stands_with_its_front_where_its_stop_ends(tmp_path):
    for length in (3.0, 12.0):
        routes = (
            f'<vType id="c" vClass="passenger" length="{length}"/>'
            '<vehicle id="c" type="c" depart="0" departPos="20"><route edges="WC CE"/>'
            '<stop lane="WC_1" endPos="100" duration="500"/></vehicle>'
        )
        with mirror_loop(build_street(tmp_path / str(length), routes, lanes=1)) as loop:
            for _ in range(300):
                loop.tick()
            (car,) = loop.actors
            front = frames.front_from_centre(car.p_W_m, car.yaw_rad, car.pitch_rad, length)
            assert front[0] == pytest.approx(-300.0 + 100.0, abs=0.5)
            assert car.p_W_m[0] == pytest.approx(front[0] - length / 2)
