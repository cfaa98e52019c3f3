"""Lists of episodes: read, checked, hashed, and cut into the pieces of work that processes share."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.config import parse
from wcsim.config.suite import SuiteFile
from wcsim.core.reading import FileKind, escaped, is_file, read_json
from wcsim.errors import ConfigError, TownError
from wcsim.towns.making.asked_town import made_seed, made_town
from wcsim.towns.scenario.town import Town, content_hash, expanded, find_town

TIGHT: Final = "tight"  # the part whose towns are generated scenes
_LIST = FileKind(what="a list of test episodes", limit_bytes=64 << 20, error=ConfigError)
_SHIPPED = Path(__file__).parent / "lists"


@dataclass(frozen=True, slots=True, kw_only=True)
class Suite:
    """A list and what it hashes to."""

    file: SuiteFile
    sha256: str  # hex, over the list's content

    @property
    def episodes(self) -> int:
        """How many there are."""
        return sum(len(block.episodes) for block in self.file.blocks)


def shipped() -> tuple[str, ...]:
    """The sets that come with wcsim."""
    return tuple(sorted(path.stem for path in _SHIPPED.glob("*.json")))


def open_suite(name_or_path: str) -> Suite:
    """A set that comes with wcsim, or a list at a path. Raises ConfigError when it is none, or broken."""
    path = _SHIPPED / f"{name_or_path}.json" if name_or_path in shipped() else expanded(name_or_path)
    if not is_file(path):
        known = ", ".join(shipped()) or "(none)"
        raise ConfigError(f"--suite {escaped(name_or_path)!r}: there is no such list; expected {known}, or a file")
    return suite_of(parse(SuiteFile, read_json(path, _LIST), escaped(path)))


def suite_of(file: SuiteFile) -> Suite:
    """A list with its hash."""
    return Suite(file=file, sha256=hashlib.sha256(_canonical(file.model_dump(mode="json"))).hexdigest())


def _canonical(data: object) -> bytes:
    """The one spelling of plain data that is hashed."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def write_list(file: SuiteFile, path: Path) -> None:
    """Write a list, an episode a line, so that a change shows in a diff. Raises OSError."""
    head = file.model_dump(mode="json", exclude={"blocks"})
    lines = [json.dumps(head)[:-1] + ', "blocks": [']
    blocks = list(file.blocks)
    for number, block in enumerate(blocks):
        said = json.dumps(block.model_dump(mode="json", exclude={"episodes"}))[:-1]
        episodes = ",\n  ".join(json.dumps(episode.model_dump(mode="json")) for episode in block.episodes)
        lines.append(f'{said}, "episodes": [\n  {episodes}]}}{"," if number + 1 < len(blocks) else "]}"}')
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def towns_of(file: SuiteFile, folder: Path) -> dict[str, Town]:
    """The list's towns, by name; those made of a seed are made in `folder`, if they are not there.

    Raises:
        TownError: One is missing, or is another than that of the list.
        SumoError: One of SUMO's tools failed at a made one.
    """
    found = {}
    for wanted in file.towns:
        town = find_town(wanted.name) if wanted.made_seed is None else made_town(folder, wanted.made_seed)
        got = content_hash(town)
        if got != wanted.sha256:
            raise TownError(
                f"town {wanted.name} has the hash {got[:12]}; expected {wanted.sha256[:12]}, for which the list "
                f"{file.suite} {file.set} was made: make your own list with --make-suite {wanted.name}"
            )
        found[wanted.name] = town
    return found


def asked_towns(words: str, folder: Path) -> list[tuple[Town, int | None]]:
    """The towns of `--make-suite`, joined by commas, each with the seed that it was made of; `made:7` is made now.

    Raises:
        ConfigError: A seed is none.
        TownError: There is no such town, or it cannot be made.
    """
    words_seeds = [(word.strip(), made_seed(word.strip())) for word in words.split(",")]
    return [(find_town(word) if seed is None else made_town(folder, seed), seed) for word, seed in words_seeds]


def require_towns(file: SuiteFile) -> None:
    """Raises ConfigError for a block in a town that the list does not name."""
    named = {town.name for town in file.towns}
    for block in file.blocks:
        if block.part != TIGHT and block.town not in named:
            raise ConfigError(f"a block is in town {block.town!r}; expected one of {sorted(named)}: add it to `towns`")


def block_key(suite: Suite, index: int, policy: str) -> str:
    """What the result of a block depends on: its list, its place in it, and the policy's digest."""
    return hashlib.sha256(_canonical([suite.file.suite, suite.sha256, index, policy])).hexdigest()
