"""The chart of docs/pictures/speed.svg, from the numbers in docs/pictures/speed.json (`make pictures PART=models`)."""

import io
import textwrap
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"
_PLAIN = {"svg.hashsalt": "speed", "svg.fonttype": "none"}  # the same bytes each time, and words as words


def drawn(numbers: dict[str, Any]) -> str:
    """The chart as SVG: a bar a row, a line for real time, and the workload below; the same bytes each time."""
    rows, real = numbers["rows"], float(numbers["real_time"])
    rates = [float(row["ticks_per_s"]) for row in rows]
    with mpl.rc_context(_PLAIN):
        figure = Figure(figsize=(9.0, 1.6 + 0.4 * len(rows)), layout="constrained")
        axes = figure.subplots()
        bars = axes.barh([row["name"] for row in rows], rates, color="#2f7fd6")
        axes.bar_label(bars, [f"{value:.0f} a second, {value / real:.0f} x real time" for value in rates], padding=4)
        axes.axvline(real, color="#d64545", label="real time")
        axes.set(title=numbers["title"], xlim=(0.0, 1.5 * max(rates)))
        axes.set_xlabel(textwrap.fill(numbers["workload"].replace("`", ""), 110), fontsize=8)
        axes.invert_yaxis()
        axes.legend(loc="lower right")
        file = io.StringIO()
        figure.savefig(file, format="svg", metadata={"Date": None})
    return "\n".join(line.rstrip() for line in file.getvalue().splitlines()) + "\n"
