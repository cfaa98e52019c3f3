"""Count words and sentences of pages: `python -m tools.readability [PAGE...]` also prints long sentences.

Words are counted as `wc -w` does. A sentence is text outside of code, tables, headings and pictures; a link is its
text, and code within a sentence is one word.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Final

from tools.pages import MADE, ROOT

LONGEST: Final = 30  # words of a sentence
MEAN: Final = 18.0  # words of a page's sentences
_CODE: Final = re.compile(r"^( *)```.*?^\1```", re.MULTILINE | re.DOTALL)
_NO_PROSE: Final = re.compile(r"^(\||#|!\[|<|    ).*$", re.MULTILINE)
_ITEM: Final = re.compile(r"^ *([-*]|\d+\.) +", re.MULTILINE)
_LINK: Final = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
_END: Final = re.compile(r"[.!?][)\"*_]*(?=\s+[^a-z\s]|\s*$)")
_ABBREVIATION: Final = re.compile(r"\b(e\.g|i\.e|cf|vs|Fig|Sec|No|approx)\.")


def pages() -> list[Path]:
    """README, CONTRIBUTING, AGENTS, CHANGELOG, and what is written by hand below `docs/`."""
    made = {ROOT / "docs" / f"{name}.md" for name in (*MADE, "validation")}  # measured by `benchmarks`
    front = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "AGENTS.md", "CHANGELOG.md")]
    return [page for page in (*front, *sorted((ROOT / "docs").rglob("*.md"))) if page.is_file() and page not in made]


def words(text: str) -> int:
    """As `wc -w` counts them."""
    return len(text.split())


def sentences(text: str) -> list[str]:
    """Sentences of a page, each on one line."""
    text = _NO_PROSE.sub("\n", _CODE.sub("\n", text))
    text = _ABBREVIATION.sub(r"\1", _LINK.sub(r"\1", re.sub(r"`[^`]*`", "CODE", text)))
    blocks = re.split(r"\n\s*\n", _ITEM.sub("\n\n", text))
    found: list[str] = []
    for block in blocks:
        line, start = " ".join(block.split()), 0
        for end in _END.finditer(line):
            found.append(line[start : end.end()].strip())
            start = end.end()
        found.append(line[start:].strip())
    return [sentence for sentence in found if re.search(r"\w", sentence)]


def lengths(text: str) -> list[tuple[int, str]]:
    """Words of each sentence, and the sentence."""
    return [(len(re.findall(r"\w[\w'’.,/-]*", sentence)), sentence) for sentence in sentences(text)]


def row(page: Path) -> tuple[int, int, float, int]:
    """Of a page: words, sentences, words of a sentence in the mean, sentences longer than `LONGEST`."""
    text = page.read_text(encoding="utf-8")
    counts = [count for count, _ in lengths(text)]
    return words(text), len(counts), sum(counts) / max(1, len(counts)), sum(count > LONGEST for count in counts)


def main(names: list[str]) -> int:
    """Print a row a page and every sentence that is too long; 1 when a page misses a limit."""
    chosen = [Path(name).resolve() for name in names] or pages()
    total, failed = 0, False
    print(f"{'page':<44} {'words':>6} {'sentences':>9} {'mean':>5} {'over ' + str(LONGEST):>7}")
    for page in chosen:
        count, number, mean, long = row(page)
        total += count if page.is_relative_to(ROOT / "docs") else 0
        failed |= mean >= MEAN or long > 0
        print(f"{page.relative_to(ROOT)!s:<44} {count:>6} {number:>9} {mean:>5.1f} {long:>7}")
        if names:
            for size, sentence in lengths(page.read_text(encoding="utf-8")):
                if size > LONGEST:
                    print(f"    {size} words: {sentence}")
    print(f"words of docs/ that are written by hand: {total}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
