"""`wcsim scene run | list | bless`: short street scenes with a fixed seed, compared with their golden traces."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from wcsim.bridge.scene import GOLDEN, run_in_child
from wcsim.bridge.scene_facts import SceneFacts, facts_of, faults
from wcsim.bridge.trace import read_trace
from wcsim.bridge.trace_diff import difference
from wcsim.cli.common import OutFile, parse, subcommand, write_json
from wcsim.config import SceneFile, read_toml
from wcsim.towns.scenes import find_scene, list_scenes

Scenes = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[SCENE ...]")]


@dataclass
class RunOptions:
    """Run scenes (all of them when none is named) and compare them with what they must show and their golden traces."""

    scenes: Scenes = ()
    """Names or folders of scenes."""
    json: OutFile = None
    """Write the results to this file."""


@dataclass
class BlessOptions:
    """Run scenes and make what they do now their golden traces; prints what changed."""

    scenes: Scenes = ()
    """Names or folders of scenes."""


@dataclass
class ListOptions:
    """List the scenes and what each shows."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a scene ended."""

    name: str
    facts: SceneFacts
    faults: tuple[str, ...]


def run(words: list[str]) -> int:
    """Run one of the subcommands."""
    name = subcommand(words, "scene", {"run": RunOptions, "list": ListOptions, "bless": BlessOptions})
    if name == "list":
        parse(ListOptions, words[1:], "scene list")
        return _list()
    if name == "run":
        return _run(parse(RunOptions, words[1:], "scene run"))
    return _bless(parse(BlessOptions, words[1:], "scene bless")) if name else 0


def _folders(names: tuple[str, ...]) -> tuple[Path, ...]:
    return tuple(find_scene(name) for name in names) if names else list_scenes()


def _list() -> int:
    table = Table("scene", "shows")
    for folder in list_scenes():
        scene = read_toml(folder / "scene.toml", SceneFile)
        table.add_row(scene.name, scene.shows)
    Console().print(table)
    return 0


def _run(options: RunOptions) -> int:
    outcomes = []
    for folder in _folders(options.scenes):
        with tempfile.TemporaryDirectory(prefix="wcsim-trace-") as work:
            outcomes.append(_outcome(folder, Path(work) / "new.trace"))
    table = Table("scene", "", "what happened")
    for outcome in outcomes:
        told = "; ".join(outcome.faults) or _words(outcome.facts)
        table.add_row(outcome.name, "FAILS" if outcome.faults else "ok", told)
    Console().print(table)
    if options.json is not None:
        write_json(
            options.json,
            {o.name: {"ok": not o.faults, "faults": list(o.faults), **facts_of(o.facts)} for o in outcomes},
        )
    return 1 if any(outcome.faults for outcome in outcomes) else 0


def _outcome(folder: Path, trace: Path) -> Outcome:
    scene = read_toml(folder / "scene.toml", SceneFile)
    facts = run_in_child(folder, trace)
    found = faults(facts, scene.expect)
    golden = folder / GOLDEN
    if not golden.is_file():
        found += (f"there is no golden trace; make one: wcsim scene bless {scene.name}",)
    else:
        told = difference(trace, golden)
        found += (f"differs from the golden trace: {told}",) if told else ()
    return Outcome(scene.name, facts, found)


def _bless(options: BlessOptions) -> int:
    for folder in _folders(options.scenes):
        with tempfile.TemporaryDirectory(prefix="wcsim-trace-") as work:
            trace = Path(work) / "new.trace"
            facts = run_in_child(folder, trace)
            golden = folder / GOLDEN
            told = _news(trace, golden)
            if told:
                shutil.copyfile(trace, golden)
            print(f"{folder.name}: {'blessed, ' + told if told else 'unchanged'}; {_words(facts)}")
    return 0


def _news(trace: Path, golden: Path) -> str:
    """Why a golden trace must be written anew; "" when it need not."""
    if not golden.is_file():
        return "there was no golden trace"
    other_versions = read_trace(trace)[0] != read_trace(golden)[0]
    return difference(trace, golden) or ("it was made by other versions" if other_versions else "")


def _words(facts: SceneFacts) -> str:
    nearest = f"closest {facts.closest_actor_m:.2f} m" if facts.actors_seen else "nobody near"
    return (
        f"{'crash' if facts.crashed else 'no crash'}, {facts.travelled_m:.1f} m, drop {facts.drop_m:.2f} m, "
        f"roll {facts.max_roll_deg:.1f} deg, pitch {facts.max_pitch_deg:.1f} deg, "
        f"{nearest}, standing {facts.standing_s:.1f} s, {facts.actors_seen} actors"
    )
