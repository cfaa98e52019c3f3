"""Classes of crashes, from facts made by hand."""

from dataclasses import replace

import pytest

from benchmarks.crashes.classes import CrashClass, CrashFacts, classify
from wcsim.config import RewardConfig
from wcsim.core.frames import rad
from wcsim.supervisor.rewards import fault, hardest
from wcsim.types import ActorKind, Contact

REWARD = RewardConfig()


def touch(kind, part="footplate", impulse_Ns=40.0, cause="own", actor_id=""):
    return Contact(kind=kind, part=part, impulse_Ns=impulse_Ns, cause=cause, actor_id=actor_id)


def facts(*contacts, **other):
    plain = CrashFacts(
        reason="collision",
        contacts=contacts,
        on_road=False,
        fell_s=None,
        straddles=False,
        kerb_beside=False,
        roll_rad=0.0,
        pitch_rad=0.0,
    )
    return replace(plain, **other)


KERB = touch("kerb")
GROUND = touch("ground")
CASES = {
    "rams the kerb from the road after a fall": (facts(KERB, on_road=True, fell_s=4.0), CrashClass.KERB_AFTER_FALL),
    "10 s after a fall": (facts(KERB, on_road=True, fell_s=10.0), CrashClass.KERB_AFTER_FALL),
    "a fall too long ago": (facts(KERB, on_road=True, fell_s=10.1), CrashClass.KERB),
    "never fell": (facts(KERB, on_road=True), CrashClass.KERB),
    "back on the pavement": (facts(KERB, on_road=False, fell_s=5.0), CrashClass.KERB),
    "hits the edge of the pavement": (
        facts(touch("kerb", impulse_Ns=0.1), GROUND, on_road=True, fell_s=3.0),
        CrashClass.KERB_AFTER_FALL,
    ),
    "ground with a kerb beside": (facts(GROUND, on_road=True, kerb_beside=True), CrashClass.KERB),
    "a wheel on the kerb is none": (
        facts(GROUND, touch("kerb", part="wheel"), on_road=True),
        CrashClass.GROUND,
    ),
    "body strikes in the fall": (facts(GROUND, on_road=True, fell_s=0.3), CrashClass.FALLING),
    "footplate strikes the kerb in the fall": (facts(KERB, on_road=True, fell_s=1.0), CrashClass.FALLING),
    "over the edge": (facts(GROUND, straddles=True), CrashClass.FALLING),
    "casters already up": (facts(KERB, on_road=True, straddles=True, fell_s=5.0), CrashClass.KERB_AFTER_FALL),
    "foot of a ramp": (facts(GROUND), CrashClass.GROUND),
    "drop": (facts(reason="drop", on_road=True, fell_s=0.1), CrashClass.DROP),
    "wall": (facts(touch("building")), CrashClass.WALL),
    "wall, harder than the ground": (facts(touch("building", impulse_Ns=90.0), GROUND), CrashClass.WALL),
    "pole": (facts(touch("static", part="wheel")), CrashClass.FURNITURE),
    "person": (facts(touch("pedestrian", impulse_Ns=0.01)), CrashClass.PEDESTRIAN),
    "bicycle": (facts(touch("bicycle")), CrashClass.CYCLIST),
    "kick scooter": (facts(touch("scooter")), CrashClass.CYCLIST),
    "car": (facts(touch("car")), CrashClass.CAR),
    "motorcycle": (facts(touch("motorcycle")), CrashClass.CAR),
    "parked car": (facts(touch("car"), parked=True), CrashClass.PARKED),
    "bus": (facts(touch("bus")), CrashClass.LARGE),
    "truck": (facts(touch("truck")), CrashClass.LARGE),
    "tram": (facts(touch("tram")), CrashClass.LARGE),
    "wheelchair": (facts(touch("wheelchair")), CrashClass.CHAIR),
    "unknown actor": (facts(touch("other")), CrashClass.OTHER),
    "tilt": (facts(reason="tilt", roll_rad=rad(21.0)), CrashClass.ROLLOVER),
    "lies on its side": (facts(GROUND, roll_rad=rad(-60.0), on_road=True, fell_s=0.5), CrashClass.ROLLOVER),
    "on its back": (facts(GROUND, pitch_rad=rad(31.0)), CrashClass.ROLLOVER),
    "acceleration": (facts(reason="acceleration"), CrashClass.JOLT),
    "nothing touched": (facts(), CrashClass.OTHER),
}


@pytest.mark.parametrize("name", CASES)
def test_a_crash_has_the_class_that_a_person_would_give_it(name):
    case, expected = CASES[name]
    assert classify(case, REWARD) is expected


def test_every_class_has_a_case_and_every_actor_a_class():
    assert {expected for _, expected in CASES.values()} == set(CrashClass)
    for kind in ActorKind:
        given = classify(facts(touch(kind.value)), REWARD)
        assert (given is CrashClass.OTHER) == (kind is ActorKind.OTHER)


def test_the_hardest_touch_that_counts_decides():
    scrape = touch("ground", impulse_Ns=5.0)
    wheel = touch("kerb", part="wheel", impulse_Ns=900.0)
    assert hardest("collision", (wheel, scrape), REWARD) is None
    walker = touch("pedestrian", impulse_Ns=1.0, cause="other", actor_id="p:1")
    assert hardest("collision", (wheel, scrape, walker), REWARD) is walker
    wall = touch("building", impulse_Ns=2.0)
    assert hardest("collision", (walker, wall), REWARD) is wall


def test_fault_is_the_cause_of_the_hardest_touch_and_else_own():
    walker = touch("pedestrian", cause="other")
    assert fault("collision", (walker,), REWARD) == "other"
    assert fault("collision", (walker, touch("building", impulse_Ns=99.0)), REWARD) == "own"
    assert fault("tilt", (walker,), REWARD) == "own"
    assert fault("drop", (), REWARD) == "own"
