"""A picture of a plant from the side and from above, with contacts, pivots and masses."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from wcsim.chair_check.static_balance import SupportFoot, make_static_chair
from wcsim.config import ChairConfig
from wcsim.core.frames import Vec3
from wcsim.physics.wheelchair.plant import FORK_M, PlantSpec, plant_spec
from wcsim.types import U8

Image = U8
Colour = tuple[int, int, int]

_PX_PER_M: Final = 420.0
_EDGE_PX: Final = 60
_TEXT_PX: Final = 150
_INK: Final[Colour] = (40, 40, 40)
_FRAME: Final[Colour] = (220, 220, 210)
_WHEEL: Final[Colour] = (200, 170, 130)
_CONTACT: Final[Colour] = (40, 40, 220)
_PIVOT: Final[Colour] = (200, 90, 30)
_COM: Final[Colour] = (30, 140, 30)


def write_plant_picture(plant: str, folder: Path) -> Path:
    """Draw `plant_NAME.png` into a folder, which is made if need be; returns the file.

    Raises:
        ConfigError: The plant is unknown or its file is wrong.
    """
    spec = plant_spec(ChairConfig(plant=plant))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"plant_{Path(plant).stem}.png"
    ok, data = cv2.imencode(".png", _plant_image(spec, Path(plant).stem))
    if not ok:
        raise OSError(f"{path}: the picture could not be encoded")
    path.write_bytes(data.tobytes())
    return path


def _plant_image(spec: PlantSpec, name: str) -> Image:
    """The picture, (H, W, 3) BGR: side view above, top view below."""
    side, above = _View(spec, 2, spec.outline.height_m), _View(spec, 1, spec.outline.width_m)
    for view in (side, above):
        for box in spec.frame.boxes:
            view.box(box.centre_m, box.size_m, _FRAME)
        for foot in make_static_chair(spec).feet:
            _draw_foot(view, foot)
        _draw_pivots(view, spec)
        _draw_com(view, spec)
    side.line((-9.0, 0.0, 0.0), (9.0, 0.0, 0.0), _INK)
    return np.vstack([side.image, above.image, _legend(spec, name, side.image.shape[1])])


class _View:
    """A canvas that shows x to the right and y (1) or z (2) upwards."""

    def __init__(self, spec: PlantSpec, up: int, height_m: float) -> None:
        outline = spec.outline
        self._up = up
        self._left_m = outline.middle_x_m - 0.5 * outline.length_m
        self._top_m = height_m if up == 2 else 0.5 * height_m
        size = (
            round(height_m * _PX_PER_M) + 2 * _EDGE_PX,
            round(outline.length_m * _PX_PER_M) + 2 * _EDGE_PX,
            3,
        )
        self.image: Image = np.full(size, 255, np.uint8)
        self.from_above = up == 1

    def at(self, p_m: Sequence[float]) -> tuple[int, int]:
        x = _EDGE_PX + _PX_PER_M * (p_m[0] - self._left_m)
        y = _EDGE_PX + _PX_PER_M * (self._top_m - p_m[self._up])
        return round(x), round(y)

    def line(self, a_m: Vec3, b_m: Vec3, colour: Colour) -> None:
        cv2.line(self.image, self.at(a_m), self.at(b_m), colour, 2, cv2.LINE_AA)

    def box(self, centre_m: Vec3, size_m: Vec3, fill: Colour) -> None:
        half_m = 0.5 * np.array(size_m)
        low, high = (self.at((centre_m + side * half_m).tolist()) for side in (-1.0, 1.0))
        cv2.rectangle(self.image, low, high, fill, -1)
        cv2.rectangle(self.image, low, high, _INK, 1)

    def disc(self, centre_m: Vec3, radius_m: float, fill: Colour) -> None:
        radius = round(radius_m * _PX_PER_M)
        cv2.circle(self.image, self.at(centre_m), radius, fill, -1, cv2.LINE_AA)
        cv2.circle(self.image, self.at(centre_m), radius, _INK, 1, cv2.LINE_AA)

    def mark(self, p_m: Vec3, colour: Colour, kind: int, size: int = 16) -> None:
        cv2.drawMarker(self.image, self.at(p_m), colour, kind, size, 2, cv2.LINE_AA)


def _draw_foot(view: _View, foot: SupportFoot) -> None:
    x, y, _ = foot.centre_m
    if foot.half_width_m == 0.0 or not view.from_above:
        view.disc(foot.centre_m, foot.radius_m, _WHEEL)
    else:
        view.box(
            foot.centre_m,
            (2.0 * foot.radius_m, 2.0 * foot.half_width_m, 2.0 * foot.radius_m),
            _WHEEL,
        )
    bottom_m = foot.centre_m[2] - foot.radius_m
    if bottom_m < 1e-6:
        view.line((x, y - foot.half_width_m, 0.0), (x, y + foot.half_width_m, 0.0), _CONTACT)
    view.mark((x, y, bottom_m), _CONTACT, cv2.MARKER_TRIANGLE_UP, 12)


def _draw_pivots(view: _View, spec: PlantSpec) -> None:
    for pair in spec.casters:
        for sign in (1.0, -1.0):
            y, hub_x = 0.5 * sign * pair.track_m, pair.swivel_x_m - pair.trail_m
            swivel_z = pair.radius_m + FORK_M
            view.line((pair.swivel_x_m, y, swivel_z), (hub_x, y, pair.radius_m), _PIVOT)
            view.mark((pair.swivel_x_m, y, swivel_z), _PIVOT, cv2.MARKER_CROSS)
            if pair.arm is not None:
                low, high = swivel_z - pair.arm.down_m, swivel_z + pair.arm.up_m
                view.line((pair.swivel_x_m, y, low), (pair.swivel_x_m, y, high), _PIVOT)
    for sign in (1.0, -1.0):
        view.mark(
            (0.0, 0.5 * sign * spec.wheel.track_m, spec.wheel.radius_m), _PIVOT, cv2.MARKER_CROSS
        )


def _draw_com(view: _View, spec: PlantSpec) -> None:
    com = (spec.mass.com_x_m, 0.0, spec.mass.com_z_m)
    view.mark(com, _COM, cv2.MARKER_TILTED_CROSS, 26)
    cv2.circle(view.image, view.at(com), 13, _COM, 2, cv2.LINE_AA)
    if not view.from_above:
        view.line(com, (com[0], 0.0, 0.0), _COM)


def _legend(spec: PlantSpec, name: str, width_px: int) -> Image:
    image: Image = np.full((_TEXT_PX, width_px, 3), 255, np.uint8)
    outline, mass = spec.outline, spec.mass
    lines = (
        f"{name}: {outline.length_m:.2f} x {outline.width_m:.2f} x {outline.height_m:.2f} m, "
        "front to the right",
        "red: contact points   blue: axles, swivels, arm travel",
        f"green: centre of mass, {mass.com_x_m:.2f} m ahead of the axle, {mass.com_z_m:.2f} m up",
        f"chair {mass.chair_kg:g} kg, user {mass.user_kg:g} kg",
    )
    for number, text in enumerate(lines):
        cv2.putText(
            image, text, (12, 30 + 32 * number), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK, 1, cv2.LINE_AA
        )
    return image
