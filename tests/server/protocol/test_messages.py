from dataclasses import replace

import numpy as np
import pytest

from tests.support.typed import python_says
from wcsim.errors import LinkClosedError, OverloadedError, ProtocolError, TownError, WcsimError
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.messages import _unpack
from wcsim.types import F32, F64, U8, Contact, Drawn, Reading, SeatSpec, StartSpec

SESSION = bytes(range(16))
REQUESTS = [
    m.Join(
        protocol=m.PROTOCOL,
        schema="s",
        config="c",
        session=SESSION,
        claim=b"mine",
        seat=m.ANY_SEAT,
        name="a-client",
        spec=SeatSpec(truth_visible=True, start=StartSpec(p_W_m=(0.0, 1.0), yaw_rad=0.5, goal_W_m=(2.0, 3.0))),
        pid=7,
    ),
    m.Act(SESSION, 0, 3, 0, 0.25, -1.0),
    m.Respawn(SESSION, 0, 3, 0),
    m.Rebuild(SESSION, 0, 9),
    m.Beat(SESSION, 5),
    m.Leave(SESSION),
]
REPLIES = [
    m.Welcome(SESSION, 0, 3, 1, 0, "/ring/seat-1", "{}", "monaco"),
    m.TickDone(0, 3, 1, 0.01),
    m.Frame(0, 3, 0, None),
    m.Restarted(1, "why"),
    m.Waiting(0, 3, ("a", "b")),
    m.Failure("TownError", "no", SESSION),
    m.Bye(SESSION, "done"),
]


def received(client):
    """What comes of a frame on its way."""
    return m.decode_reply(m.encode_message(m.Frame(0, 3, 0, client)))


@pytest.mark.parametrize("request_", REQUESTS, ids=lambda r: type(r).__name__)
def test_requests_survive_the_wire(request_):
    assert m.decode_request(m.encode_message(request_)) == request_


@pytest.mark.parametrize("reply", REPLIES, ids=lambda r: type(r).__name__)
def test_replies_survive_the_wire(reply):
    assert m.decode_reply(m.encode_message(reply)) == reply


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x00",
        b"hello",
        m.encode_message(m.Leave(b"")),
        b"\x92\xa3Act\x01",
        m.encode_message(REQUESTS[1]) + b"\x00",
    ],
)
def test_anything_else_is_a_protocol_error(data):
    with pytest.raises(ProtocolError):
        m.decode_request(data)


def test_a_message_beyond_the_limit_is_not_even_read():
    with pytest.raises(OverloadedError, match=str(m.MAX_REQUEST_BYTES + 1)):
        m.decode_request(bytes(m.MAX_REQUEST_BYTES + 1))


def test_an_error_arrives_under_its_own_name():
    arrived = m.error_from_failure(m.failure_from_error(TownError("no such town")))
    assert type(arrived) is TownError
    assert str(arrived) == "no such town"
    assert type(m.error_from_failure(m.Failure(error="SystemExit", message="not one of ours"))) is WcsimError
    assert type(m.error_from_failure(m.Failure(error="LinkClosedError", message="x"))) is LinkClosedError


def test_two_programs_of_one_version_have_one_schema():
    code = "from wcsim.server.protocol import messages; print(messages.hash_message_schema())"
    assert python_says(code) == m.hash_message_schema()


@pytest.fixture(scope="module")
def ended(corner):
    """A frame with everything: the last of an episode, with the truth, contacts and the next one's first frame."""
    from tests.support.worlds import follow, open_world

    with open_world(corner, "cameras.0.rgb=true", spec=SeatSpec(truth_visible=True, max_steps=3)) as world:
        for _ in range(3):
            client = follow(world).clients[0]
    drawn = Drawn(light=0.5, camera_shift_m=((0.0, 1.0, 2.0),), action_delay_ticks=2, plant=(("a.b", 1.5),))
    drawn = replace(
        drawn, attention=(("all", 0.5), ("car", 0.25)), reaction_s=(("bus", 1.5),), sensors=(("wheels.noise", 0.5),)
    )
    touch = Contact(kind="car", part="body", impulse_Ns=3.5, cause="other", actor_id="x")
    assert client.first is not None
    return replace(client, drawn=drawn, contacts=(touch,))


def test_a_snapshot_survives_the_wire(ended):
    reply = received(ended)
    assert isinstance(reply, m.Frame)
    assert reply.client == ended
    camera = reply.client.sensors.cameras[0]
    assert (camera.class_id.dtype, camera.depth_m.dtype, camera.rgb.shape) == (np.uint8, np.float32, (24, 32, 3))
    assert reply.client.truth.safe_actions.dtype == np.bool_
    assert reply.client.truth.visible.safe_actions.shape == (81,)


@pytest.mark.parametrize("spoilt", [np.full(3, -1.0), np.full(3, np.nan), np.zeros(1025)])
def test_a_visible_truth_beyond_its_bounds_is_refused(ended, spoilt):
    visible = replace(ended.truth.visible, first_s=spoilt)
    with pytest.raises(ProtocolError):
        received(replace(ended, truth=replace(ended.truth, visible=visible)))


EVENTS = ("arrived", "gave_up", "on_carriageway", "crossed", "entered_red", "help_asked")


@pytest.mark.parametrize("flag", EVENTS)
def test_every_event_arrives_as_itself(ended, flag):
    client = replace(ended, events=replace(ended.events, **{name: name == flag for name in EVENTS}))
    assert received(client).client.events == client.events


def test_numbers_arrive_to_the_bit(ended):
    odd = np.array([1 / 3, -0.0, 5e-324])
    client = replace(ended, plant=replace(ended.plant, p_WB_m=odd))
    reply = received(client)
    assert reply.client.plant.p_WB_m.tobytes() == odd.tobytes()


def test_pictures_in_shared_memory_do_not_travel(ended):
    inside, outside = m.encode_message(m.Frame(0, 3, 0, ended, -1)), m.encode_message(m.Frame(0, 3, 0, ended, 1))
    assert len(inside) - len(outside) > 24 * 32 * 8
    reply = m.decode_reply(outside)
    assert reply.slot == 1
    assert reply.client.sensors.cameras[0].depth_m.size == 0
    assert reply.client.plant == ended.plant


def test_frames_whose_parts_do_not_fit_are_refused(ended):
    plant, sensors = ended.plant, ended.sensors
    camera = sensors.cameras[0]
    pictures = [
        replace(camera, depth_m=camera.depth_m[:-1]),
        replace(camera, rgb=camera.rgb[..., 0]),
        replace(camera, depth_m=np.zeros((1, 2049), np.float32), class_id=np.zeros((1, 2049), np.uint8)),
    ]
    spoilt = [replace(ended, sensors=replace(sensors, cameras=(picture,))) for picture in pictures]
    spoilt += [replace(ended, plant=replace(plant, p_WB_m=array)) for array in (np.zeros(2), np.full(3, np.nan))]
    spoilt.append(replace(ended, first=replace(ended.first, plant=replace(plant, q_WB=np.zeros(3)))))
    for client in spoilt:
        with pytest.raises(ProtocolError):
            received(client)


@pytest.mark.parametrize("kind, told", [(F64, b"abc"), (F64, "a"), (F32, ((2, 3), b"abcd")), (F32, 1), (U8, {})])
def test_what_is_no_array_is_refused(kind, told):
    with pytest.raises((TypeError, ValueError)):
        _unpack(kind, told)


def test_readings_travel_with_the_frame(ended):
    said = (Reading(name="beams", values=np.arange(3.0)), Reading(name="wheels", values=np.array([-0.5, 2.0])))
    told = replace(ended, sensors=replace(ended.sensors, readings=said), first=None)
    assert received(told).client.sensors.readings == said


@pytest.mark.parametrize(
    "name, values",
    [("a b", np.zeros(1)), ("a", np.array([np.inf])), ("a", np.zeros(8193)), ("a", np.zeros((1, 1)))],
)
def test_what_is_no_reading_is_refused(ended, name, values):
    reading = Reading(name=name, values=values)
    told = replace(ended, sensors=replace(ended.sensors, readings=(reading,)), first=None)
    with pytest.raises(ProtocolError):
        received(told)
