"""Figures as SVG, the same bytes each time and fit for a paper; those of a test with their numbers as CSV.

It is the one module that draws with matplotlib.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wcsim.agents.evaluation.suite.list_file import TIGHT
from wcsim.agents.evaluation.suite.records import (
    CRASHED,
    FINISHED,
    GAVE_UP,
    POLICY_FAILED,
    REFUSED,
    STATUSES,
    TIMED_OUT,
    EpisodeRecord,
)
from wcsim.agents.evaluation.suite.result_files import TOWNS, TestResult
from wcsim.agents.evaluation.suite.rows import ResultRow
from wcsim.core.reading import counted
from wcsim.errors import WcsimError
from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street
from wcsim.types import U8, ClassId, Ground
from wcsim.view.report.pages import Cell, Exhibit

_WIDTH_IN, _HEIGHT_IN = 4.8, 3.4
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
_OBEYS: Final = 0.5  # who does as asked more rarely would squeeze all others into a corner of the figure
_ENDINGS: Final = {
    FINISHED: "arrived",
    CRASHED: "crashed",
    GAVE_UP: "user gave up",
    TIMED_OUT: "time up",
    POLICY_FAILED: "policy failed",
    REFUSED: "policy refused",
}
_NAME: Final = re.compile(r"[\w-]+")
_LEVEL: Final = re.compile(r"(.+)@([0-9]+(?:\.[0-9]+)?)")
_ENDS: Final = ("#009e73", "#d55e00", "#e69f00", "#56b4e9", "#6a3d9a", "#444444")
_Ground = tuple[U8, tuple[float, float, float, float]]  # (H, W, 3) from above; west, east, south and north edge


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
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
    """The axes of a figure with one panel, see `_figure`."""
    with _figure(name, out, height_in) as figure:
        yield figure.add_subplot()


@contextmanager
def _figure(name: str, out: io.BytesIO, height_in: float) -> Iterator[Figure]:
    """A figure that is written to `out` at the end; names inside it come from `name` alone."""
    with mpl.rc_context({**_STYLE, "svg.hashsalt": name}):
        figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
        yield figure
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})


def _ground_around(town: str, points_m: Sequence[tuple[float, float]]) -> _Ground | None:
    """The ground of a town around some points; None where there is no such town, or no point."""
    if not points_m:
        return None
    try:
        street = load_street(find_town(town))
    except WcsimError:
        return None
    x, y = np.asarray(points_m, np.float64).T
    west, east = float(x.min()) - _MARGIN_M, float(x.max()) + _MARGIN_M
    south, north = float(y.min()) - _MARGIN_M, float(y.max()) + _MARGIN_M
    cell = max(east - west, north - south) / _MOST_CELLS
    columns, rows = max(1, round((east - west) / cell)), max(1, round((north - south) / cell))
    at_x = west + (np.arange(columns) + 0.5) * (east - west) / columns
    at_y = north - (np.arange(rows) + 0.5) * (north - south) / rows
    strips = [_strip(street.grid, at_x, at_y[row : row + _ROWS_AT_ONCE]) for row in range(0, rows, _ROWS_AT_ONCE)]
    return np.vstack(strips), (west, east, south, north)


def _strip(grid: Ground, at_x: np.ndarray, at_y: np.ndarray) -> U8:
    points = np.stack(np.broadcast_arrays(at_x[None, :], at_y[:, None]), axis=-1)
    table = np.full((256, 3), _OTHER_RGB, np.uint8)
    for class_id, colour in _GROUND_RGB.items():
        table[class_id] = colour
    image = table[grid.class_at(points)]
    image[grid.clearance_at(points) <= 0.0] = _SOLID_RGB
    return np.asarray(image, np.uint8)


def figures_of(result: TestResult, folder: Path) -> list[Exhibit]:
    """All figures of a test, which lies in this folder, in the order of the page."""
    places = {name: place for place, name in enumerate(result.episodes)}
    return [
        _scores(result, places),
        _obedience_figure(result, places),
        *_towns(result, places, folder / TOWNS),
        *_comfort(result, places),
        _statuses(result),
    ]


def _bounds(row: ResultRow, key: str) -> tuple[float, float]:
    """An interval of a row; of few episodes there is none, and a point has no bar."""
    low, high = getattr(row, key) or (math.nan, math.nan)
    return low, high


def _arms(value: float, bounds: tuple[float, float]) -> list[list[float]]:
    """How far an interval reaches below and above a value."""
    return [[max(0.0, value - bounds[0])], [max(0.0, bounds[1] - value)]]


def _scores(result: TestResult, places: Mapping[str, int]) -> Exhibit:
    """Scores with their intervals, a panel a part."""
    plain: list[list[Cell]] = []
    out, parts = io.BytesIO(), ("", *result.parts)
    tall = -(-len(parts) // 2)
    with _figure("scores", out, tall * (0.55 + 0.16 * len(places))) as figure:
        panels = figure.subplots(tall, 2, sharex=True, sharey=True, squeeze=False).flatten()
        for panel, part in zip(panels, parts, strict=False):
            for row in result.rows if part else result.pooled:
                if row.part != part or row.score is None:
                    continue
                bounds, place = _bounds(row, "score_ci"), places[row.policy]
                look = {"fmt": _MARKS[place % len(_MARKS)], "color": _colour_of(place), "markersize": 4}
                panel.errorbar([row.score], [place], xerr=_arms(row.score, bounds), **look)
                plain.append([part or "all", row.policy, row.score, *bounds])
            panel.set_title(part or "all", fontsize=8, loc="left")
            panel.tick_params(labelsize=7)
            panel.grid(visible=False, axis="y")
        for panel in panels[len(parts) :]:
            panel.set_visible(False)
        panels[0].set_yticks(list(places.values()), [_short(name, 20) for name in places])
        panels[0].set_xlim(0.0, 1.0)
        panels[0].set_ylim(len(places) - 0.4, -0.6)
        figure.supxlabel("score, 95 % interval over episodes", fontsize=8)
    return Exhibit(
        name="scores",
        title="Scores",
        says="One point per policy, with its 95 % interval.",
        columns=("part", "policy", "score", "low", "high"),
        rows=plain,
        svg=out.getvalue(),
    )


_AXES: Final = ("crashes_per_km", "kpi1_free_within")


def _obedience_figure(result: TestResult, places: Mapping[str, int]) -> Exhibit:
    """Obedience over own crashes a kilometre, of those who obey half of the time at least."""
    points, plain = {}, list[list[Cell]]()
    for row in result.pooled:
        values = [getattr(row, key) for key in _AXES]
        if None not in values:
            bounds = [_bounds(row, f"{key}_ci") for key in _AXES]
            points[row.policy] = [(value, _arms(value, each)) for value, each in zip(values, bounds, strict=True)]
            plain.append([row.policy, values[0], *bounds[0], values[1], *bounds[1]])
    says = (
        "Upper left is best. Bars are 95 % intervals over all parts. A line joins the assistance levels of one policy "
        "(NAME@LEVEL)."
    )
    shown = {name: point for name, point in points.items() if point[1][0] >= _OBEYS}
    if 0 < len(shown) < len(points):
        left_out = [name for name in points if name not in shown]
        says += f" Not drawn, below 50 %: {', '.join(left_out)}."
    else:
        shown = points
    out = io.BytesIO()
    with _drawn("obedience", out, 4.0) as axes:
        for line in _levels_of(shown):
            x, y = ([shown[name][axis][0] for name in line] for axis in (0, 1))
            axes.plot(x, y, color="#888888", linewidth=1.0, zorder=1)
        for name, ((crashes, left_right), (obeyed, up_down)) in shown.items():
            place = places[name]
            axes.errorbar(
                [crashes],
                [obeyed],
                xerr=left_right,
                yerr=up_down,
                fmt=_MARKS[place % len(_MARKS)],
                color=_colour_of(place),
                markersize=5,
                elinewidth=0.8,
                capsize=2,
                label=_short(name),
            )
        axes.set_xlim(left=0.0)
        axes.set_xlabel("own crashes per km (left is better)")
        axes.set_ylabel("close to user, share of safe steps")
        _legend(axes, len(shown))
    return Exhibit(
        name="obedience",
        title="Obedience against crashes",
        says=says,
        columns=("policy", "own_crashes_per_km", "low", "high", "obeyed", "obeyed_low", "obeyed_high"),
        rows=plain,
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
    """A map a town, some of which lie in `made`; tight places are scenes with coordinates of their own, on no map."""
    here: dict[str, list[tuple[str, EpisodeRecord]]] = {}
    for name, episodes in result.episodes.items():
        for e in episodes:
            if e.part != TIGHT and e.steps:
                here.setdefault(e.town, []).append((name, e))
    return [_town(town, driven, places, made) for town, driven in here.items()]


def _way_rows(name: str, e: EpisodeRecord) -> list[list[Cell]]:
    """Where a chair was after each second, and where its episode ended, as rows of the map's CSV."""
    who: list[Cell] = [name, e.block, e.seat]
    way: list[list[Cell]] = [
        [*who, "way", min(float(second), e.time_s), round(x, 1), round(y, 1)]
        for second, (x, y) in enumerate(e.path_m, 1)
    ]
    return [*way, [*who, "crash" if e.own else "end", e.time_s, *e.end_m]]


def _town(town: str, here: Sequence[tuple[str, EpisodeRecord]], places: Mapping[str, int], made: Path) -> Exhibit:
    points = [point for _, e in here for point in (*e.path_m, *([e.end_m] if e.own else []))]
    own = made / town
    ground = _ground_around(str(own) if _NAME.fullmatch(town) and own.is_dir() else town, points)
    missing = "" if ground is not None or not points else " The ground is not drawn: this town is not on this machine."
    out = io.BytesIO()
    image, (west, east, south, north) = ground or (None, (0.0, 1.0, 0.0, 1.0))
    with _drawn(f"town-{town}", out, 0.9 + 4.1 * min(2.0, max(0.3, (north - south) / (east - west)))) as axes:
        if image is not None:
            axes.imshow(image, extent=(west, east, south, north), interpolation="nearest")
        axes.grid(visible=False)
        _draw_ways(axes, here, places)
    return Exhibit(
        name=f"town-{town}",
        title=f"Paths in {town}",
        says="Paths of all episodes in this town, one colour per policy; crosses are own crashes. Scenes of the part "
        f"tight have their own streets and are not shown.{missing}",
        columns=("policy", "block", "seat", "what", "s", "x_m", "y_m"),
        rows=[row for name, e in here for row in _way_rows(name, e)],
        svg=out.getvalue(),
    )


def _draw_ways(axes: Axes, here: Sequence[tuple[str, EpisodeRecord]], places: Mapping[str, int]) -> None:
    """Ways and crashes of all policies."""
    crashes: dict[str, list[tuple[float, float]]] = {}
    for name, e in here:
        crashes.setdefault(name, []).extend([e.end_m] if e.own else [])
        if len(e.path_m) > 1:
            x, y = zip(*e.path_m, strict=True)
            axes.plot(x, y, color=_colour_of(places[name]), linewidth=0.7, alpha=0.75)
    for name, ends in crashes.items():
        axes.scatter(
            [x for x, _ in ends],
            [y for _, y in ends],
            marker="x",
            s=22,
            linewidths=1.3,
            color=_colour_of(places[name]),
            label=f"{_short(name)}: {counted(len(ends), 'own crash')}",
        )
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    _legend(axes, len(crashes))


def _comfort(result: TestResult, places: Mapping[str, int]) -> list[Exhibit]:
    """How a ride feels: accelerations, and how much the stick that was given moves beside the user's."""
    columns = ("accel_rms_mps2", "stick_travel_per_s", "asked_travel_per_s")
    plain: list[list[Cell]] = [[row.policy, *(getattr(row, name) for name in columns)] for row in result.pooled]
    kinds = (
        ("comfort-acceleration", "Comfort: acceleration", "root mean square of the acceleration, m/s²", columns[0]),
        ("comfort-stick", "Comfort: movement of the stick", "travel of the driven stick per second", columns[1]),
    )
    exhibits = []
    for name, title, label, key in kinds:
        values = {row.policy: getattr(row, key) or 0.0 for row in result.pooled}
        out = io.BytesIO()
        with _drawn(name, out, 0.7 + 0.24 * len(values)) as axes:
            colours = [_colour_of(places[each]) for each in values]
            axes.barh(range(len(values)), list(values.values()), color=colours)
            _with_names(axes, values)
            axes.set_xlabel(label)
        says, svg = f"{label[0].upper()}{label[1:]}; less is smoother.", out.getvalue()
        exhibits.append(Exhibit(name=name, title=title, says=says, columns=("policy", *columns), rows=plain, svg=svg))
    return exhibits


def _with_names(axes: Axes, names: Iterable[str]) -> None:
    """A bar for each policy, the first one on top."""
    shown = [_short(each) for each in names]
    axes.set_yticks(range(len(shown)), shown)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")


def _statuses(result: TestResult) -> Exhibit:
    """Stacked shares: for each policy how many episodes ended in each way."""
    plain: list[list[Cell]] = []
    before, out = [0.0] * len(result.episodes), io.BytesIO()
    with _drawn("status", out, 1.3 + 0.24 * len(result.episodes)) as axes:
        for place, status in enumerate(STATUSES):
            shares = [sum(e.status == status for e in each) / max(1, len(each)) for each in result.episodes.values()]
            if any(shares):
                axes.barh(range(len(shares)), shares, left=before, color=_ENDS[place], label=_ENDINGS[status])
            before = [low + share for low, share in zip(before, shares, strict=True)]
        _with_names(axes, result.episodes)
        axes.set_xlim(0.0, 1.0)
        axes.set_xlabel("share of episodes")
        _legend(axes, len(STATUSES))
    for name, episodes in result.episodes.items():
        plain.append([name, *(sum(e.status == status for e in episodes) for status in STATUSES)])
    return Exhibit(
        name="status",
        title="How episodes ended",
        says="In the parts hazard and tight, time up is good: it means no crash until the end.",
        columns=("policy", *STATUSES),
        rows=plain,
        svg=out.getvalue(),
    )


def curve_chart(name: str, label: str, curves: Sequence[Curve], limit: float | None = None) -> bytes:
    """Curves over training steps, with a line at the limit; values that are all positive begin at zero."""
    out = io.BytesIO()
    with _drawn(name, out) as axes:
        if limit is not None:
            axes.axhline(limit, color="#222222", linewidth=0.9, linestyle=":", label=f"{limit:g}")
        for place, curve in enumerate(curves):
            colour = _colour_of(place)
            axes.plot(curve.steps, curve.values, ".", color=colour, markersize=4, markeredgewidth=0, alpha=0.45)
            axes.plot(curve.steps, curve.means, color=colour, linewidth=1.3, label=_short(curve.name))
            if curve.switch is not None:  # several at one step: their dashes stand beside each other
                dashes = (3.0 * place, (3.0, 3.0 * max(1, len(curves) - 1)))
                axes.axvline(curve.switch, color=colour, linewidth=0.9, linestyle=dashes)
            if curve.crossing is not None and limit is not None:
                axes.plot([curve.crossing], [limit], "v", color=colour, markersize=7, markeredgecolor="#222222")
        if all(value >= 0.0 for curve in curves for value in curve.values):
            axes.set_ylim(bottom=0.0)
        axes.set_xlim(left=0.0)
        axes.locator_params(axis="x", nbins=6)  # of six digits no more stand beside each other
        axes.set_xlabel("steps of training")
        axes.set_ylabel(label)
        _legend(axes, len(curves) + (limit is not None))
    return out.getvalue()


def _legend(axes: Axes, entries: int) -> None:
    """Below the axes: it never hides a point."""
    labels = axes.get_legend_handles_labels()[1]
    if entries and labels:
        longest = max(map(len, labels))
        columns = max(1, min(3, entries, _LEGEND_CHARACTERS // (longest + 6)))
        axes.figure.legend(loc="outside lower center", ncols=columns)


def _short(name: str, most: int = 28) -> str:
    """A name that fits: the end of a path says which it is. Matplotlib leaves names out that begin with "_"."""
    name = f" {name}" if name.startswith("_") else name
    return name if len(name) <= most else f"…{name[-(most - 1) :]}"
