"""What somebody may have meant by a word that nothing is called by."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def meant(word: str, known: Iterable[str]) -> str:
    """A question with the known word that is nearest, "" where none is near.

    >>> meant("folow", ["follow", "stop"]), meant("xyz", ["follow"])
    ("; did you mean 'follow'?", '')
    """
    found = difflib.get_close_matches(word[:80].lower(), list(known), n=1, cutoff=0.7)
    return f"; did you mean {found[0]!r}?" if found else ""
