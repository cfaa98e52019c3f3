"""What becomes of hostile inputs: each is fed once, and how it ended is counted by area."""

from __future__ import annotations

import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from wcsim.errors import WcsimError

LIMIT_S = 5.0  # of the processor, or ten times what the sound input takes, where that is more
PATIENCE = 12  # times that by the clock, on a machine with other work
LIMIT_BYTES = 128 << 20  # of memory at once, beside what is held already; a sound input takes a few MiB
_STATUS, _FORGET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Outcome(Enum):
    """How an input ended; all but the first two are defects."""

    REFUSED = "refused"  # by one of wcsim's own errors
    HARMLESS = "harmless"  # taken, and rightly: what was made of it makes the same again
    WRONG = "accepted wrongly"
    TRACEBACK = "traceback"
    HUNG = "hung"
    SWOLLEN = "memory"
    OUTSIDE = "wrote outside"


SOUND = (Outcome.REFUSED, Outcome.HARMLESS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One hostile input."""

    area: str  # "messages", "journals", ...
    name: str  # enough to make it again: the generator's number and what was done
    feed: Callable[[], Outcome | bool]  # True: harmless; False: accepted wrongly; a WcsimError: refused
    limit_s: float = LIMIT_S
    limit_bytes: int = LIMIT_BYTES


@dataclass(slots=True)
class Tally:
    """Counts by area and outcome, and every defect in words."""

    counts: Counter[tuple[str, Outcome]] = field(default_factory=Counter)
    defects: list[str] = field(default_factory=list)

    def run(self, cases: Iterable[Case]) -> Tally:
        """Feed all cases; an exception that is not wcsim's own is a traceback, whatever it is."""
        for case in cases:
            held, worked_s, begun_s = _held_bytes(), time.process_time(), time.monotonic()
            outcome, words = _outcome(case)
            took_s = max(time.process_time() - worked_s, (time.monotonic() - begun_s) / PATIENCE)
            took_bytes = _held_bytes(at_most=True) - held
            if outcome in SOUND and took_s > case.limit_s:
                outcome, words = Outcome.HUNG, f"took {took_s:.1f} s of {case.limit_s:.1f} s"
            elif outcome in SOUND and took_bytes > case.limit_bytes:
                outcome, words = Outcome.SWOLLEN, f"took {took_bytes >> 20} MiB of {case.limit_bytes >> 20}"
            self.count(case.area, outcome, f"{case.name}: {words}")
        return self

    def count(self, area: str, outcome: Outcome, words: str = "") -> None:
        """One more input of an area."""
        self.counts[area, outcome] += 1
        if outcome not in SOUND:
            self.defects.append(f"{area}: {outcome.value}: {words}")

    def add(self, other: Tally) -> None:
        """All that another one counted."""
        self.counts.update(other.counts)
        self.defects.extend(other.defects)

    @property
    def total(self) -> int:
        """Inputs so far."""
        return sum(self.counts.values())

    def table(self) -> str:
        """A row an area, a column an outcome, in Markdown."""
        areas = sorted({area for area, _ in self.counts})
        head = ["area", "inputs", *(outcome.value for outcome in Outcome)]
        rows = [head, ["---"] * len(head)]
        for area in areas:
            numbers = [self.counts[area, outcome] for outcome in Outcome]
            rows.append([area, str(sum(numbers)), *map(str, numbers)])
        totals = [sum(self.counts[area, outcome] for area in areas) for outcome in Outcome]
        rows.append(["all", str(self.total), *map(str, totals)])
        return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _held_bytes(at_most: bool = False) -> int:
    """Memory of this process now, from when on its peak is counted; or that peak."""
    if not at_most:
        _FORGET.write_text("5", encoding="ascii")  # Linux forgets the peak
    name = "VmHWM:" if at_most else "VmRSS:"
    line = next(line for line in _STATUS.read_text(encoding="ascii").splitlines() if line.startswith(name))
    return int(line.split()[1]) << 10


def _outcome(case: Case) -> tuple[Outcome, str]:
    try:
        told = case.feed()
    except WcsimError as error:
        return Outcome.REFUSED, str(error)
    except Exception:  # that is what is looked for
        return Outcome.TRACEBACK, traceback.format_exc(limit=-4)
    if isinstance(told, Outcome):
        return told, ""
    return (Outcome.HARMLESS, "") if told else (Outcome.WRONG, "")
