"""Questions that a picture must answer: a program picks the moments and puts the marks, so nobody chooses easy ones.

How high is a kerb, how far is somebody, how fast is the chair, what is a ground, where is the chair in two seconds?
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import CameraConfig, RunConfig, WorldConfig
from wcsim.towns.scenario.town import Town
from wcsim.types import F64, I32, U8, ClassId, SeatSpec, StreetMesh
from wcsim.view.filming import SIGHT_M
from wcsim.view.street_pictures import Moment, SeenStreet, StreetPictures, moment_of

ASKED: Final = {
    "kerb": "Which kerb is higher, A or B? Answer A or B.",
    "distance": "How many metres is it from the wheelchair to the road user with the mark? Answer a number.",
    "speed": "How fast does the wheelchair drive, in m/s? Answer a number.",
    "surface": "On what lies the mark: pavement, road, crossing, open ground or grass? Answer one of them.",
    "place": "Which mark is nearest to where the wheelchair is in 2 s? Answer its letter.",
}
_SURFACES: Final = {
    ClassId.SIDEWALK: "pavement", ClassId.ROAD: "road", ClassId.CROSSWALK: "crossing", ClassId.GROUND: "open ground",
    ClassId.TERRAIN: "grass",
}  # fmt: skip
_SIZE_PX: Final = (800, 450)
_EVERY_TICKS, _BEFORE_TICKS, _DRIVE_TICKS = 20, 5, 600
_MOVES_MPS, _DRIVES = 0.3, 4  # drives for each item that is wanted of a question
_KERB_M, _HIGHER_M, _APART_PX = 9.0, 0.03, 60  # how near kerbs are, how much one is higher, how far apart they are seen
_SOMEBODY_M: Final = (3.0, 25.0)
_TURN_RAD: Final = math.radians(40.0)
_LETTERS: Final = "ABCDE"
_INK, _LIGHT = (0, 0, 0), (255, 255, 255)


@dataclass(frozen=True, slots=True, kw_only=True)
class SightItem:
    """A question, its pictures (H, W, 3), and the answer."""

    question: str  # of ASKED
    picture: U8
    before: U8 | None  # half a second earlier
    truth: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """A moment, as it is drawn."""

    moment: Moment
    scene: SeenStreet
    speed_mps: float

    def seen(self, point_W_m: F64) -> tuple[int, int] | None:
        """Where a point is seen; None where it is hidden, or too near the border for a mark."""
        return self._inside(self.scene.seen(point_W_m))

    def pixel(self, point_W_m: F64) -> tuple[int, int] | None:
        """The same, of a point that may be hidden."""
        return self._inside(self.scene.pixel(point_W_m))

    def _inside(self, found: tuple[int, int, float] | None) -> tuple[int, int] | None:
        if found is None:
            return None
        (u, v, _), camera = found, self.scene.camera
        return (u, v) if 30 <= u < camera.width_px - 30 and 30 <= v < camera.height_px - 30 else None


def items_of(town: Town, each: int, seed: int) -> Iterator[SightItem]:
    """So many items of each question, from drives of a user alone; as far as these have them."""
    lacking = dict.fromkeys(ASKED, each)
    for number in range(seed, seed + _DRIVES * each):
        rng = np.random.default_rng([seed, number])
        for item in _of_drive(town, number, rng, lacking):
            lacking[item.question] -= 1
            yield item
        if not any(lacking.values()):
            return


def _of_drive(town: Town, seed: int, rng: np.random.Generator, lacking: dict[str, int]) -> Iterator[SightItem]:
    """The items of one drive, at most one of a moment; the question that lacks most comes first."""
    config = RunConfig(cameras=(CameraConfig(width_px=16, height_px=12),), world=WorldConfig(mirror_radius_m=SIGHT_M))
    with World(town, config, (SeatSpec(profile="competent"),), seed) as world:
        pictures, kerbs = StreetPictures(world.street), _kerbs(world.street.mesh)
        before: U8 | None = None
        waiting: _Look | None = None
        for tick, step in zip(range(_DRIVE_TICKS), rollout(world), strict=False):
            (client,) = step.after.clients
            if client.first is not None:  # it begins anew, somewhere else
                waiting = before = None
            place = tick % _EVERY_TICKS
            if place == _EVERY_TICKS - _BEFORE_TICKS:
                before = _look(world, pictures).scene.picture
            if place or before is None or not any(lacking.values()):
                continue
            if waiting is not None:
                yield from _place_item(waiting, client.plant.p_WB_m, rng)
                waiting = None
                continue
            now, question = _look(world, pictures), _most_lacking(lacking, rng)
            if question == "place":
                waiting = now
                continue
            found = _ASKS[question](now, kerbs, rng)
            if found:
                yield SightItem(question=question, picture=now.scene.picture, before=before, truth=found)


def _most_lacking(lacking: dict[str, int], rng: np.random.Generator) -> str:
    """By chance, but in proportion to what lacks."""
    weights = np.array(list(lacking.values()), np.float64)
    return str(rng.choice(list(lacking), p=weights / weights.sum()))


def _look(world: World, pictures: StreetPictures) -> _Look:
    client, seat = world.snapshot.clients[0], world.seats[0]
    moment = moment_of(world, client, seat.route, seat.user.route_progress_m)
    scene = pictures.behind(replace(moment, route=None), *_SIZE_PX)  # the dots of its way are no part of the street
    return _Look(moment=moment, scene=scene, speed_mps=math.hypot(*client.plant.v_B_mps[:2].tolist()))


def _kerbs(mesh: StreetMesh) -> tuple[F64, F64]:
    """Places (K, 3) on the upper edges of kerbs, and how high each is (K,); see `kerb_walls` for the corners' order."""
    faces: I32 = mesh.faces[np.isin(mesh.face_class, (ClassId.KERB, ClassId.LOWERED_KERB))]
    foot, far, top = (mesh.vertices_W_m[faces[:, corner]].astype(np.float64) for corner in range(3))
    upper = np.abs(foot[:, :2] - top[:, :2]).max(axis=1) < 1e-4
    return (0.9 * top + 0.1 * far)[upper], (top - foot)[upper, 2]


def _kerb_item(now: _Look, kerbs: tuple[F64, F64], rng: np.random.Generator) -> str:
    (places_W_m, height_m), here_W_m = kerbs, now.moment.chair.p_WB_m
    near = np.flatnonzero(np.hypot(*(places_W_m - here_W_m)[:, :2].T) < _KERB_M)
    seen = [(int(k), at) for k in rng.permutation(near) if (at := now.seen(places_W_m[k])) is not None]
    for one, at in seen:
        for other, there in seen:
            if height_m[one] - height_m[other] >= _HIGHER_M and math.dist(at, there) >= _APART_PX:
                letters = "AB" if rng.random() < 0.5 else "BA"
                for letter, where in zip(letters, (at, there), strict=True):
                    _mark(now.scene.picture, where, letter)
                return letters[0]
    return ""


def _distance_item(now: _Look, kerbs: object, rng: np.random.Generator) -> str:
    here_W_m = now.moment.chair.p_WB_m
    for number in rng.permutation(len(now.moment.actors)):
        actor = now.moment.actors[number]
        far_m, tall_m = math.dist(actor.p_W_m[:2], here_W_m[:2]), actor.size_lwh_m[2]
        middle, above = (now.seen(actor.p_W_m + np.array([0.0, 0.0, z_m])) for z_m in (0.6 * tall_m, tall_m + 0.3))
        if actor.size_lwh_m[0] < 2.5 and _SOMEBODY_M[0] < far_m < _SOMEBODY_M[1] and middle and above:
            _mark(now.scene.picture, above, "")
            return f"{far_m:.2f}"
    return ""


def _speed_item(now: _Look, kerbs: object, rng: np.random.Generator) -> str:
    return f"{now.speed_mps:.2f}" if now.speed_mps > _MOVES_MPS else ""


def _surface_item(now: _Look, kerbs: object, rng: np.random.Generator) -> str:
    inside = now.scene.images.class_id[100:-20, 20:-20]
    kinds = [kind for kind in _SURFACES if np.count_nonzero(inside == kind) > 200]
    if not kinds:
        return ""
    kind = kinds[int(rng.integers(len(kinds)))]
    rows, columns = np.nonzero(inside == kind)
    chosen = int(rng.integers(len(rows)))
    _mark(now.scene.picture, (int(columns[chosen]) + 20, int(rows[chosen]) + 100), "")
    return _SURFACES[kind]


_ASKS: Final = {"kerb": _kerb_item, "distance": _distance_item, "speed": _speed_item, "surface": _surface_item}


def _place_item(was: _Look, p_WB_m: F64, rng: np.random.Generator) -> Iterator[SightItem]:
    """Where the chair came, and four of: on ahead, to both sides, not so far, farther, nowhere."""
    start, yaw_rad = was.moment.chair.p_WB_m, was.moment.yaw_rad
    far_m = max(math.dist(p_WB_m[:2], start[:2]), 1.5)
    turns = [(far_m, 0.0), (far_m, _TURN_RAD), (far_m, -_TURN_RAD), (1.7 * far_m + 0.8, 0.0), (0.0, 0.0)]
    turns = [(far * rng.uniform(0.8, 1.2), by + rng.normal(0.0, 0.15)) for far, by in turns]  # no layout tells
    others = [start + far * np.array([math.cos(yaw_rad + by), math.sin(yaw_rad + by), 0.0]) for far, by in turns]
    others.sort(key=lambda place: -math.dist(place[:2], p_WB_m[:2]))
    pixels = [was.pixel(place) for place in (p_WB_m, *others[:4])]  # without the one that is nearest to the truth
    order = rng.permutation(len(pixels)).tolist()
    if any(at is None for at in pixels):
        return
    for letter, number in zip(_LETTERS, order, strict=True):
        _mark(was.scene.picture, pixels[number] or (0, 0), letter)
    yield SightItem(question="place", picture=was.scene.picture, before=None, truth=_LETTERS[order.index(0)])


def _mark(picture: U8, at: Sequence[int], letter: str) -> None:
    """A small cross with a letter beside it."""
    u, v = at
    for ink, wide in ((_INK, 4), (_LIGHT, 2)):
        cv2.line(picture, (u - 6, v), (u + 6, v), ink, wide, cv2.LINE_AA)
        cv2.line(picture, (u, v - 6), (u, v + 6), ink, wide, cv2.LINE_AA)
        cv2.putText(picture, letter, (u + 8, v - 6), cv2.FONT_HERSHEY_DUPLEX, 0.6, ink, 2 * wide - 3, cv2.LINE_AA)
