"""The street as a browser draws it: tiles and models as buffers, and what moves in rows.

`page/street.js` reads them. All numbers are little-endian, in metres and radians of W.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from enum import StrEnum
from typing import Any, Final

import cv2
import numpy as np

from wcsim.config import CameraConfig
from wcsim.physics.buffers import Images, new_images
from wcsim.physics.renderer.cast import Cast
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import Instances, rotation_of
from wcsim.physics.renderer.kernels import STRIPES, WINDOWS
from wcsim.physics.renderer.models.catalog import Template, actor_templates
from wcsim.physics.renderer.raster import RasterRenderer
from wcsim.physics.sensors.camera_geometry import camera_matrix, mount, pinhole, pose_matrix
from wcsim.supervisor.palette import COLOURS
from wcsim.types import U8, Bool, CameraFrame, Route, Street, StreetMesh
from wcsim.types.street import Ground
from wcsim.view.pictures import class_colours, depth_colours
from wcsim.view.street_pictures import Moment

SIGHT_M: Final = 160.0  # tiles and actors as far away as this are told
MOST_ROWS: Final = 84
_OVER_M: Final = 0.06  # so high above the ground the route lies, or it would lie in it
_NO_SEAT: Final = -1
_HEAD: Final = struct.Struct("<I")
_PART: Final = struct.Struct("<cI")
_BLOCK: Final = struct.Struct("<3I")
_MODELS: Final = struct.Struct("<4I")
_SCENE: Final = struct.Struct("<3d6fHH")
_ROW: Final = np.dtype(
    [
        ("id", "<u4"),
        ("place_cm", "<i2", 3),  # from the chair
        ("size_cm", "<u2", 3),
        ("yaw", "<i2"),  # in 1e-4
        ("pitch", "i1"),  # in 1e-2
        ("roll", "i1"),
        ("template", "u1"),
        ("lamps", "u1"),
    ]
)


class CameraKind(StrEnum):
    """What the chair's own camera shows."""

    CLASSES = "classes"
    DEPTH = "depth"
    NOTHING = "nothing"


class StreetFeed:
    """Tells a page of one street: its files, what the page must know of it, and its moments.

    Args:
        street: Another street needs another object, with another number.
        front: The camera of the chairs. None if it is not known; then no camera is shown.
        number: Of the street.
    """

    def __init__(self, street: Street, front: CameraConfig | None, number: int) -> None:
        self._street, self._front, self._number = street, front, number
        self._cast = Cast(street.signal_heads)
        self._renderer: RasterRenderer | None = None
        self._from_m: list[float] | None = None
        self._tiles: list[str] = []
        self._route: Route | None = None
        self._shown = 0

    def news(self, moment: Moment) -> Iterator[tuple[str, bytes | dict[str, Any]]]:
        """What a page needs to draw this moment: files by name, then lines by what they say.

        The first moment has all tiles around it, a later one at most one more.
        """
        # 1. The models, once; and where the page's own origin lies.
        p_W_m, tiles = moment.chair.p_WB_m, self._street.tiles
        first = self._from_m is None
        if self._from_m is None:
            self._from_m = [float(round(part)) for part in p_W_m]
            models = actor_templates()
            count = len(models.faces_of) - 1
            head = _MODELS.pack(count, len(models.vertices), len(models.faces), len(models.paints))
            parts = (
                models.vertices_of.astype("<u4"),
                models.faces_of.astype("<u4"),
                models.vertices.astype("<f4"),
                models.faces.astype("<u4"),
                models.paints.round().astype("u1"),  # (paints, 16, 3)
                models.face_paint.astype("u1"),
            )
            yield f"models-{self._number}", head + b"".join(part.tobytes() for part in parts)

        # 2. The tiles that have come near, without those that are near no more.
        names = {
            f"{self._number}_{key[0]}_{key[1]}": key for key in tiles.near(p_W_m[None], SIGHT_M)
        }
        fresh = [name for name in names if name not in self._tiles][: None if first else 1]
        for name in fresh:
            yield name, _tile_to_buffer(tiles.mesh(names[name]))
        before = self._tiles
        self._tiles = [name for name in (*before, *fresh) if name in names]
        if self._tiles != before:
            yield "street", self._about()

        # 3. The way, if it is another one.
        if first or moment.route != self._route:
            self._route = moment.route
            no_way: list[list[float]] = []
            points = no_way if moment.route is None else _lifted(moment.route, self._street.grid)
            yield "way", {"points": points}

    def _about(self) -> dict[str, Any]:
        front = self._front
        eye = front and {
            "p_m": list(front.p_BC_m),
            "yaw_rad": math.radians(front.yaw_deg),
            "pitch_rad": math.radians(front.pitch_deg),
            "hfov_deg": front.hfov_deg,
        }
        # What each model is, for a label; a pedestrian's postures have one name.
        names = [template.name.split("_")[0].lower() for template in Template]
        names += ["pedestrian"] * (len(actor_templates().faces_of) - 1 - len(names))
        return {
            "number": self._number,
            "from": self._from_m,
            "models": f"models-{self._number}",
            "names": names,
            "classes": {
                f"#{red:02x}{green:02x}{blue:02x}": each.name.replace("_", " ").lower()
                for each, (red, green, blue) in COLOURS.items()
            },
            "eye": eye,
            "tiles": self._tiles,
        }

    def picture(self, moment: Moment, camera: CameraKind) -> bytes:
        """A moment in one message: its number, then each part's letter, length and bytes."""
        eye_W_m = moment.chair.p_WB_m[None]
        rows, shown = self._cast.seen(
            moment.actors, moment.chairs, moment.signals, (_NO_SEAT,), eye_W_m, SIGHT_M
        )
        chair = moment.chair
        # 1. The nearest rows.
        away_m = rows.p_W_m - chair.p_WB_m
        gap_m = np.hypot(away_m[:, 0], away_m[:, 1])
        near = np.argsort(gap_m, kind="stable")[:MOST_ROWS]
        near = near[gap_m[near] < SIGHT_M]

        # 2. In as few bytes as a picture needs.
        told = np.zeros(len(near), _ROW)
        told["id"] = rows.colour_seed[near]
        told["place_cm"] = np.rint(100.0 * away_m[near])
        told["size_cm"] = np.rint(100.0 * rows.scale_m[near])
        told["yaw"] = np.rint(1e4 * (np.mod(rows.yaw_rad[near] + np.pi, 2.0 * np.pi) - np.pi))
        told["pitch"] = np.rint(100.0 * rows.pitch_rad[near]).clip(-127, 127)
        told["roll"] = np.rint(100.0 * rows.roll_rad[near]).clip(-127, 127)
        told["template"] = rows.template[near]
        told["lamps"] = rows.lamps[near] & 0xFF

        # 3. The chair.
        R_WB = rotation_of(chair.q_WB)
        turns = (
            math.atan2(R_WB[1, 0], R_WB[0, 0]),
            math.asin(min(1.0, max(-1.0, R_WB[2, 0]))),
            math.atan2(R_WB[2, 1], R_WB[2, 2]),
        )
        motion = moment.motion or (0.0, 0.0)
        head = _SCENE.pack(
            *chair.p_WB_m.tolist(), *turns, *motion, moment.done_m, len(told), moment.jumped
        )
        parts = [(b"P", head + told.tobytes())]
        if camera is not CameraKind.NOTHING and self._front is not None:
            picture = self._seen(moment, camera, self._front, rows, shown[0])
            _, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
            parts.append((b"C", data.tobytes()))
        self._shown += 1
        return _HEAD.pack(self._shown) + b"".join(
            _PART.pack(letter, len(data)) + data for letter, data in parts
        )

    def _seen(
        self, moment: Moment, kind: CameraKind, front: CameraConfig, rows: Instances, shown: Bool
    ) -> U8:
        """What the front camera gives to the policy; without errors if its frame is not known."""
        frame: CameraFrame | Images | None = moment.frame
        if frame is None:
            self._renderer = self._renderer or RasterRenderer(GeometryStore(self._street.mesh))
            # The chair's own camera does not see the chair.
            shown[len(moment.actors) + moment.column] = False
            lens = pinhole(front)
            images = new_images(lens.width_px, lens.height_px, rgb=False)
            T_CW = camera_matrix(pose_matrix(moment.chair.p_WB_m, moment.chair.q_WB), mount(front))
            self._renderer.render(lens, T_CW, rows, images, shown)
            frame = images
        if kind is CameraKind.CLASSES:
            return class_colours(frame.class_id)
        return depth_colours(frame.depth_m, front.range_m)


def _lifted(route: Route, ground: Ground) -> list[list[float]]:
    """A route's points (K, 3) a little above the ground, at most a metre from each other."""
    arcs_m = np.union1d(np.arange(0.0, float(route.arc_m[-1])), route.arc_m)
    xy = np.column_stack(
        [np.interp(arcs_m, route.arc_m, route.points_W_m[:, axis]) for axis in (0, 1)]
    )
    z = np.asarray(ground.height_at(xy), np.float64) + _OVER_M
    places: list[list[float]] = np.column_stack([xy, z]).round(2).tolist()
    return places


def _tile_to_buffer(mesh: StreetMesh) -> bytes:
    """The triangles of a tile, then those of its marks, each painted as in `GeometryStore`."""
    store = GeometryStore(mesh)
    marks = b"" if store.marks is None else _block(store.marks)
    return _block(store) + (marks or _BLOCK.pack(0, 0, 0))


def _block(store: GeometryStore) -> bytes:
    """Counts of vertices, faces and framed faces; then these arrays, framed faces first."""
    street = store.arrays
    framed = np.isin(street.pattern, (STRIPES, WINDOWS))
    order = np.argsort(~framed, kind="stable")
    words = street.rgb | street.pattern.astype(np.uint32) << 24
    count = int(framed.sum())
    parts = (
        street.vertices.astype("<f4"),
        store.global_faces()[order].astype("<u4"),
        words[order].astype("<u4"),
        street.frame[order[:count]].astype("<f4"),
    )
    head = _BLOCK.pack(len(street.vertices), len(order), count)
    return head + b"".join(part.tobytes() for part in parts)
