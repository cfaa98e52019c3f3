"""Draw docs/pictures/speed.svg from the numbers in docs/pictures/speed.json: `python tools/speed_chart.py`."""

import html
import json
import textwrap
from pathlib import Path
from typing import Any

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"
WIDTH_PX, LEFT_PX, RIGHT_PX, ROW_PX, TOP_PX = 720, 90, 190, 34, 44
_INK, _GREY, _BAR, _LINE = "#1d2126", "#59626d", "#2f7fd6", "#d64545"
_FONT = "font-family='Helvetica, Arial, sans-serif'"


def main() -> None:
    """Write it."""
    numbers = json.loads((PICTURES / "speed.json").read_text(encoding="utf-8"))
    (PICTURES / "speed.svg").write_text(drawn(numbers), encoding="utf-8")


def rate(row: dict[str, Any]) -> float:
    """Ticks a second of a row, which has them or the milliseconds of one."""
    return float(row["ticks_per_s"]) if "ticks_per_s" in row else 1000.0 / float(row["tick_ms"])


def drawn(numbers: dict[str, Any]) -> str:
    """The chart: a bar a row, a line for real time, and the workload below."""
    rows, real = numbers["rows"], float(numbers["real_time"])
    below = textwrap.wrap(numbers["workload"].replace("`", ""), 124)
    foot = TOP_PX + ROW_PX * len(rows)
    height = foot + 30 + 15 * len(below)
    px = (WIDTH_PX - LEFT_PX - RIGHT_PX) / max(map(rate, rows))
    at = LEFT_PX + real * px
    parts = [
        f"<svg xmlns='http://www.w3.org/2000/svg' width='{WIDTH_PX}' height='{height}' "
        f"viewBox='0 0 {WIDTH_PX} {height}' role='img' {_FONT}>",
        f"<title>{html.escape(numbers['title'])}</title>",
        f"<rect width='{WIDTH_PX}' height='{height}' rx='6' fill='#ffffff'/>",
        _text(12, 24, numbers["title"], 14, _INK, "bold"),
    ]
    for place, row in enumerate(rows):
        y, value = TOP_PX + ROW_PX * place, rate(row)
        parts += [
            _text(12, y + 20, row["name"], 13, _INK),
            f"<rect x='{LEFT_PX}' y='{y + 5}' width='{value * px:.1f}' height='{ROW_PX - 12}' fill='{_BAR}'/>",
            _text(LEFT_PX + value * px + 8, y + 20, f"{value:.0f} a second, {value / real:.0f} x real time", 12, _INK),
        ]
    parts.append(f"<line x1='{at:.1f}' x2='{at:.1f}' y1='{TOP_PX}' y2='{foot}' stroke='{_LINE}' stroke-width='2'/>")
    parts.append(_text(at + 4, foot + 12, "real time", 11, _LINE))
    parts += [_text(12, foot + 32 + 15 * number, line, 11, _GREY) for number, line in enumerate(below)]
    return "\n".join([*parts, "</svg>", ""])


def _text(x: float, y: float, words: str, size: int, colour: str, weight: str = "normal") -> str:
    style = f"font-size='{size}' font-weight='{weight}' fill='{colour}'"
    return f"<text x='{x:.1f}' y='{y:.1f}' {style}>{html.escape(words)}</text>"


if __name__ == "__main__":
    main()
