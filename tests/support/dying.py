"""A process that ends while it writes files."""

import pytest

from wcsim.core import files


def die_after(dying: pytest.MonkeyPatch, name: str, written: int) -> None:
    """Let a function of `core.files` write so many files, and then end the process as Ctrl-C does."""
    left, write = [written], getattr(files, name)

    def last_words(path, data):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        write(path, data)

    dying.setattr(files, name, last_words)
