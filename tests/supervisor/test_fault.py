import pytest

from wcsim.config import RewardConfig
from wcsim.supervisor.rewards import describe_crash
from wcsim.types import Contact


def hit(kind, actor_id="", cause="own", impulse_Ns=50.0):
    return Contact(kind=kind, part="body", impulse_Ns=impulse_Ns, cause=cause, actor_id=actor_id)


@pytest.mark.parametrize(
    "reason, contacts, words",
    [
        ("collision", (hit("bicycle", "v:b:2"),), "drove into bicycle b:2"),
        ("collision", (hit("static"), hit("pedestrian", "p:a", "other", 60.0)), "was hit by pedestrian a"),
        ("collision", (hit("tram", "v:t~1", "other"),), "was hit by tram t"),
        ("collision", (hit("wheelchair", "w:1"),), "drove into wheelchair 1"),
        ("collision", (hit("kerb"),), "drove into a kerb"),
        ("collision", (hit("static"),), "drove into something that stands in the street"),
        ("collision", (hit("car", "v:" + "x" * 250),), "drove into car " + "x" * 100),
        ("tilt", (hit("car", "v:c"),), "tilted too far"),
        ("drop", (), "fell off a kerb"),
    ],
)
def test_a_crash_in_words(reason, contacts, words):
    assert describe_crash(reason, contacts, RewardConfig()) == words
