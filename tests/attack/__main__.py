"""The whole attack, counted by area and outcome: `python -m tests.attack [SHARE [NAME...]]`, a share of 1 being all.

The seed is the day's date.
"""

import sys
import tempfile
from datetime import date
from pathlib import Path

from tests.attack.outcomes import Tally
from tests.attack.table import TABLE


def main(words: list[str]) -> int:
    """Feed all, or the named rows, print the table and every defect; 1 when there is one."""
    share, seed, tally = float(words[0]) if words else 1.0, int(f"{date.today():%Y%m%d}"), Tally()
    with tempfile.TemporaryDirectory() as folder:
        for row in TABLE:
            if len(words) < 2 or row.name in words[1:]:
                tally.run(row.cases(max(1, round(share * row.whole)), seed, Path(folder)))
                sys.stderr.write(f"{row.name}: {tally.total} inputs, {len(tally.defects)} defects, seed {seed}\n")
    sys.stdout.write(tally.table() + "\n")
    for defect in tally.defects:
        sys.stdout.write(defect + "\n")
    return int(bool(tally.defects))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
