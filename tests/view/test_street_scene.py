import math
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from wcsim.drive.session import DriveSession, Wish
from wcsim.drive.starting import DriveStart
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.models.catalog import Template, actor_templates
from wcsim.types import Joystick
from wcsim.view.pictures import class_colours, depth_colours
from wcsim.view.street_pictures import Moment, moment_of
from wcsim.view.street_scene import (
    MOST_ROWS,
    CameraKind,
    StreetFeed,
    _tile_to_buffer,
)

HEAD_BYTES, ROW_BYTES = 52, 22


@pytest.fixture
def session(corner: Path) -> Iterator[DriveSession]:
    with DriveSession(DriveStart(town=str(corner), policy="dwa", seed=4), ()) as drive:
        yield drive


def moment(session: DriveSession) -> Moment:
    return moment_of(session.world, session.client, session.route, session.done_m)


def feed_of(session: DriveSession) -> StreetFeed:
    return StreetFeed(session.world.street, session.world.config.cameras[0], 3)


def parts(message: bytes) -> dict[str, bytes]:
    found, at = {}, 4
    while at < len(message):
        letter, size = struct.unpack_from("<cI", message, at)
        found[letter.decode()] = message[at + 5 : at + 5 + size]
        at += 5 + size
    return found


def blocks(buffer: bytes) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    found, at = [], 0
    while at < len(buffer):
        vertices, faces, framed = struct.unpack_from("<3I", buffer, at)
        at += 12
        block = []
        for kind, count, wide in (("<f4", vertices, 3), ("<u4", faces, 3), ("<u4", faces, 1), ("<f4", framed, 4)):
            block.append(np.frombuffer(buffer, kind, count * wide, at).reshape(-1, wide))
            at += 4 * count * wide
        found.append(tuple(block))
    return found


def test_a_tile_has_the_triangles_and_colours_of_the_rasteriser(session: DriveSession) -> None:
    tiles = session.world.street.tiles
    mesh = tiles.mesh(tiles.keys[0])
    store = GeometryStore(mesh).arrays
    street, marks = blocks(_tile_to_buffer(mesh))
    vertices, faces, words, frames = street
    assert len(faces) == len(mesh.faces) and faces.max() < len(vertices)
    assert sorted((words[:, 0] & 0xFFFFFF).tolist()) == sorted(store.rgb.tolist())
    patterns = words[:, 0] >> 24
    assert np.isin(patterns[: len(frames)], (1, 2)).all() and not np.isin(patterns[len(frames) :], (1, 2)).any()
    area = np.linalg.norm(np.cross(*np.diff(vertices[faces], axis=1).swapaxes(0, 1)), axis=1).sum()
    plain = np.linalg.norm(np.cross(*np.diff(mesh.vertices_W_m[mesh.faces], axis=1).swapaxes(0, 1)), axis=1).sum()
    assert area == pytest.approx(plain, rel=1e-4)
    assert len(marks[1]) > 0, "lines and stones of kerbs"


def test_models_are_those_of_the_cameras(session: DriveSession) -> None:
    models, buffer = actor_templates(), next(feed_of(session).news(moment(session)))[1]
    assert isinstance(buffer, bytes)
    count, vertices, faces, paints = struct.unpack_from("<4I", buffer)
    assert (vertices, faces) == (len(models.vertices), len(models.faces))
    size = 16 + 8 * (count + 1) + 12 * vertices + 12 * faces + 48 * paints + faces
    assert len(buffer) == size


def test_files_come_before_lines_once_and_the_way_when_it_changes(session: DriveSession) -> None:
    feed = feed_of(session)
    news = list(feed.news(moment(session)))
    kinds = [isinstance(told, bytes) for _, told in news]
    assert kinds == sorted(kinds, reverse=True) and [name for name, _ in news][-2:] == ["street", "way"]
    (street,) = [told for name, told in news if name == "street"]
    assert isinstance(street, dict) and street["number"] == 3 and street["eye"]["hfov_deg"] > 60.0
    names = street["names"]
    assert len(names) == len(actor_templates().faces_of) - 1
    assert names[Template.CAR] == "car" and names[-1] == "pedestrian"
    assert set(street["tiles"]) | {street["models"]} == {name for name, told in news if isinstance(told, bytes)}
    assert list(feed.news(moment(session))) == []
    again = replace(moment(session), route=replace(session.route))
    assert list(feed.news(again)) == [], "a film reads its route anew in each frame"
    session.new_place()
    assert [name for name, _ in feed.news(moment(session))] == ["way"]


def test_a_moment_has_the_chair_and_who_is_near_in_few_bytes(session: DriveSession) -> None:
    for _ in range(12):
        session.tick(Wish(stick=Joystick(0.0, 1.0)))
    shown = parts(feed_of(session).picture(moment(session), CameraKind.NOTHING))
    assert set(shown) == {"P"}
    (x, y, z, yaw, _, _, speed, _, done, count, jumped) = struct.unpack_from("<3d6fHH", shown["P"])
    plant = session.client.plant
    assert np.allclose((x, y, z), plant.p_WB_m) and math.isclose(yaw, plant.yaw_rad, abs_tol=1e-6)
    assert math.isclose(speed, plant.v_B_mps[0], abs_tol=1e-6) and done == pytest.approx(session.done_m, abs=1e-3)
    assert 1 <= count <= MOST_ROWS and not jumped
    assert len(shown["P"]) == HEAD_BYTES + ROW_BYTES * count < 2000, "20 kB a second"
    places = [np.frombuffer(shown["P"], "<i2", 3, HEAD_BYTES + ROW_BYTES * row + 4) / 100.0 for row in range(count)]
    for actor in session.world.snapshot.actors:
        if np.hypot(*(actor.p_W_m - plant.p_WB_m)[:2]) < 100.0:
            assert min(np.abs(place - (actor.p_W_m - plant.p_WB_m)).max() for place in places) < 0.006


@pytest.mark.parametrize("kind", [CameraKind.CLASSES, CameraKind.DEPTH])
@pytest.mark.parametrize("knows", [True, False])
def test_classes_and_depth_are_what_the_policy_gets(session: DriveSession, kind: CameraKind, knows: bool) -> None:
    now = moment(session) if knows else replace(moment(session), frame=None)
    feed = feed_of(session)
    data = parts(feed.picture(now, kind))["C"]
    shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape == (60, 80, 3), "the policy's own pixels"
    frame = now.frame
    if knows and frame is not None:
        front = session.world.config.cameras[0]
        is_class = kind is CameraKind.CLASSES
        same = class_colours(frame.class_id) if is_class else depth_colours(frame.depth_m, front.range_m)
        assert (shown[..., ::-1] == same).all(), "nothing is lost on the way"
    if kind is CameraKind.CLASSES:
        classes = dict(feed.news(now))["street"]["classes"]
        assert classes["#804080"] == "road"
        named = {tuple(bytes.fromhex(colour[1:])) for colour in classes}
        assert {tuple(pixel) for pixel in shown[..., ::-1].reshape(-1, 3).tolist()} <= named
