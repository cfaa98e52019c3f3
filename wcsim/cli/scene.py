"""`wcsim scene run | list | bless | new | make`: short street scenes, and their golden traces."""

from __future__ import annotations

import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional, arg

from wcsim.cli.shared.common import OutFile, Parts, WritableFile, run_subcommand, write_json
from wcsim.cli.shared.consoles import show_table
from wcsim.config import read_toml
from wcsim.config.scene import SceneExpectations, SceneFile
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import escape, pluralize
from wcsim.errors import ConfigError
from wcsim.scenes.template import write_scene
from wcsim.towns.scene_folders.build import GOLDEN, NETCONVERT_FILES, find_scene, list_scenes

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.scenes.meter import Facts

Scenes = Annotated[tuple[str, ...], Positional, arg(metavar="[SCENE ...]")]
HOME: Final = Path("scenarios") / "sumo" / "scenes"
_TRACE: Final = "new.trace"
# With a larger distance no road user was near.
_NEAR_M: Final = 50.0


@dataclass
class _RunOptions:
    """Run scenes (default: all); compare them with [expect] and golden traces."""

    scenes: Scenes = ()
    """Names or folders of scenes."""
    json: OutFile = None
    """Write the results to this file."""
    film: Annotated[Path | None, arg(metavar="FILE"), WritableFile(".webm")] = None
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
        "new": (_NewOptions, _new),
        "make": (_MakeOptions, _make),
    }
    return run_subcommand(words, "scene", parts)


def _run(options: _RunOptions) -> int:
    if options.film is not None and len(options.scenes) != 1:
        raise ConfigError(
            f"--film takes one scene, got {len(options.scenes)}; name the scene to film"
        )
    folders = _named_folders(options.scenes)
    outcomes = [_outcome(folder, name) for name, folder in folders]
    rows = []
    for each in outcomes:
        if each.faults:
            rows.append((each.name, "FAILS", "; ".join(each.faults)))
        else:
            result = "; ".join(filter(None, (_facts_text(each.facts), each.note)))
            rows.append((each.name, "ok", result))
    show_table(("scene", "", "result"), rows)
    write_json(
        options.json,
        {
            each.name: {
                "ok": not each.faults,
                "faults": list(each.faults),
                "note": each.note,
                **each.facts,
            }
            for each in outcomes
        },
    )
    if options.film is not None:
        # It takes seconds to load, and most runs need no film.
        from wcsim.scenes.run import film_scene

        ((name, folder),) = folders
        film_scene(folder, options.film)
        print(f"{options.film}: {name}")
    return 1 if any(outcome.faults for outcome in outcomes) else 0


def _named_folders(words: Scenes) -> list[tuple[str, Path]]:
    """The requested scenes, or all, each with the name under which its result is shown.

    That is the folder's name, by which a scene is found, or its path where two share the name.
    """
    folders = [find_scene(word) for word in words] if words else [*list_scenes()]
    names = [folder.resolve().name for folder in folders]
    return [
        (name if names.count(name) == 1 else str(folder), folder)
        for folder, name in zip(folders, names, strict=True)
    ]


def _list(_: _ListOptions) -> int:
    rows, broken = [], []
    for folder in list_scenes():
        try:
            scene = read_toml(folder / "scene.toml", SceneFile)
        except ConfigError as error:
            broken.append(str(error))
            continue
        shows = escape(scene.shows, 2000)
        rows.append((folder.name, f"{scene.duration_s:g}", str(len(scene.seats)), shows))
    show_table(("scene", "seconds", "chairs", "what it tests"), rows, show_lines=True)
    if broken:
        raise ConfigError("; ".join(broken))
    return 0


def _outcome(folder: Path, name: str) -> _Outcome:
    """Run a scene in a child, and compare it with its [expect] and its golden trace."""
    # These load the simulators, which --help must not.
    from wcsim.log.diff import explain_hash_mismatch, find_golden_difference
    from wcsim.scenes.run import run_in_child

    golden = folder / GOLDEN
    scene = read_toml(folder / "scene.toml", SceneFile)
    note = ""
    with create_temporary_folder() as work:
        trace = work / _TRACE
        facts = run_in_child(folder, trace)
        found = find_unmet_expectations(facts, scene.expect)
        if not golden.is_file():
            found += (
                "no golden trace; when the scene is right, save one: "
                f"wcsim scene bless {_shell_name(folder)}",
            )
        elif difference := find_golden_difference(trace, golden):
            found += (f"differs from the golden trace: {difference}",)
        else:
            note = explain_hash_mismatch(trace, golden)
    return _Outcome(name, facts, found, note)


def find_unmet_expectations(facts: Facts, expect: SceneExpectations) -> tuple[str, ...]:
    """Where what happened is not what the scene must show; empty when all is well."""
    found = []
    if expect.crashed is not None and facts["crashed"] != expect.crashed:
        found.append(f"crashed is {facts['crashed']}, expected {expect.crashed}")
    for name in SceneExpectations.model_fields:
        window = getattr(expect, name)
        if isinstance(window, tuple) and not window[0] <= facts[name] <= window[1]:
            found.append(f"{name} is {facts[name]:.3f}, expected {window[0]:g} to {window[1]:g}")
    return tuple(found)


def _bless(options: _BlessOptions) -> int:
    if not options.scenes:
        raise ConfigError(
            "no scene is named; expected those whose golden traces are to change: "
            "wcsim scene bless NAME"
        )
    folders = _named_folders(options.scenes)

    from wcsim.scenes.run import run_in_child  # loads the simulators, which --help must not

    for name, folder in folders:
        with create_temporary_folder() as work:
            trace, golden = work / _TRACE, folder / GOLDEN
            facts = run_in_child(folder, trace)
            reason = _bless_reason(trace, golden)
            if reason:
                shutil.copyfile(trace, golden)
            wrong = find_unmet_expectations(
                facts, read_toml(folder / "scene.toml", SceneFile).expect
            )
        result = f"blessed, {reason}" if reason else "unchanged"
        but = f"; but its [expect] fails: {'; '.join(wrong)}" if wrong else ""
        print(f"{name}: {result}; {_facts_text(facts)}{but}")
    return 0


def _bless_reason(trace: Path, golden: Path) -> str:
    """Why a golden trace must be written anew; "" when it need not."""
    from wcsim.log.diff import find_golden_difference
    from wcsim.log.reader import read_trace_states

    if not golden.is_file():
        return "no golden trace before"
    other_versions = read_trace_states(trace)[0] != read_trace_states(golden)[0]
    if difference := find_golden_difference(trace, golden):
        return difference
    return "the golden trace is of other versions" if other_versions else ""


def _new(options: _NewOptions) -> int:
    folder = write_scene(options.out, options.name)
    print(f"created {folder}; it runs as it is. Edit it, and look at the result:")
    _print_next_commands(folder, options.name)
    print(f"  wcsim scene bless {_shell_name(folder)}   when it is right; later runs must match")
    return 0


def _make(options: _MakeOptions) -> int:
    from wcsim.towns.scene_folders import families  # loads numba, which --help must not

    folder = families.write_scene(options.family, options.seed, options.out)
    print(f"created {folder}, a scene of the family {options.family}. Look at the result:")
    _print_next_commands(folder, folder.name)
    return 0


def _print_next_commands(folder: Path, film: str) -> None:
    """Print how to run a new scene, and how to open its street."""
    files: list[str] = []
    for option, kind in NETCONVERT_FILES:
        path = folder / f"street.{kind}.xml"
        if path.is_file():
            files += (option, str(path))
    print(f"  wcsim scene run {_shell_name(folder)} --film {shlex.quote(film)}.webm")
    print(f"  netedit {shlex.join(files)}")


def _shell_name(folder: Path) -> str:
    """A scene as a word of a command line: its name where that is enough, else its path."""
    known = folder.resolve() in [scene.resolve() for scene in list_scenes()]
    return shlex.quote(folder.name if known else str(folder))


def _facts_text(facts: Facts) -> str:
    crash = "crash" if facts["crashed"] else "no crash"
    nearest = "no road user near"
    if facts["closest_actor_m"] < _NEAR_M:
        nearest = f"closest {facts['closest_actor_m']:.2f} m"
    road_users = pluralize(int(facts["actors_seen"]), "road user")
    return (
        f"{crash}, {facts['travelled_m']:.1f} m, drop {facts['drop_m']:.2f} m, "
        f"roll {facts['max_roll_deg']:.1f} deg, pitch {facts['max_pitch_deg']:.1f} deg, "
        f"{nearest}, standing {facts['standing_s']:.1f} s, {road_users}"
    )
