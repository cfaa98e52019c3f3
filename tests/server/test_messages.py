from __future__ import annotations

import numpy as np
import pytest

from wcsim.errors import LinkClosedError, ProtocolError, TownError, WcsimError
from wcsim.server import messages as m
from wcsim.types import SeatSpec, StartSpec


@pytest.mark.parametrize(
    "request_",
    [
        m.Open(
            protocol=1,
            town="x",
            config_json="{}",
            seat=SeatSpec(start=StartSpec(p_W_m=(0.0, 1.0), yaw_rad=0.5, goal_W_m=(2.0, 3.0))),
            seed=3,
            run="/runs/a",
            hook="own:Hook",
        ),
        m.Join(),
        m.Act(tick=3, x=0.25, y=-1.0),
        m.Respawn(),
        m.Rebuild(seed=9),
        m.Leave(),
    ],
)
def test_requests_survive_the_wire(request_):
    assert m.decode_request(m.encode(request_)) == request_


@pytest.mark.parametrize("data", [b"", b"\x00", b"hello", m.encode(m.Bye()), b"\x82\xa4type\xa3Act\xa4tick\xa1x"])
def test_anything_else_is_a_protocol_error(data):
    with pytest.raises(ProtocolError):
        m.decode_request(data)


def test_an_error_arrives_under_its_own_name():
    with pytest.raises(TownError, match="no such town"):
        m.raise_failure(m.failure_of(TownError("no such town")))
    with pytest.raises(WcsimError):
        m.raise_failure(m.Failure(error="SystemExit", message="not one of ours"))
    with pytest.raises(LinkClosedError):
        m.raise_failure(m.Failure(error="LinkClosedError", message="x"))


def test_a_snapshot_survives_the_wire(corner):
    from tests.worlds import follow, open_world

    with open_world(corner, spec=SeatSpec(truth=True, max_steps=3)) as world:
        for _ in range(3):
            client = follow(world).clients[0]
        assert client.first is not None
        reply = m.decode_reply(m.encode(m.Frame(client)))
    assert isinstance(reply, m.Frame)
    assert reply.client == client
    assert reply.client.sensors.cameras[0].class_id.dtype == np.uint8
