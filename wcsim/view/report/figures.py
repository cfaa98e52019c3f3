"""Figures as SVG, the same bytes each time, fit for a paper; of a test with numbers as CSV.

It is the one module that draws with matplotlib.
"""

import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from textwrap import fill
from typing import Any, Final, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.evaluation.suite.result_files import TOWNS, TestResult
from wcsim.core.reading import pluralize
from wcsim.errors import WcsimError
from wcsim.towns.scenario.town import find_town
from wcsim.towns.scene_folders.families import FAMILIES
from wcsim.towns.street import load_street
from wcsim.types import F64, U8, ClassId
from wcsim.view.report.pages import Cell, Exhibit

_WIDTH_IN, _HEIGHT_IN = 4.8, 3.4
_LABEL_CHARACTERS: Final = 34  # below each other along that height
_LEGEND_CHARACTERS: Final = 74  # beside each other in that width
_COLOURS: Final = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#6a3d9a", "#e69f00", "#56b4e9", "#8c510a"),
    *("#444444", "#b2182b", "#35978f", "#7fbc41"),
)  # told apart without red and green, as far as that goes
_MARKS: Final = "osD^vPX<>hp*"
_STYLE: Final[Mapping[Any, Any]] = {
    "font.family": ["DejaVu Sans"],
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.fonttype": "path",
    "text.parse_math": False,
}
_MARGIN_M: Final = 25.0
_MOST_CELLS: Final = 700
_ROWS_AT_ONCE: Final = 64
_GROUND_RGB: Final = {
    ClassId.ROAD: (214, 216, 220),
    ClassId.PARKING: (222, 222, 224),
    ClassId.CROSSWALK: (190, 194, 206),
    ClassId.SIDEWALK: (243, 239, 228),
    ClassId.KERB: (180, 180, 180),
    ClassId.LOWERED_KERB: (205, 190, 150),
    ClassId.RAIL_TRACK: (224, 214, 208),
    ClassId.TERRAIN: (232, 240, 226),
    ClassId.VEGETATION: (220, 234, 212),
    ClassId.GROUND: (238, 236, 232),
}
_SOLID_RGB: Final = (196, 190, 188)  # houses, walls, trunks
_OTHER_RGB: Final = (248, 248, 248)
_NAME: Final = re.compile(r"[\w-]+")
_LEVEL: Final = re.compile(r"(.+)@([0-9]+(?:\.[0-9]+)?)")
_Ground = tuple[
    U8, tuple[float, float, float, float]
]  # (H, W, 3) from above; west, east, south and north edge


class Curve(NamedTuple):
    """A value over steps, raw and as a running mean."""

    name: str
    steps: Sequence[int]
    values: Sequence[float]
    means: Sequence[float]
    switch: int | None = None  # step at which its first phase ended
    crossing: int | None = None  # step at which its means came below the limit


def _colour_of(place: int) -> str:
    """The colour of the policy at a place of the result, the same in all figures."""
    return _COLOURS[place % len(_COLOURS)]


@contextmanager
def _drawn(name: str, out: io.BytesIO, height_in: float = _HEIGHT_IN) -> Iterator[Axes]:
    """Axes of a figure with one panel, written to `out` at the end; `name` makes names in it."""
    with mpl.rc_context({**_STYLE, "svg.hashsalt": name}):
        figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
        yield figure.add_subplot()
        figure.savefig(
            out,
            format="svg",
            metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
        )


def _ground_around(town: str, points_m: Sequence[tuple[float, float]]) -> _Ground | None:
    """The ground of a town around some points; None where there is no such town, or no point."""
    if not points_m:
        return None
    try:
        street = load_street(find_town(town))
    except WcsimError:
        return None
    (west, south), (east, north) = (
        np.min(points_m, axis=0) - _MARGIN_M,
        np.max(points_m, axis=0) + _MARGIN_M,
    )
    cell = max(east - west, north - south) / _MOST_CELLS
    columns, rows = max(1, round((east - west) / cell)), max(1, round((north - south) / cell))
    at_x = west + (np.arange(columns) + 0.5) * (east - west) / columns
    at_y = north - (np.arange(rows) + 0.5) * (north - south) / rows
    table = np.full((256, 3), _OTHER_RGB, np.uint8)
    table[list(_GROUND_RGB)] = list(_GROUND_RGB.values())
    strips = []
    for first in range(
        0, rows, _ROWS_AT_ONCE
    ):  # of few points each: the street asks all its tiles about every point
        points = np.stack(np.meshgrid(at_x, at_y[first : first + _ROWS_AT_ONCE]), axis=-1)
        is_free = street.grid.clearance_at(points)[..., None] > 0.0
        strips.append(
            np.where(is_free, table[street.grid.class_at(points)], _SOLID_RGB).astype(np.uint8)
        )
    return np.vstack(strips), (float(west), float(east), float(south), float(north))


def figures_of(result: TestResult, folder: Path) -> list[Exhibit]:
    """All figures of a test, which lies in this folder, in the order of the page."""
    places = {name: place for place, name in enumerate(result.episodes)}
    return [
        *(
            [_help_figure(result, places)]
            if any(row.judged_episodes for row in result.pooled)
            else []
        ),
        *_towns(result, places, folder / TOWNS),
    ]


def _help_figure(result: TestResult, places: Mapping[str, int]) -> Exhibit:
    """Share of drives with a crash over unneeded interventions a drive: value, low, high."""
    known: dict[str, F64] = {}
    for row in result.pooled:
        if row.judged_episodes:
            unknown = (np.nan, np.nan)  # of few episodes: a point without a bar
            needless = np.array((row.unneeded, *(row.unneeded_ci or unknown))) / row.judged_episodes
            crashed = (row.crashes_any / row.episodes, *(row.crashes_any_ci or unknown))
            known[row.policy] = np.array((needless, crashed))
    out = io.BytesIO()
    with _drawn("help", out, 4.0) as axes:
        for line in _levels_of(known):
            axes.plot(
                *np.stack([known[name][:, 0] for name in line], 1),
                color="#888888",
                linewidth=1.0,
                zorder=1,
            )
        for name, (x, y) in known.items():
            axes.errorbar(
                x[:1],
                y[:1],
                xerr=np.abs(x[1:, None] - x[0]),
                yerr=np.abs(y[1:, None] - y[0]),
                markersize=5,
                elinewidth=0.8,
                capsize=2,
                label=_short(name),
                fmt=_MARKS[places[name] % len(_MARKS)],
                color=_colour_of(places[name]),
            )
        axes.set_xlabel("unneeded interventions a drive")
        axes.set_ylabel("drives with a crash, share")
        _legend(axes, len(known))
    ends = ("", "_low", "_high")
    return Exhibit(
        name="help",
        columns=("policy", *(f"{what}{end}" for what in ("unneeded", "crashes") for end in ends)),
        rows=[
            [name, *(None if np.isnan(v) else round(v, 6) for v in both.flat)]
            for name, both in known.items()
        ],
        svg=out.getvalue(),
    )


def _levels_of(names: Iterable[str]) -> list[list[str]]:
    """Policies NAME@LEVEL of one NAME, sorted by level; a NAME with one level alone is left out.

    >>> _levels_of(["a@0.5", "b", "a@0.25"])
    [['a@0.25', 'a@0.5']]
    """
    found: dict[str, list[tuple[float, str]]] = {}
    for name in names:
        match = _LEVEL.fullmatch(name)
        if match is not None:
            found.setdefault(match[1], []).append((float(match[2]), name))
    return [[name for _, name in sorted(levels)] for levels in found.values() if len(levels) > 1]


def _towns(result: TestResult, places: dict[str, int], made: Path) -> list[Exhibit]:
    """A map for each town, some in `made`; generated scenes have own coordinates, and no map."""
    here: dict[str, list[tuple[str, EpisodeRecord]]] = {}
    for name, episodes in result.episodes.items():
        for e in episodes:
            if e.town not in FAMILIES and e.steps:
                here.setdefault(e.town, []).append((name, e))
    return [_town(town, driven, places, made) for town, driven in here.items()]


def _way_rows(name: str, e: EpisodeRecord) -> list[list[Cell]]:
    """Where a chair was each second, and where its episode ended: rows of the map's CSV."""
    who: list[Cell] = [name, e.block, e.seat]
    way: list[list[Cell]] = [
        [*who, "way", min(float(second), e.time_s), round(x, 1), round(y, 1)]
        for second, (x, y) in enumerate(e.path_m, 1)
    ]
    return [*way, [*who, "crash" if e.own else "end", e.time_s, *e.end_m]]


def _town(
    town: str, here: Sequence[tuple[str, EpisodeRecord]], places: Mapping[str, int], made: Path
) -> Exhibit:
    points = [point for _, e in here for point in (*e.path_m, *([e.end_m] if e.own else []))]
    own = made / town
    ground = _ground_around(str(own) if _NAME.fullmatch(town) and own.is_dir() else town, points)
    missing = (
        ""
        if ground is not None or not points
        else " The ground is not drawn: this town is not on this machine."
    )
    out = io.BytesIO()
    image, (west, east, south, north) = ground or (None, (0.0, 1.0, 0.0, 1.0))
    with _drawn(
        f"town-{town}", out, 0.9 + 4.1 * min(2.0, max(0.3, (north - south) / (east - west)))
    ) as axes:
        if image is not None:
            axes.imshow(image, extent=(west, east, south, north), interpolation="nearest")
        axes.grid(visible=False)
        _draw_ways(axes, here, places)
    return Exhibit(
        name=f"town-{town}",
        title=f"Paths in {town}",
        says="Paths of all episodes in this town, one colour per policy; crosses are own crashes. "
        f"Generated scenes have their own streets and are not shown.{missing}",
        columns=("policy", "block", "seat", "what", "s", "x_m", "y_m"),
        rows=[row for name, e in here for row in _way_rows(name, e)],
        svg=out.getvalue(),
    )


def _draw_ways(
    axes: Axes, here: Sequence[tuple[str, EpisodeRecord]], places: Mapping[str, int]
) -> None:
    """Ways and crashes of all policies."""
    policies = dict.fromkeys(name for name, _ in here)
    for name in policies:
        driven, colour = [e for whose, e in here if whose == name], _colour_of(places[name])
        for e in driven:
            if len(e.path_m) > 1:
                axes.plot(*np.transpose(e.path_m), color=colour, linewidth=0.7, alpha=0.75)
        ends = np.reshape([e.end_m for e in driven if e.own], (-1, 2))
        label = f"{_short(name)}: {pluralize(len(ends), 'own crash')}"
        axes.scatter(
            ends[:, 0], ends[:, 1], marker="x", s=22, linewidths=1.3, color=colour, label=label
        )
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    _legend(axes, len(policies))


def curve_chart(
    name: str, label: str, curves: Sequence[Curve], line: tuple[float, str] | None = None
) -> bytes:
    """Curves over training steps, with a named line across; positive values begin at zero."""
    out = io.BytesIO()
    with _drawn(name, out) as axes:
        if line is not None:
            axes.axhline(line[0], color="#222222", linewidth=0.9, linestyle=":", label=line[1])
        for place, curve in enumerate(curves):
            colour = _colour_of(place)
            axes.plot(
                curve.steps,
                curve.values,
                ".",
                color=colour,
                markersize=4,
                markeredgewidth=0,
                alpha=0.45,
            )
            axes.plot(
                curve.steps, curve.means, color=colour, linewidth=1.3, label=_short(curve.name)
            )
            if (
                curve.switch is not None
            ):  # several at one step: their dashes stand beside each other
                dashes = (3.0 * place, (3.0, 3.0 * max(1, len(curves) - 1)))
                axes.axvline(curve.switch, color=colour, linewidth=0.9, linestyle=dashes)
            if curve.crossing is not None and line is not None:
                axes.plot(
                    [curve.crossing],
                    [line[0]],
                    "v",
                    color=colour,
                    markersize=7,
                    markeredgecolor="#222222",
                )
        if all(value >= 0.0 for curve in curves for value in curve.values):
            axes.set_ylim(bottom=0.0)
        axes.set_xlim(left=0.0)
        axes.locator_params(axis="x", nbins=6)  # of six digits no more stand beside each other
        axes.set_xlabel("steps of training")
        axes.set_ylabel(fill(label, _LABEL_CHARACTERS))
        _legend(axes, len(curves) + (line is not None))
    return out.getvalue()


def motion_chart(
    path: Path, form: str, title: str, step_s: float, measured: F64, made: Mapping[str, F64]
) -> None:
    """Write a picture of speed and turn rate (n, 2) over time, measured and by models.

    Args:
        path: The file.
        form: `png` or `svg`.
        title: Above it.
        step_s: From one sample to the next.
        measured: In m/s and rad/s.
        made: The same by the name of each model.
    """
    with mpl.rc_context({**_STYLE, "svg.hashsalt": title}):
        figure = Figure(figsize=(2.0 * _WIDTH_IN, 1.5 * _HEIGHT_IN), layout="constrained")
        panels = figure.subplots(2, 1, sharex=True)
        for axis, (panel, label) in enumerate(
            zip(panels, ("speed, m/s", "turn rate, rad/s"), strict=True)
        ):
            for place, (name, motion) in enumerate({"measured": measured, **made}.items()):
                at_s = step_s * np.arange(len(motion))
                panel.plot(
                    at_s, motion[:, axis], color=_colour_of(place), linewidth=1.2, label=name
                )
            panel.set_ylabel(label)
        panels[0].set_title(title, fontsize=9, loc="left")
        panels[0].legend(loc="upper right", ncols=3)
        panels[1].set_xlabel("time, s")
        figure.savefig(
            path, format=form, dpi=120, metadata={"Date": None} if form == "svg" else None
        )


def _legend(axes: Axes, entries: int) -> None:
    """Below the axes: it never hides a point."""
    labels = axes.get_legend_handles_labels()[1]
    if entries and labels:
        longest = max(map(len, labels))
        columns = max(1, min(3, entries, _LEGEND_CHARACTERS // (longest + 6)))
        axes.figure.legend(loc="outside lower center", ncols=columns)


def _short(name: str, most: int = 28) -> str:
    """A name that fits, a path's end; Matplotlib leaves names out that begin with "_"."""
    name = f" {name}" if name.startswith("_") else name
    return name if len(name) <= most else f"…{name[-(most - 1) :]}"
