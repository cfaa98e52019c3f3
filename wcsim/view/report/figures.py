"""The figures of a test, each with its numbers as CSV, and the ground below its maps."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

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
from wcsim.errors import WcsimError
from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street
from wcsim.types import U8, ClassId, Ground
from wcsim.view.report.charts import (
    DrivenWay,
    Estimate,
    TownPicture,
    bar_chart,
    obedience_chart,
    score_chart,
    share_chart,
    town_chart,
)
from wcsim.view.report.pages import Cell, Exhibit

_MARGIN_M: Final = 25.0
_MOST_CELLS: Final = 700
_ROWS_AT_ONCE: Final = 64
_COLOURS: Final = {
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


def _ground_around(town: str, points_m: Sequence[tuple[float, float]]) -> TownPicture | None:
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
    return TownPicture(image=np.vstack(strips), west_m=west, east_m=east, south_m=south, north_m=north)


def _strip(grid: Ground, at_x: np.ndarray, at_y: np.ndarray) -> U8:
    points = np.stack(np.broadcast_arrays(at_x[None, :], at_y[:, None]), axis=-1)
    table = np.full((256, 3), _OTHER_RGB, np.uint8)
    for class_id, colour in _COLOURS.items():
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


def _estimate(row: ResultRow, key: str, interval: str) -> Estimate | None:
    value = getattr(row, key)
    low, high = getattr(row, interval) or (math.nan, math.nan)  # a point of few episodes has no bar
    return None if value is None else Estimate(value=value, low=low, high=high)


def _scores(result: TestResult, places: dict[str, int]) -> Exhibit:
    groups: list[tuple[str, list[tuple[str, Estimate]]]] = []
    plain: list[list[Cell]] = []
    for part in ("", *result.parts):
        group = []
        for row in result.rows if part else result.pooled:
            score = _estimate(row, "score", "score_ci") if row.part == part else None
            if score is not None:
                group.append((row.policy, score))
                plain.append([part or "all", row.policy, score.value, score.low, score.high])
        groups.append((part or "all", group))
    return Exhibit(
        name="scores",
        title="Scores",
        says="One point per policy, with its 95 % interval.",
        columns=("part", "policy", "score", "low", "high"),
        rows=plain,
        svg=score_chart(groups, places),
    )


def _obedience_figure(result: TestResult, places: dict[str, int]) -> Exhibit:
    """Obedience over own crashes a kilometre, of those who obey half of the time at least."""
    points, plain = {}, list[list[Cell]]()
    for row in result.pooled:
        crashes = _estimate(row, "crashes_per_km", "crashes_per_km_ci")
        obeyed = _estimate(row, "kpi1_free_within", "kpi1_free_within_ci")
        if crashes is not None and obeyed is not None:
            points[row.policy] = crashes, obeyed
            figures = (crashes.value, crashes.low, crashes.high, obeyed.value, obeyed.low, obeyed.high)
            plain.append([row.policy, *figures])
    columns = ("policy", "own_crashes_per_km", "low", "high", "obeyed", "obeyed_low", "obeyed_high")
    says = (
        "Upper left is best. Bars are 95 % intervals over all parts. A line joins the assistance levels of one policy "
        "(NAME@LEVEL)."
    )
    shown = {name: point for name, point in points.items() if point[1].value >= _OBEYS}
    if 0 < len(shown) < len(points):
        left_out = [name for name in points if name not in shown]
        says += f" Not drawn, below 50 %: {', '.join(left_out)}."
    else:
        shown = points
    return Exhibit(
        name="obedience",
        title="Obedience against crashes",
        says=says,
        columns=columns,
        rows=plain,
        svg=obedience_chart(shown, _levels_of(shown), places),
    )


def _levels_of(names: Sequence[str] | dict[str, Any]) -> list[list[str]]:
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
    towns = dict.fromkeys(e.town for episodes in result.episodes.values() for e in episodes if e.part != TIGHT)
    found = []
    for town in towns:
        here = [
            (name, e)
            for name, episodes in result.episodes.items()
            for e in episodes
            if e.town == town and e.part != TIGHT and e.steps
        ]
        if here:
            found.append(_town(town, here, places, made))
    return found


def _way_rows(name: str, e: EpisodeRecord) -> list[list[Cell]]:
    """Where a chair was after each second, and where its episode ended, as rows of the map's CSV."""
    who: list[Cell] = [name, e.block, e.seat]
    way: list[list[Cell]] = [
        [*who, "way", min(float(second), e.time_s), round(x, 1), round(y, 1)]
        for second, (x, y) in enumerate(e.path_m, 1)
    ]
    return [*way, [*who, "crash" if e.own else "end", e.time_s, *e.end_m]]


def _town(town: str, here: Sequence[tuple[str, EpisodeRecord]], places: dict[str, int], made: Path) -> Exhibit:
    ways = [DrivenWay(policy=name, points_m=e.path_m, crash_m=e.end_m if e.own else None) for name, e in here]
    points = [point for way in ways for point in (*way.points_m, *((way.crash_m,) if way.crash_m else ()))]
    own = made / town
    ground = _ground_around(str(own) if _NAME.fullmatch(town) and own.is_dir() else town, points)
    plain = [row for name, e in here for row in _way_rows(name, e)]
    missing = "" if ground is not None or not points else " The ground is not drawn: this town is not on this machine."
    return Exhibit(
        name=f"town-{town}",
        title=f"Paths in {town}",
        says="Paths of all episodes in this town, one colour per policy; crosses are own crashes. Scenes of the part "
        f"tight have their own streets and are not shown.{missing}",
        columns=("policy", "block", "seat", "what", "s", "x_m", "y_m"),
        rows=plain,
        svg=town_chart(town, ground, ways, places),
    )


def _comfort(result: TestResult, places: dict[str, int]) -> list[Exhibit]:
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
        says = f"{label[0].upper()}{label[1:]}; less is smoother."
        svg = bar_chart(name, label, values, places)
        exhibits.append(Exhibit(name=name, title=title, says=says, columns=("policy", *columns), rows=plain, svg=svg))
    return exhibits


def _statuses(result: TestResult) -> Exhibit:
    counts = {
        name: {status: sum(e.status == status for e in episodes) for status in STATUSES}
        for name, episodes in result.episodes.items()
    }
    named = {name: {_ENDINGS[status]: count for status, count in row.items()} for name, row in counts.items()}
    plain: list[list[Cell]] = [[name, *(row[status] for status in STATUSES)] for name, row in counts.items()]
    return Exhibit(
        name="status",
        title="How episodes ended",
        says="In the parts hazard and tight, time up is good: it means no crash until the end.",
        columns=("policy", *STATUSES),
        rows=plain,
        svg=share_chart("status", named),
    )
