"""The whole attack, counted by area and outcome: `python -m tests.attack [SHARE]`; a share of 1 is 130,000 inputs."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from tests.attack.files import checkpoints, files, journals, maps, policies
from tests.attack.outcomes import Case, Tally
from tests.attack.peers import messages
from tests.attack.scenarios import scenarios
from tests.towns.made import hostile
from wcsim.towns.scene_folders.build import build_scene, find_scene
from wcsim.towns.sumo.xml_io import read_bytes

SEED = 7


def all_cases(share: float, work: Path) -> Iterator[Iterable[Case]]:
    """Every generator with its count."""
    town = build_scene(find_scene("pedestrian-crossing"), work / "town")[0]
    streets = read_bytes(town.net), hostile.lane_of(town)

    def count(whole: int) -> int:
        return max(1, round(share * whole))

    yield messages.cases(count(20_000), SEED, work)
    yield messages.siege_cases(count(20_000), SEED, work)
    yield scenarios.cases(count(20_000), SEED, work)
    yield scenarios.started(count(500), SEED, work, *streets)
    yield maps.cases(count(8_000), SEED, work)
    yield files.cases(count(25_000), SEED, work)
    yield policies.cases(count(6_000), SEED, work)
    yield journals.cases(count(20_000), SEED, work)
    yield journals.cases(count(5_000), SEED, work, ("ledgers", "metrics", "events"))
    yield checkpoints.cases(count(5_000), SEED, work)


def main(words: list[str]) -> int:
    """Feed all, print the table and every defect; 1 when there is one."""
    share, tally = float(words[0]) if words else 1.0, Tally()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "town").mkdir()
        for cases in all_cases(share, Path(folder)):
            tally.run(cases)
            sys.stderr.write(f"{tally.total} inputs, {len(tally.defects)} defects\n")
    sys.stdout.write(tally.table() + "\n")
    for defect in tally.defects:
        sys.stdout.write(defect + "\n")
    return int(bool(tally.defects))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
