"""What the subcommands share: parsing, bounds, machines that work, files that results go to."""

from __future__ import annotations

import inspect
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

from wcsim.config.load import presets, sets_key
from wcsim.core.files import can_be_written, nearest_existing, whole_file
from wcsim.core.reading import escaped, is_folder
from wcsim.errors import ConfigError, meant, nearest
from wcsim.server.workers.machines import LOCAL, Machines, require_address

T = TypeVar("T")
Repeated = Annotated[tuple[str, ...], UseAppendAction]
"""An option that may be given several times, once for each value."""

OutFolder = Annotated[Path | None, arg(metavar="FOLDER")]
"""A folder that is made, with a default of its own."""

TownWord = Annotated[str, Positional, arg(metavar="TOWN")]
"""A town, as the first word without a name."""

SomeTown = Annotated[str, Positional, arg(metavar="[TOWN]")]
"""The same, where it may be left out."""

InFile = Annotated[Path | None, arg(metavar="FILE")]
"""A file that is read."""

Cluster = Annotated[str, arg(metavar="ADDRESS")]
"""A Ray cluster."""

MAX_SEED = (1 << 31) - 1
MOST_JOBS = 256  # processes that a command may start


class OptionNote:
    """What an option takes, noted beside its type: `Annotated[int, Bounds(1, 64)]`."""

    def check(self, option: str, value: Any) -> None:
        """Raise ConfigError for what it does not take."""


@dataclass(frozen=True, slots=True)
class Bounds(OptionNote):
    """The least and the most of a number, and what it is a multiple of."""

    low: float
    high: float = math.inf
    step: int = 1

    def check(self, option: str, value: Any) -> None:
        """See `OptionNote`."""
        if not self.low <= value <= self.high:  # as NaN never is
            expected = (
                f"{self.low} or more" if math.isinf(self.high) else f"{self.low} to {self.high}"
            )
            raise ConfigError(f"{option} {value}: expected {expected}")
        if self.step > 1 and value % self.step:
            raise ConfigError(f"{option} {value}: expected a multiple of {self.step}")


@dataclass(frozen=True, slots=True, eq=False)
class Keys(OptionNote):
    """Keys of `--set`: those of some sections alone, or of all, and what to do instead of setting a key."""

    instead: Mapping[str, str]
    sections: tuple[str, ...] = ()

    def check(self, option: str, value: Any) -> None:
        """See `OptionNote`."""
        for text in value:
            key = next((key for key in self.instead if sets_key(text, key)), None)
            if key is not None:
                raise ConfigError(f"{option} {key}: is not used here; {self.instead[key]}")
            if self.sections and text.strip().partition(".")[0] not in self.sections:
                expected = " or ".join(f"[{section}]" for section in self.sections)
                raise ConfigError(f"{option} {escaped(text)}: expected a key of {expected}")


@dataclass(frozen=True, slots=True)
class Writes(OptionNote):
    """A file that can be written before the work begins, with its ending; missing folders are made later."""

    suffix: str = ""
    new: bool = False  # nothing is there yet

    def check(self, option: str, value: Any) -> None:
        """See `OptionNote`."""
        if self.suffix and value.suffix.lower() != self.suffix:
            raise ConfigError(f"{option} {value}: expected a file name that ends in {self.suffix}")
        if is_folder(value):
            raise ConfigError(f"{option} {value} is a folder; expected the name of a file")
        if self.new and os.path.lexists(value):
            raise ConfigError(f"{option} {escaped(value)} exists; expected the name of a new file")
        check_folder(option, value.parent)


@dataclass(frozen=True, slots=True, eq=False)
class Finds(OptionNote):
    """A name, or several, of what there must be: `find` raises where there is none; "" is no name."""

    find: Callable[[str], object]

    def check(self, option: str, value: Any) -> None:
        """See `OptionNote`."""
        for name in filter(None, (value,) if isinstance(value, str) else value):
            self.find(name)


OutFile = Annotated[Path | None, arg(metavar="FILE"), Writes()]
"""A file that is written only when it is named."""

Flag = Annotated[bool, FlagCreatePairsOff]
"""A switch that is off unless it is named."""

Jobs = Annotated[int, Bounds(1, MOST_JOBS)]
"""Processes that work at once."""


@dataclass(kw_only=True)
class SettingsOptions:
    """Settings over a preset."""

    preset: str = "quick"
    """Preset to start from: quick, laptop, best, reward, dqn or paper. Without a name: a table of all."""
    config: InFile = None
    """TOML file with settings that override the preset."""
    set: Repeated = ()
    """Setting as section.key=value; overrides preset and file."""


Worlds = Annotated[int | None, arg(metavar="N"), Bounds(1, MOST_JOBS)]
"""Worker processes; None for what `worlds_of` says."""

Lease = Annotated[float, arg(metavar="S"), Bounds(1.0, 86_400.0)]
"""Seconds without progress."""

Steps = Annotated[int | None, arg(metavar="N"), Bounds(1)]
"""Steps of a training by Q-learning in all; None for those of its settings."""

Parts = Mapping[str, tuple[type[Any], Callable[[Any], int]]]
"""The parts of a command by their words: the options of each, and what runs with them."""

_TOLD = 5
_MOST_UNASKED = 4  # of them where nobody said how many: each world takes a gigabyte


def parse(options: type[T], words: list[str], command: str, program: str = "wcsim") -> T:
    """Parse a subcommand's options; a mistake prints what was expected and exits with code 2.

    Raises ConfigError as the notes of the options do: of a file that cannot be written it is better to hear before
    the work than after it. So it does for an option that is a word without a name, such as TOWN.
    """
    _require_bare(options, words, command)
    if issubclass(options, SettingsOptions) and words[-1:] == ["--preset"]:
        print(presets(), end="")
        raise SystemExit(0)
    prog = f"{program} {command}"
    parsed = tyro.cli(
        options, args=words, prog=prog, description=inspect.getdoc(options), registry=_numbers()
    )
    for name, notes in _notes(options).items():
        value = getattr(parsed, name.replace("-", "_"))
        for note in (Bounds(0, MAX_SEED), *notes) if name == "seed" else notes:
            if value is not None and isinstance(note, OptionNote):
                note.check(f"--{name}", value)
    return parsed


def _notes(options: type) -> dict[str, tuple[Any, ...]]:
    """What is noted beside the type of each option, by the option's name."""
    hints = get_type_hints(options, include_extras=True)
    return {
        name.replace("_", "-"): getattr(hint, "__metadata__", ()) for name, hint in hints.items()
    }


def _require_bare(options: type, words: Sequence[str], command: str) -> None:
    """Refuse an option that is meant for what stands without a name: the parser knows none that is like it."""
    notes = _notes(options)
    for option in (word.partition("=")[0] for word in words if word.startswith("--")):
        name = option[2:] if option[2:] in notes else nearest(option[2:], notes)
        found = notes.get(name, ())
        if Positional in found:
            told = next((note.metavar for note in found if getattr(note, "metavar", None)), name)
            bare = re.findall(r"\w+", told)[0].upper()  # of [TOWN], or FILE [FILE ...]
            raise ConfigError(
                f"{option} is not an option of {command}; give {bare} without a name: wcsim {command} {bare}"
            )


def _numbers() -> tyro.constructors.ConstructorRegistry:
    """How options that are numbers are read: what is none is refused in words, not in those of Python's types."""
    known = tyro.constructors.ConstructorRegistry()

    @known.primitive_rule
    def number(
        info: tyro.constructors.PrimitiveTypeInfo,
    ) -> tyro.constructors.PrimitiveConstructorSpec[Any] | None:
        kinds = {item for item in (get_args(info.type) or (info.type,)) if item is not type(None)}
        if kinds not in ({int}, {float}):
            return None
        whole = kinds == {int}
        return tyro.constructors.PrimitiveConstructorSpec(
            nargs=1,
            metavar="INT" if whole else "FLOAT",
            instance_from_str=lambda words: _number(words[0], int if whole else float),
            is_instance=lambda value: (
                value is None or isinstance(value, int if whole else (int, float))
            ),
            str_from_instance=lambda value: [str(value)],
        )

    return known


def _number(word: str, kind: type[int | float]) -> float:
    try:
        return kind(word)
    except ValueError:
        expected = "a whole number, such as 1000" if kind is int else "a number, such as 2.5"
        raise ValueError(f"got {escaped(word, 40)!r}, expected {expected}") from None


def run_part(words: list[str], command: str, parts: Parts) -> int:
    """Run the part of a command that the first word names, or print what parts there are; returns the exit code.

    Args:
        words: What follows the command.
        command: Its name.
        parts: Its parts.

    Raises:
        ConfigError: The word is missing or unknown, or as `parse` and the part itself do.
    """
    name = words[0] if words else ""
    if name in parts:
        options, work = parts[name]
        return work(parse(options, words[1:], f"{command} {name}"))
    if name in ("-h", "--help"):
        lines = [
            f"  {word:<10}{(options.__doc__ or '').strip()}" for word, (options, _) in parts.items()
        ]
        print("\n".join([f"usage: wcsim {command} {'|'.join(parts)} [options]", "", *lines]))
        return 0
    got = f"unknown {command} command {name!r}" if words else f"{command} needs a command"
    near = meant(name, parts) if words else ""
    raise ConfigError(f"{got}; expected one of: {', '.join(parts)} (wcsim {command} --help){near}")


def words_of(text: str) -> tuple[str, ...]:
    """The items of a comma-separated option; empty ones are left out.

    >>> words_of("monaco, manhattan")
    ('monaco', 'manhattan')
    """
    return tuple(word.strip() for word in text.split(",") if word.strip())


def says(words: Sequence[str], option: str) -> bool:
    """Whether an option is among the words of a command, as `--option VALUE` or `--option=VALUE`."""
    return any(word == option or word.startswith(f"{option}=") for word in words)


def some_words(option: str, text: str) -> tuple[str, ...]:
    """The items of a comma-separated option. Raises ConfigError when there is none."""
    found = words_of(text)
    if not found:
        raise ConfigError(f"{option} {text!r}: expected one or more names, separated by commas")
    return found


def first_few(lines: Sequence[str], what: str) -> list[str]:
    """The first five lines, and how many more of `what` there are."""
    more = len(lines) - _TOLD
    return [*lines[:_TOLD], f"and {more} more {what}"] if more > 0 else list(lines)


def worlds_of(asked: int | None) -> int:
    """How many processes `--worlds` means: one for each core, 4 at the most, where nothing is said."""
    if asked is not None:
        return asked
    from wcsim.physics.sensors.drawing_threads import cores

    return min(cores(), _MOST_UNASKED)


def machines_of(cluster: str, asked: int | None, option: str) -> Machines:
    """The machines that somebody names.

    Args:
        cluster: As typed.
        asked: How many workers; None where nobody said: see `worlds_of`, and nodes of a cluster say it themselves.
        option: What that is called.

    Raises:
        ConfigError: There are none.
    """
    if not cluster:
        return Machines(count=worlds_of(asked))
    count = worlds_of(asked) if cluster == LOCAL else asked or 1
    if cluster != LOCAL and count > 1:
        raise ConfigError(
            f"{option} {count} and --cluster {cluster}: `ray start --num-cpus` sets the workers of a node "
            f"there; leave one of the two out"
        )
    require_address(cluster)
    return Machines(count=count, cluster=cluster)


def check_folder(option: str, folder: Path) -> None:
    """Make sure that a folder can be made or is there and can be written. Raises ConfigError."""
    if not can_be_written(folder):
        raise ConfigError(
            f"{option}: {escaped(nearest_existing(folder))} is not a folder that can be written to; choose another with "
            f"{option}"
        )


def write_json(path: Path | None, data: Any) -> None:
    """Write a result file, where one is asked for, at once or not at all; NaN and infinity never appear in it."""
    if path is None:
        return
    text = json_text(path, data)
    with result_file(path) as part:
        part.write_text(text, encoding="utf-8")


def json_text(path: Path, data: Any, indent: int | None = 2) -> str:
    """What goes into a result file. Raises ConfigError for NaN and infinity."""
    try:
        return json.dumps(data, indent=indent, allow_nan=False) + "\n"
    except ValueError as error:
        raise ConfigError(
            f"{path}: a result contains a number that is not finite ({error})"
        ) from None


@contextmanager
def result_file(path: Path) -> Iterator[Path]:
    """As `whole_file`, and says that it made a folder for it.

    Raises:
        ConfigError: Its folder cannot be made.
        DiskFullError: There is no room.
    """
    with told_if_made(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot be written ({error.strerror}); choose another place"
            ) from None
        with whole_file(path) as part:
            yield part


@contextmanager
def fresh_folders(folder: Path) -> Iterator[None]:
    """Leave no empty folders behind when the block fails."""
    fresh = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        yield
    except BaseException:
        for place in fresh:
            with suppress(OSError):  # somebody else has put something there
                place.rmdir()
        raise


@contextmanager
def told_if_made(path: Path) -> Iterator[None]:
    """Say at the end that a folder was made for a result, the outermost one: a mistyped one is noticed so."""
    missing = next((folder for folder in reversed(path.parents) if not folder.exists()), None)
    yield
    if missing is not None:
        print(f"note: made the folder {escaped(missing)}", file=sys.stderr)
