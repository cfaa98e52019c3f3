"""`wcsim scene run | list | bless | new | make`: short street scenes with a fixed seed, and their golden traces."""

from __future__ import annotations

import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from wcsim.cli.shared.common import OutFile, Parts, Writes, run_part, write_json
from wcsim.cli.shared.consoles import show_table
from wcsim.config import read_toml
from wcsim.config.scene import SceneFile
from wcsim.core.own_folder import temporary_folder
from wcsim.core.reading import counted, escaped
from wcsim.errors import ConfigError
from wcsim.scenes.facts import Facts, faults
from wcsim.scenes.template import write_scene
from wcsim.towns.scene_folders.build import GOLDEN, NETCONVERT_FILES, find_scene, list_scenes

Scenes = Annotated[tuple[str, ...], Positional, arg(metavar="[SCENE ...]")]
HOME = Path("scenarios") / "sumo" / "scenes"


@dataclass
class _RunOptions:
    """Run scenes (default: all); compare them with [expect] and golden traces."""

    scenes: Scenes = ()
    """Names or folders of scenes."""
    json: OutFile = None
    """Write the results to this file."""
    film: Annotated[Path | None, arg(metavar="FILE"), Writes(".webm")] = None
    """Write a video (WebM) of the scene to this file; one scene must be named."""


@dataclass
class _BlessOptions:
    """Run scenes and save the result as their golden traces; print the changes."""

    scenes: Scenes = ()
    """Names or folders of scenes."""


@dataclass
class _ListOptions:
    """List the scenes and what each one tests."""


@dataclass
class _NewOptions:
    """Create a small scene that runs as it is, as a template for your own."""

    name: Annotated[str, Positional, arg(metavar="NAME")]
    """Name of the scene and its folder."""
    out: Annotated[Path, arg(metavar="FOLDER")] = HOME
    """Where the scene's folder is created; scenes in the default folder are found by name."""


@dataclass
class _MakeOptions:
    """Generate a scene of a family from a seed: a hazard and a recorded joystick."""

    family: Annotated[str, Positional, arg(metavar="FAMILY")]
    """One of the families listed in docs/authoring.md."""
    out: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to create."""
    seed: int = 0
    """Seed of places, times, speeds and the side; the same seed writes the same files."""


@dataclass(frozen=True, slots=True)
class _Outcome:
    """How a scene ended."""

    name: str
    facts: Facts
    faults: tuple[str, ...]
    note: str


def run(words: list[str]) -> int:
    """Run one of the subcommands."""
    parts: Parts = {
        "run": (_RunOptions, _run),
        "list": (_ListOptions, _list),
        "bless": (_BlessOptions, _bless),
    }
    return run_part(
        words, "scene", {**parts, "new": (_NewOptions, _new), "make": (_MakeOptions, _make)}
    )


def _folders(names: tuple[str, ...]) -> tuple[Path, ...]:
    return tuple(find_scene(name) for name in names) if names else list_scenes()


def _names(folders: tuple[Path, ...]) -> tuple[str, ...]:
    """What their results are told under: the folder's name, by which a scene is found; its path where two share it."""
    names = [folder.resolve().name for folder in folders]
    pairs = zip(folders, names, strict=True)
    return tuple(name if names.count(name) == 1 else str(folder) for folder, name in pairs)


def _list(_: _ListOptions) -> int:
    rows, broken = [], []
    for folder in list_scenes():
        try:
            scene = read_toml(folder / "scene.toml", SceneFile)
        except ConfigError as error:
            broken.append(str(error))
            continue
        rows.append(
            (
                folder.name,
                f"{scene.duration_s:g}",
                str(len(scene.seats)),
                escaped(scene.shows, 2000),
            )
        )
    show_table(("scene", "seconds", "chairs", "what it tests"), rows, show_lines=True)
    if broken:
        raise ConfigError("; ".join(broken))
    return 0


def _run(options: _RunOptions) -> int:
    if options.film is not None and len(options.scenes) != 1:
        raise ConfigError(
            f"--film takes one scene, got {len(options.scenes)}; name the scene to film"
        )
    folders = _folders(options.scenes)
    outcomes = [
        _outcome(folder, name) for folder, name in zip(folders, _names(folders), strict=True)
    ]
    rows = (
        (each.name, "FAILS", "; ".join(each.faults))
        if each.faults
        else (each.name, "ok", "; ".join(filter(None, (_words(each.facts), each.note))))
        for each in outcomes
    )
    show_table(("scene", "", "result"), rows)
    write_json(
        options.json,
        {
            o.name: {"ok": not o.faults, "faults": list(o.faults), "note": o.note, **o.facts}
            for o in outcomes
        },
    )
    if options.film is not None:
        from wcsim.scenes.run import (
            film_scene,
        )  # it takes seconds to load, and most runs need no film

        film_scene(folders[0], options.film)
        print(f"{options.film}: {outcomes[0].name}")
    return 1 if any(outcome.faults for outcome in outcomes) else 0


def _outcome(folder: Path, name: str) -> _Outcome:
    from wcsim.log.diff import (
        golden_difference,
        golden_note,
    )  # loads the simulators, which --help must not
    from wcsim.scenes.run import run_in_child

    note, scene = "", read_toml(folder / "scene.toml", SceneFile)
    with temporary_folder() as work:
        trace = work / "new.trace"
        facts = run_in_child(folder, trace)
        found = faults(facts, scene.expect)
        golden = folder / GOLDEN
        if not golden.is_file():
            found += (
                f"no golden trace; when the scene is right, save one: wcsim scene bless {_called(folder)}",
            )
        else:
            told = golden_difference(trace, golden)
            found += (f"differs from the golden trace: {told}",) if told else ()
            note = "" if told else golden_note(trace, golden)
    return _Outcome(name, facts, found, note)


def _bless(options: _BlessOptions) -> int:
    if not options.scenes:
        raise ConfigError(
            "no scene is named; expected those whose golden traces are to change: wcsim scene bless NAME"
        )
    folders = _folders(options.scenes)

    from wcsim.scenes.run import run_in_child  # loads the simulators, which --help must not

    for folder, name in zip(folders, _names(folders), strict=True):
        with temporary_folder() as work:
            trace = work / "new.trace"
            facts = run_in_child(folder, trace)
            golden = folder / GOLDEN
            told = _news(trace, golden)
            if told:
                shutil.copyfile(trace, golden)
            wrong = faults(facts, read_toml(folder / "scene.toml", SceneFile).expect)
            but = f"; but its [expect] fails: {'; '.join(wrong)}" if wrong else ""
            print(f"{name}: {'blessed, ' + told if told else 'unchanged'}; {_words(facts)}{but}")
    return 0


def _news(trace: Path, golden: Path) -> str:
    """Why a golden trace must be written anew; "" when it need not."""
    from wcsim.log.diff import golden_difference
    from wcsim.log.reader import read_states

    if not golden.is_file():
        return "no golden trace before"
    other_versions = read_states(trace)[0] != read_states(golden)[0]
    return golden_difference(trace, golden) or (
        "the golden trace is of other versions" if other_versions else ""
    )


def _new(options: _NewOptions) -> int:
    folder = write_scene(options.out, options.name)
    called = _called(folder)
    print(f"created {folder}; it runs as it is. Edit it, and look at the result:")
    _print_ways_in(folder, options.name)
    print(f"  wcsim scene bless {called}   when it is right; later runs must match")
    return 0


def _make(options: _MakeOptions) -> int:
    from wcsim.towns.scene_folders import families  # loads numba, which --help must not

    folder = families.write_scene(options.family, options.seed, options.out)
    print(f"created {folder}, a scene of the family {options.family}. Look at the result:")
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


def _words(facts: Facts) -> str:
    nearest = (
        f"closest {facts['closest_actor_m']:.2f} m"
        if facts["closest_actor_m"] < 50.0
        else "no road user near"
    )
    return (
        f"{'crash' if facts['crashed'] else 'no crash'}, {facts['travelled_m']:.1f} m, drop {facts['drop_m']:.2f} m, "
        f"roll {facts['max_roll_deg']:.1f} deg, pitch {facts['max_pitch_deg']:.1f} deg, "
        f"{nearest}, standing {facts['standing_s']:.1f} s, {counted(int(facts['actors_seen']), 'road user')}"
    )
