"""The columns of a test's tables, on a console and on a page: what each is called, and what it says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from wcsim.core.reading import own_data

if TYPE_CHECKING:  # loads much, which --help must not
    from wcsim.agents.evaluation.suite.rows import ResultRow

_COUNTED_IN: Final = {"arrivals": "attempts", "needless": "judged_episodes"}  # of none there is no figure


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a result's table."""

    heading: str
    key: str  # of `ResultRow`
    says: str
    form: str = "{:d}"
    interval: str = ""  # key of the interval that stands beside the figure
    bound: str = ""  # form of its two ends

    def value(self, row: ResultRow) -> Any:
        """The figure of a row; None where nothing was measured."""
        return getattr(row, self.key) if getattr(row, _COUNTED_IN.get(self.key, "policy")) else None

    def texts(self, row: ResultRow) -> tuple[str, str]:
        """The figure of a row and its 95 % range in words, "" for each that is not known."""
        value, bounds = self.value(row), getattr(row, self.interval) if self.interval else None
        if value is None:
            return "", ""
        if self.key == "mcnemar_p" and value == 0:
            return "< 1e-6", ""  # a result keeps six digits
        return self.form.format(value, row=row), " to ".join(self.bound.format(end) for end in bounds or ())


GROUPS: Final = {what: tuple(Column(**column) for column in columns) for what, columns in own_data(__file__).items()}
COLUMNS: Final = tuple(column for columns in GROUPS.values() for column in columns)
LOOK: Final = next(iter(GROUPS.values()))  # all that a first look needs
