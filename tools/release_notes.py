"""Print a version's section of CHANGELOG.md: `python tools/release_notes.py VERSION`; fails when there is none."""

import re
import sys
from pathlib import Path


def notes(changelog: str, version: str) -> str:
    """The text below `## VERSION`, whatever date stands behind it, up to the next version.

    Raises:
        ValueError: There is no such section, or nothing in it.
    """
    heading = rf"^## \[?{re.escape(version)}\]?(?: [^\n]*)?\n"
    found = re.search(rf"{heading}(.*?)(?=^## |\Z)", changelog, re.MULTILINE | re.DOTALL)
    if found is None or not found.group(1).strip():
        raise ValueError(f"CHANGELOG.md has no notes for {version!r}; expected lines below '## {version}'")
    return found.group(1).strip()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tools/release_notes.py VERSION")
    try:
        print(notes((Path(__file__).parents[1] / "CHANGELOG.md").read_text(encoding="utf-8"), sys.argv[1]))
    except ValueError as error:
        sys.exit(str(error))
