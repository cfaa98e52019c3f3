"""`python -m benchmarks sight`: pictures with questions for somebody who has not made them, and what is answered."""

from __future__ import annotations

import csv
import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.cli.shared.common import Bounds, OutFile, split_nonempty_list, write_json
from wcsim.cli.shared.consoles import print_note, stdout_console
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town

_KEY: Final = "key.json"
_NEAR: Final = {"distance": (0.2, 0.0), "speed": (0.0, 0.2)}  # what still counts as right: of the truth, and beside it


@dataclass
class SightOptions:
    """Draw items for a blind test of pictures, or count the right answers to them."""

    towns: str = "helsinki,monaco,manhattan"
    """Towns: each a town's name, its folder, or a .sumocfg file, separated by commas."""
    each: int = 7
    """Items of each question and town."""
    out: Path = Path("sight")
    """Folder for the pictures, the questions and, in key.json, the truth."""
    answers: Path | None = None
    """A table with the columns picture,answer: count what is right instead."""
    seed: int = 0
    """Seed of the traffic, of the moments and of the names of pictures."""
    json: OutFile = None
    """Write the counts to this file."""


def run(options: SightOptions) -> int:
    """Run it."""
    Bounds(1, 100).check("--each", options.each)
    if options.answers is not None:
        return _count(options)

    from benchmarks.sight.items import ASKED, items_of  # loads the simulators
    from wcsim.view.pictures import write_png

    options.out.mkdir(parents=True, exist_ok=True)
    names, key = np.random.default_rng(options.seed).permutation(10_000), dict[str, dict[str, str]]()
    lines = ["Each picture P.png is a street from behind a wheelchair; P-before.png is half a second earlier.", ""]
    for name in split_nonempty_list("--towns", options.towns):
        for item in items_of(find_town(name), options.each, options.seed):
            picture = f"{names[len(key)]:04d}"
            write_png(options.out / f"{picture}.png", item.picture)
            if item.before is not None:
                write_png(options.out / f"{picture}-before.png", item.before)
            key[picture] = {"question": item.question, "truth": item.truth, "town": name}
            print_note(f"{name}: {item.question}, {len(key)} items")
    lines += [f"{picture}: {ASKED[said['question']]}" for picture, said in sorted(key.items())]
    (options.out / "questions.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    write_json(options.out / _KEY, key)
    return 0


def _count(options: SightOptions) -> int:
    """Print how many answers are right, with Wilson's 95 % interval, and each that is wrong."""
    from scipy.stats import binomtest

    key = json.loads((options.out / _KEY).read_text(encoding="utf-8"))
    with Path(str(options.answers)).open(encoding="utf-8") as file:
        given = {row["picture"]: row["answer"].strip() for row in csv.DictReader(file)}
    if given.keys() != key.keys():
        raise ConfigError(f"{options.answers}: {len(given.keys() & key.keys())} of {len(key)} pictures have an answer")
    asked = Counter(said["question"] for said in key.values())
    right = Counter(said["question"] for name, said in key.items() if _is_right(said, given[name]))
    counts = {}
    for question, many in asked.items():
        low, high = binomtest(right[question], many).proportion_ci(method="wilson")
        counts[question] = {"right": right[question], "of": many, "low": round(low, 3), "high": round(high, 3)}
        stdout_console().print(f"{question}: {right[question]} of {many} ({low:.0%} to {high:.0%})")
    if options.json is not None:
        write_json(options.json, counts)
    return 0


def _is_right(said: dict[str, str], answer: str) -> bool:
    """Whether an answer is the truth, or near enough."""
    if said["question"] not in _NEAR:
        return answer.lower() == said["truth"].lower()
    (share, beside), truth = _NEAR[said["question"]], float(said["truth"])
    return abs(float(answer) - truth) <= share * truth + beside
