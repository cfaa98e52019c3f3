"""`wcsim users record | fit`."""

from __future__ import annotations

from wcsim.cli.recordings import user_fit, user_record
from wcsim.cli.shared.common import run_part


def run(words: list[str]) -> int:
    """Run one of them."""
    record = user_record.UserRecordOptions, user_record.run
    fit = user_fit.UserFitOptions, user_fit.run
    return run_part(words, "users", {"record": record, "fit": fit})
