"""The columns of a test's tables, on a console and on a page: what each is called, and what it says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from wcsim.core.reading import own_data

if TYPE_CHECKING:  # loads much, which --help must not
    from wcsim.agents.evaluation.suite.rows import ResultRow


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a result's table."""

    heading: str
    key: str  # of `ResultRow`
    says: str
    form: str = "{:d}"
    interval: str = ""  # key of the interval that stands beside the figure
    short: str = ""  # the heading on a console, whose tables have 80 characters; "" where it is on pages alone

    def value(self, row: ResultRow) -> Any:
        """The figure of a row; None where nothing was measured, or no episode counts as an attempt to arrive."""
        return None if self.key == "arrivals" and not row.attempts else getattr(row, self.key)


GROUPS: Final = {what: tuple(Column(**column) for column in columns) for what, columns in own_data(__file__).items()}
COLUMNS: Final = tuple(column for columns in GROUPS.values() for column in columns)
