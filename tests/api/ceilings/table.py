"""Numbers of the project, each with its ceiling.

Numbers only fall. A ceiling that stands more than `SLACK` above today's number is lowered in the same change; one rises
only by what was agreed before, with the reason in the commit.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from tests.api.ceilings import measures

SLACK: Final = 0.05  # of the number, so that no fall is given back unseen


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One number that has a ceiling."""

    name: str
    first: float  # when the table was begun
    ceiling: float
    count: Callable[[], float]


ROWS: Final = (
    Row(
        name="wcsim: tokens of code",
        # Eight engineers found 460 lines that were no feature. The rest is text: it falls room by room.
        first=691_761,
        ceiling=571_463,
        count=measures.tokens,
    ),
    Row(name="wcsim: files", first=790, ceiling=440, count=measures.files),
    Row(name="wcsim: functions and classes", first=4_414, ceiling=3_234, count=measures.names),
    Row(name="wcsim: those that are public", first=2_655, ceiling=1_588, count=measures.public_names),
    Row(name="wcsim: private ones called once", first=1_278, ceiling=853, count=measures.called_once),
    Row(name="wcsim: files with late constants", first=110, ceiling=6, count=measures.late_constants),
    Row(name="wcsim: code lines a comment", first=389, ceiling=23.5, count=measures.lines_per_comment),
    Row(
        name="wcsim: the same where ties are decided",
        first=311,
        ceiling=20.3,
        count=lambda: measures.lines_per_comment(*measures.DECIDING),
    ),
    Row(name="wcsim: rooms of over 40 of them", first=24, ceiling=2, count=measures.silent_rooms),
    Row(name="wcsim: settings", first=213, ceiling=191, count=measures.settings),
    Row(name="wcsim: imports, % of the code", first=12.8, ceiling=10.7, count=measures.import_share),
    Row(name="JavaScript: lines", first=1_632, ceiling=2_566, count=lambda: measures.text_lines(".js")),
    Row(name="HTML and CSS: lines", first=754, ceiling=776, count=lambda: measures.text_lines(".html", ".css")),
    Row(name="templates: lines", first=0, ceiling=356, count=lambda: measures.text_lines(".jinja", ".j2")),
    Row(name="tools: tokens", first=13_871, ceiling=11_115, count=lambda: measures.tokens("tools")),
    Row(name="examples: tokens", first=2_835, ceiling=6_150, count=lambda: measures.tokens("examples")),
    Row(name="benchmarks: tokens", first=55_115, ceiling=62_120, count=lambda: measures.tokens("benchmarks")),
    Row(name="tests: tokens", first=619_290, ceiling=625_695, count=lambda: measures.tokens("tests")),
    Row(name="docs: words written by hand", first=74_035, ceiling=36_530, count=measures.words_of_docs),
    # The ideas are found by code. Of formats the log's and that of pictures in shared memory; of meters that of an
    # episode's record and the running one of a film; of learners Q-learning and danger networks.
    Row(name="ideas: formats of its own", first=6, ceiling=2, count=lambda: len(measures.formats())),
    Row(name="ideas: tick loops", first=14, ceiling=3, count=measures.tick_loops),
    Row(name="ideas: meters of KPI 1", first=4, ceiling=2, count=lambda: len(measures.meters())),
    Row(name="ideas: learners", first=4, ceiling=2, count=lambda: len(measures.learners())),
    Row(name="ideas: functions returning a RunConfig", first=40, ceiling=6, count=measures.rewriters),
    Row(name="ideas: files that resolve settings", first=30, ceiling=30, count=measures.resolvers),
    Row(name="ideas: files that start a process", first=16, ceiling=3, count=measures.process_starters),
    Row(name="ideas: borders broken, of 14", first=12, ceiling=0, count=measures.broken_borders),
    Row(name="ideas: borders broken by way of others", first=2, ceiling=2, count=measures.roundabout_borders),
)


def counted() -> dict[str, float]:
    """Today's number of each row."""
    return {row.name: row.count() for row in ROWS}


def faults(now: dict[str, float], rows: tuple[Row, ...] = ROWS) -> list[str]:
    """What is over its ceiling, and which ceilings have room that is not needed."""
    found = []
    for row in rows:
        number = now[row.name]
        if number > row.ceiling:
            found.append(f"{row.name}: {number:g}, expected at most {row.ceiling:g}; remove something or agree on more")
        elif row.ceiling > number * (1 + SLACK) + 1:
            found.append(f"{row.name}: {number:g}, the ceiling is {row.ceiling:g}; lower it in tests/api/ceilings")
    return found


def main() -> int:
    """Print the table and what is wrong with it."""
    now = counted()
    lines = [f"{'':<42}{'first':>9}{'ceiling':>9}{'now':>9}"]
    lines += [f"{row.name:<42}{row.first:>9,.7g}{row.ceiling:>9,.7g}{now[row.name]:>9,.7g}" for row in ROWS]
    lines += ["", f"{'room':<24}{'tokens':>9}{'names':>9}{'once':>9}{'late':>9}{'lines a comment':>17}"]
    lines += [
        f"{room:<24}{measures.tokens(room):>9,.7g}{measures.names(room):>9g}{measures.called_once(room):>9g}"
        f"{measures.late_constants(room):>9g}{measures.lines_per_comment(room):>17g}"
        for room in measures.rooms()
    ]
    sys.stdout.write("\n".join([*lines, *faults(now)]) + "\n")
    return int(bool(faults(now)))
