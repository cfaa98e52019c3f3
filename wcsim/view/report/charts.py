"""Figures as SVG by matplotlib, the same bytes each time and fit for a paper; the one module that draws with it."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wcsim.core.reading import counted
from wcsim.types import U8

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A figure with its interval."""

    value: float
    low: float
    high: float

    @property
    def arms(self) -> list[list[float]]:
        """How far the interval reaches below and above."""
        return [[max(0.0, self.value - self.low)], [max(0.0, self.high - self.value)]]


@dataclass(frozen=True, slots=True, kw_only=True)
class TownPicture:
    """A town from above; row 0 is its northern edge."""

    image: U8  # (H, W, 3)
    west_m: float
    east_m: float
    south_m: float
    north_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivenWay:
    """The way of an episode; no points where it was not recorded."""

    policy: str
    points_m: Sequence[tuple[float, float]]  # W
    crash_m: tuple[float, float] | None  # where it ended with a crash of its own


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


def obedience_chart(
    points: Mapping[str, tuple[Estimate, Estimate]], lines: Sequence[Sequence[str]], places: Mapping[str, int]
) -> bytes:
    """Obedience over own crashes a kilometre.

    Args:
        points: By policy: crashes per km, and share within 0.1768.
        lines: Policies that are one with another assistance level, in order.
        places: The policies' places in the result, for their colours.
    """
    out = io.BytesIO()
    with _drawn("obedience", out, 4.0) as axes:
        for line in lines:
            x, y = ([points[name][axis].value for name in line] for axis in (0, 1))
            axes.plot(x, y, color="#888888", linewidth=1.0, zorder=1)
        for name, (crashes, obeyed) in points.items():
            place = places[name]
            axes.errorbar(
                [crashes.value],
                [obeyed.value],
                xerr=crashes.arms,
                yerr=obeyed.arms,
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
        _legend(axes, len(points))
    return out.getvalue()


def score_chart(rows: Sequence[tuple[str, Sequence[tuple[str, Estimate]]]], places: Mapping[str, int]) -> bytes:
    """Scores with their intervals, a panel a part. `places` are the policies' places in the result."""
    out = io.BytesIO()
    tall = -(-len(rows) // 2)
    with _figure("scores", out, tall * (0.55 + 0.16 * len(places))) as figure:
        panels = figure.subplots(tall, 2, sharex=True, sharey=True, squeeze=False).flatten()
        for panel, (part, group) in zip(panels, rows, strict=False):
            for name, score in group:
                look = {"fmt": _MARKS[places[name] % len(_MARKS)], "color": _colour_of(places[name]), "markersize": 4}
                panel.errorbar([score.value], [places[name]], xerr=score.arms, **look)
            panel.set_title(part, fontsize=8, loc="left")
            panel.tick_params(labelsize=7)
            panel.grid(visible=False, axis="y")
        for panel in panels[len(rows) :]:
            panel.set_visible(False)
        panels[0].set_yticks(list(places.values()), [_short(name, 20) for name in places])
        panels[0].set_xlim(0.0, 1.0)
        panels[0].set_ylim(len(places) - 0.4, -0.6)
        figure.supxlabel("score, 95 % interval over episodes", fontsize=8)
    return out.getvalue()


def town_chart(town: str, ground: TownPicture | None, ways: Sequence[DrivenWay], places: Mapping[str, int]) -> bytes:
    """Ways and crashes of all policies on a town."""
    out = io.BytesIO()
    tall = 1.0 if ground is None else (ground.north_m - ground.south_m) / (ground.east_m - ground.west_m)
    with _drawn(f"town-{town}", out, 0.9 + 4.1 * min(2.0, max(0.3, tall))) as axes:
        if ground is not None:
            extent = (ground.west_m, ground.east_m, ground.south_m, ground.north_m)
            axes.imshow(ground.image, extent=extent, interpolation="nearest")
        axes.grid(visible=False)
        for way in ways:
            if len(way.points_m) > 1:
                x, y = zip(*way.points_m, strict=True)
                axes.plot(x, y, color=_colour_of(places[way.policy]), linewidth=0.7, alpha=0.75)
        for name in dict.fromkeys(way.policy for way in ways):
            crashes = [way.crash_m for way in ways if way.policy == name and way.crash_m is not None]
            axes.scatter(
                [x for x, _ in crashes],
                [y for _, y in crashes],
                marker="x",
                s=22,
                linewidths=1.3,
                color=_colour_of(places[name]),
                label=f"{_short(name)}: {counted(len(crashes), 'own crash')}",
            )
        axes.set_aspect("equal")
        axes.set_xlabel("east, m")
        axes.set_ylabel("north, m")
        _legend(axes, len({way.policy for way in ways}))
    return out.getvalue()


def bar_chart(name: str, label: str, values: Mapping[str, float], places: Mapping[str, int]) -> bytes:
    """A bar a policy."""
    out = io.BytesIO()
    with _drawn(name, out, 0.7 + 0.24 * len(values)) as axes:
        names = list(values)
        axes.barh(range(len(names)), list(values.values()), color=[_colour_of(places[each]) for each in names])
        axes.set_yticks(range(len(names)), [_short(each) for each in names])
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel(label)
    return out.getvalue()


def share_chart(name: str, counts: Mapping[str, Mapping[str, int]]) -> bytes:
    """Stacked shares: for each policy how many episodes ended in each way."""
    out = io.BytesIO()
    with _drawn(name, out, 1.3 + 0.24 * len(counts)) as axes:
        names, kinds = list(counts), list(dict.fromkeys(kind for each in counts.values() for kind in each))
        before = [0.0] * len(names)
        for place, kind in enumerate(kinds):
            shares = [counts[each].get(kind, 0) / max(1, sum(counts[each].values())) for each in names]
            if any(shares):
                axes.barh(range(len(names)), shares, left=before, color=_ENDS[place % len(_ENDS)], label=kind)
            before = [low + share for low, share in zip(before, shares, strict=True)]
        axes.set_yticks(range(len(names)), [_short(each) for each in names])
        axes.invert_yaxis()
        axes.set_xlim(0.0, 1.0)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("share of episodes")
        _legend(axes, len(kinds))
    return out.getvalue()


_ENDS: Final = ("#009e73", "#d55e00", "#e69f00", "#56b4e9", "#6a3d9a", "#444444")


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
