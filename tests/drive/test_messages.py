import contextlib
import json

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.drive import messages as m
from wcsim.drive.driven import DriverKind
from wcsim.errors import ProtocolError
from wcsim.view.street_scene import CameraKind

GOOD = (
    m.Stick(x=0.5, y=-1.0, overrule=True),
    m.Help(),
    m.Shown(number=7),
    m.SetView(camera=CameraKind.DEPTH),
    m.Assist(on=True),
    m.SetLevel(level=0.3),
    m.ShapeStick(speed=0.6, sensitivity=0.5),
    m.DriveBy(who=DriverKind.SIMULATED),
    m.Pace(times=0.0),
    m.Pause(on=False),
    m.NewPlace(),
    m.Again(),
    m.SetUser(profile="slow"),
    m.Open(town="monaco", seed=3),
    m.GoOn(step=3),
    m.AnswerAll(step=4, answers=[0, -1, 10]),
    m.Seek(to=3),
    m.StepBy(ticks=-2),
    m.FollowSeat(seat=1),
    m.GoLive(),
    m.OpenEpisode(policy="dwa", block=0, seat=1),
    m.TakeOver(),
)


@pytest.mark.parametrize("message", GOOD, ids=lambda message: type(message).__name__)
def test_what_a_page_says_is_read_as_it_was_said(message: m.PageMessage) -> None:
    assert m.of_page(msgspec.json.encode(message)) == message


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{}",
        b"[]",
        b"null",
        b"\xff\xfe",
        b'{"say":"nothing"}',
        b'{"say":"stick"}',
        b'{"say":"stick","x":2,"y":0}',
        b'{"say":"stick","x":NaN,"y":0}',
        b'{"say":"stick","x":1e999,"y":0}',
        b'{"say":"stick","x":"0","y":0}',
        b'{"say":"stick","x":0,"y":0,"more":1}',
        b'{"say":"pace","times":-1}',
        b'{"say":"shown","number":-1}',
        b'{"say":"shown","number":2147483648}',
        b'{"say":"setuser","profile":"' + b"a" * 401 + b'"}',
        b'{"say":"open","seed":1.5}',
        b'{"say":"driveby","who":"me"}',
        b'{"say":"goon","step":-1}',
        b'{"say":"answerall","step":1,"answers":[11]}',
        b'{"say":"answerall","step":1,"answers":[' + b",".join([b"0"] * 21) + b"]}",
        b'{"say":"setview","camera":"colour"}',
        b'{"say":"gone"}',
        b'{"say":"ready"}',
        b'{"say":"end"}',  # of the server alone
        b"[" * 2000,
        b'{"say":"help"}' + b" " * 2048,
    ],
)
def test_what_is_no_message_is_refused_in_a_line(data: bytes) -> None:
    with pytest.raises(ProtocolError) as refused:
        m.of_page(data)
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 300


@given(
    st.binary(max_size=300)
    | st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=8),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(["say", "x", "y", "on", "level"]), inner, max_size=4)
        ),
        max_leaves=8,
    ).map(lambda data: json.dumps(data).encode())
)
def test_garbage_is_a_message_or_refused_and_nothing_else(data: bytes) -> None:
    with contextlib.suppress(ProtocolError):
        assert isinstance(m.of_page(data), m.PageMessage)
