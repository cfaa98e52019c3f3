"""`wcsim scene run | list | bless | new | make`: short street scenes with a fixed seed, and their golden traces."""

from __future__ import annotations

import shlex
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table
from rich.text import Text

from wcsim.cli.shared.common import OutFile, check_output, parse, subcommand, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.config import read_toml
from wcsim.config.scene import SceneFile
from wcsim.core.reading import shown
from wcsim.errors import ConfigError
from wcsim.scenes.facts import SceneFacts, facts_of, faults
from wcsim.scenes.template import write_scene
from wcsim.towns.scene_folders.build import GOLDEN, NETCONVERT_FILES, find_scene, list_scenes

Scenes = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[SCENE ...]")]
HOME = Path("scenarios") / "sumo" / "scenes"


@dataclass
class RunOptions:
    """Run scenes (all of them when none is named) and compare them with what they must show and their golden traces."""

    scenes: Scenes = ()
    """Names or folders of scenes."""
    json: OutFile = None
    """Write the results to this file."""
    film: OutFile = None
    """Write a video (WebM) of the scene to this file; one scene must be named."""


@dataclass
class BlessOptions:
    """Run scenes and make what they do now their golden traces; prints what changed."""

    scenes: Scenes = ()
    """Names or folders of scenes."""


@dataclass
class ListOptions:
    """List the scenes and what each shows."""


@dataclass
class NewOptions:
    """Write a small scene that runs as it is, as a beginning for one's own."""

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """What the scene and its folder are called."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = HOME
    """Where the scene's folder is made; scenes in the default place are found by name."""


@dataclass
class SceneMakeOptions:
    """Write a scene that a seed draws from a family: a danger that a helper can avoid, and a recorded joystick."""

    family: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FAMILY")]
    """Which family, as docs/authoring.md lists them."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """The folder to make."""
    seed: int = 0
    """Draws places, times, speeds and the side; the same seed writes the same files."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a scene ended."""

    name: str
    facts: SceneFacts
    faults: tuple[str, ...]


def run(words: list[str]) -> int:
    """Run one of the subcommands."""
    known = {"run": RunOptions, "list": ListOptions, "bless": BlessOptions, "new": NewOptions, "make": SceneMakeOptions}
    name = subcommand(words, "scene", known, known.__getitem__)
    if name == "list":
        parse(ListOptions, words[1:], "scene list")
        return _list()
    if name == "run":
        return _run(parse(RunOptions, words[1:], "scene run"))
    if name == "new":
        return _new(parse(NewOptions, words[1:], "scene new"))
    if name == "make":
        return _make(parse(SceneMakeOptions, words[1:], "scene make"))
    return _bless(parse(BlessOptions, words[1:], "scene bless")) if name else 0


def _folders(names: tuple[str, ...]) -> tuple[Path, ...]:
    return tuple(find_scene(name) for name in names) if names else list_scenes()


def _names(folders: tuple[Path, ...]) -> tuple[str, ...]:
    """What their results are told under: the folder's name, by which a scene is found; its path where two share it."""
    names = [folder.resolve().name for folder in folders]
    pairs = zip(folders, names, strict=True)
    return tuple(name if names.count(name) == 1 else str(folder) for folder, name in pairs)


def _list() -> int:
    table = Table("scene", "seconds", "chairs", "shows", show_lines=True)
    broken = []
    for folder in list_scenes():
        try:
            scene = read_toml(folder / "scene.toml", SceneFile)
        except ConfigError as error:
            broken.append(str(error))
            continue
        table.add_row(folder.name, f"{scene.duration_s:g}", str(len(scene.seats)), Text(shown(scene.shows, 2000)))
    stdout_console().print(table)
    if broken:
        raise ConfigError("; ".join(broken))
    return 0


def _run(options: RunOptions) -> int:
    check_output("--film", options.film, ".webm")
    if options.film is not None and len(options.scenes) != 1:
        raise ConfigError(f"--film shows one scene, got {len(options.scenes)}; name the one to film")
    folders = _folders(options.scenes)
    outcomes = [_outcome(folder, name) for folder, name in zip(folders, _names(folders), strict=True)]
    table = Table("scene", "", "what happened")
    for outcome in outcomes:
        told = "; ".join(outcome.faults) or _words(outcome.facts)
        table.add_row(outcome.name, "FAILS" if outcome.faults else "ok", Text(told))
    stdout_console().print(table)
    if options.json is not None:
        write_json(
            options.json,
            {o.name: {"ok": not o.faults, "faults": list(o.faults), **facts_of(o.facts)} for o in outcomes},
        )
    if options.film is not None:
        from wcsim.scenes.film import film_scene  # it takes seconds to load, and most runs need no film

        film_scene(folders[0], options.film)
        print(f"{options.film}: {outcomes[0].name}")
    return 1 if any(outcome.faults for outcome in outcomes) else 0


def _outcome(folder: Path, name: str) -> Outcome:
    from wcsim.bridge.recording.trace_diff import difference  # loads the simulators, which --help must not
    from wcsim.scenes.run import run_in_child

    scene = read_toml(folder / "scene.toml", SceneFile)
    with tempfile.TemporaryDirectory(prefix="wcsim-trace-") as work:
        trace = Path(work) / "new.trace"
        facts = run_in_child(folder, trace)
        found = faults(facts, scene.expect)
        golden = folder / GOLDEN
        if not golden.is_file():
            found += (
                f"there is no golden trace; when the scene is right, make one: wcsim scene bless {_called(folder)}",
            )
        else:
            told = difference(trace, golden)
            found += (f"differs from the golden trace: {told}",) if told else ()
    return Outcome(name, facts, found)


def _bless(options: BlessOptions) -> int:
    folders = _folders(options.scenes)

    from wcsim.scenes.run import run_in_child  # loads the simulators, which --help must not

    for folder, name in zip(folders, _names(folders), strict=True):
        with tempfile.TemporaryDirectory(prefix="wcsim-trace-") as work:
            trace = Path(work) / "new.trace"
            facts = run_in_child(folder, trace)
            golden = folder / GOLDEN
            told = _news(trace, golden)
            if told:
                shutil.copyfile(trace, golden)
            wrong = faults(facts, read_toml(folder / "scene.toml", SceneFile).expect)
            but = f"; it does not show what it must: {'; '.join(wrong)}" if wrong else ""
            print(f"{name}: {'blessed, ' + told if told else 'unchanged'}; {_words(facts)}{but}")
    return 0


def _news(trace: Path, golden: Path) -> str:
    """Why a golden trace must be written anew; "" when it need not."""
    from wcsim.bridge.recording.trace_diff import difference
    from wcsim.bridge.recording.trace_file import read_trace

    if not golden.is_file():
        return "there was no golden trace"
    other_versions = read_trace(trace)[0] != read_trace(golden)[0]
    return difference(trace, golden) or ("it was made by other versions" if other_versions else "")


def _new(options: NewOptions) -> int:
    folder = write_scene(options.out, options.name)
    called = _called(folder)
    print(f"{folder}: a scene that runs as it is; change it, and look at what it does:")
    _print_ways_in(folder, options.name)
    print(f"  wcsim scene bless {called}   when it is right: from then on a run fails that differs")
    return 0


def _make(options: SceneMakeOptions) -> int:
    from wcsim.towns.scene_folders.families import catalogue  # loads numba, which --help must not

    folder = catalogue.write_scene(options.family, options.seed, options.out)
    print(f"{folder}: a scene of the family {options.family}; look at what becomes of it:")
    _print_ways_in(folder, folder.name)
    return 0


def _print_ways_in(folder: Path, film: str) -> None:
    named = [(option, folder / f"street.{kind}.xml") for option, kind in NETCONVERT_FILES]
    files = [word for option, path in named if path.is_file() for word in (option, str(path))]
    print(f"  wcsim scene run {_called(folder)} --film {shlex.quote(film)}.webm")
    print(f"  netedit {shlex.join(files)}")


def _called(folder: Path) -> str:
    """What to call a scene on the command line: its name where that is enough."""
    known = folder.resolve() in [scene.resolve() for scene in list_scenes()]
    return shlex.quote(folder.name if known else str(folder))


def _words(facts: SceneFacts) -> str:
    nearest = f"closest {facts.closest_actor_m:.2f} m" if facts.closest_actor_m < 50.0 else "nobody near"
    return (
        f"{'crash' if facts.crashed else 'no crash'}, {facts.travelled_m:.1f} m, drop {facts.drop_m:.2f} m, "
        f"roll {facts.max_roll_deg:.1f} deg, pitch {facts.max_pitch_deg:.1f} deg, "
        f"{nearest}, standing {facts.standing_s:.1f} s, {facts.actors_seen} actors"
    )
