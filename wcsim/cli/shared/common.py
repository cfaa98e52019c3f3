"""What commands share: options, their bounds and parsing, machines, pages, files for results."""

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
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar, get_args, get_type_hints

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

from wcsim.core.files import find_existing_ancestor, is_writable_folder, write_file_atomically
from wcsim.core.reading import escape, is_folder
from wcsim.errors import ConfigError, meant, nearest

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.drive.playing.play_runner import PlayStart
    from wcsim.drive.runner import DriveOrder
    from wcsim.server.workers.machines import WorkerPoolSettings

MAX_SEED: Final = (1 << 31) - 1

# Processes that a command may start.
MOST_JOBS: Final = 256

# Lines of a list that a message prints.
_MOST_LINES: Final = 5

# Worlds where --worlds is not given: each takes a gigabyte.
_USUAL_WORLDS: Final = 4

T = TypeVar("T")


Repeated = Annotated[tuple[str, ...], UseAppendAction]
"""An option that may be given several times, once for each value."""
OutFolder = Annotated[Path | None, arg(metavar="FOLDER")]
"""A folder that is made, with a default of its own."""
TownWord = Annotated[str, Positional, arg(metavar="TOWN")]
"""A town, as the first word without a name."""
SomeTown = Annotated[str, Positional, arg(metavar="[TOWN]")]
"""A town as the first word without a name; it may be left out."""
InFile = Annotated[Path | None, arg(metavar="FILE")]
"""A file that is read."""
Cluster = Annotated[str, arg(metavar="ADDRESS")]
"""A Ray cluster."""
Flag = Annotated[bool, FlagCreatePairsOff]
"""A switch that is off unless it is named."""
Parts = Mapping[str, tuple[type[Any], Callable[[Any], int]]]
"""The parts of a command by their words: the options of each, and what runs with them."""


class OptionConstraint:
    """What an option takes, noted beside its type: `Annotated[int, Bounds(1, 64)]`."""

    def check(self, option: str, value: Any) -> None:
        """Raise ConfigError for a value that the option does not take."""


@dataclass(frozen=True, slots=True)
class Bounds(OptionConstraint):
    """The least and the most of a number, and what it is a multiple of."""

    low: float
    high: float = math.inf
    step: int = 1

    def check(self, option: str, value: Any) -> None:
        """See `OptionConstraint`."""
        # NaN is in no range, and so it is refused, too.
        if not self.low <= value <= self.high:
            unbounded = math.isinf(self.high)
            expected = f"{self.low} or more" if unbounded else f"{self.low} to {self.high}"
            raise ConfigError(f"{option} {value}: expected {expected}")
        if self.step > 1 and value % self.step:
            raise ConfigError(f"{option} {value}: expected a multiple of {self.step}")


@dataclass(frozen=True, slots=True, eq=False)
class AllowedSettingKeys(OptionConstraint):
    """Keys of `--set`: the sections that are allowed, and what to do instead of setting a key."""

    instead: Mapping[str, str]
    sections: tuple[str, ...] = ()

    def check(self, option: str, value: Any) -> None:
        """See `OptionConstraint`."""
        from wcsim.config.load import is_override_of_key

        for text in value:
            for key, advice in self.instead.items():
                if is_override_of_key(text, key):
                    raise ConfigError(f"{option} {key}: is not used here; {advice}")
            if self.sections and text.strip().partition(".")[0] not in self.sections:
                expected = " or ".join(f"[{section}]" for section in self.sections)
                raise ConfigError(f"{option} {escape(text)}: expected a key of {expected}")


@dataclass(frozen=True, slots=True)
class WritableFile(OptionConstraint):
    """A file that can be written, with its ending; missing folders are made later."""

    suffix: str = ""
    new: bool = False  # nothing is there yet

    def check(self, option: str, value: Any) -> None:
        """See `OptionConstraint`."""
        if self.suffix and value.suffix.lower() != self.suffix:
            raise ConfigError(f"{option} {value}: expected a file name that ends in {self.suffix}")
        if is_folder(value):
            raise ConfigError(f"{option} {value} is a folder; expected the name of a file")
        if self.new and os.path.lexists(value):
            raise ConfigError(f"{option} {escape(value)} exists; expected the name of a new file")
        require_writable_folder(option, value.parent)


@dataclass(frozen=True, slots=True, eq=False)
class ExistingName(OptionConstraint):
    """One or more names of things that exist: `find` raises where there is none; "" is no name."""

    find: Callable[[str], object]

    def check(self, option: str, value: Any) -> None:
        """See `OptionConstraint`."""
        for name in (value,) if isinstance(value, str) else value:
            if name:
                self.find(name)


OutFile = Annotated[Path | None, arg(metavar="FILE"), WritableFile()]
"""A file that is written only when it is named."""


Jobs = Annotated[int, Bounds(1, MOST_JOBS)]
"""Processes that work at once."""

Worlds = Annotated[int | None, arg(metavar="N"), Bounds(1, MOST_JOBS)]
"""Worker processes; None for the usual number, see `resolve_worker_count`."""

Lease = Annotated[float, arg(metavar="S"), Bounds(1.0, 86_400.0)]
"""Seconds without progress."""

Seat = Annotated[int | None, Bounds(0, 1 << 30)]
"""The number of a chair; None for the first."""

Steps = Annotated[int | None, arg(metavar="N"), Bounds(1)]
"""Steps of a training by Q-learning in all; None for those of its settings."""


@dataclass(kw_only=True)
class SettingsOptions:
    """Settings over a preset."""

    preset: str = "quick"
    """Preset to start from: quick, laptop, best, reward, dqn or paper. Without a name: a table of all."""  # noqa: E501 - help text
    config: InFile = None
    """TOML file with settings that override the preset."""
    set: Repeated = ()
    """Setting as section.key=value; overrides preset and file."""


@dataclass(kw_only=True)
class WebPageOptions:
    """Where a page is served."""

    port: Annotated[int, Bounds(0, 65535)] = 8080
    """Port of the page; 0 takes a free one."""
    host: str = "127.0.0.1"
    """Address to serve at; any but the loopback needs the token in the printed address."""


def parse_options(options: type[T], words: list[str], command: str, program: str = "wcsim") -> T:
    """Parse a subcommand's options; a mistake prints what was expected and exits with code 2.

    Raises:
        ConfigError: A value is not what the option's note takes, such as a file that cannot be
            written; or an option stands for a word without a name, such as TOWN.
    """
    _require_bare(options, words, command)
    if issubclass(options, SettingsOptions) and words[-1:] == ["--preset"]:
        from wcsim.config.load import format_presets_table

        print(format_presets_table(), end="")
        raise SystemExit(0)
    prog = f"{program} {command}"
    parsed = tyro.cli(
        options, args=words, prog=prog, description=inspect.getdoc(options), registry=_numbers()
    )
    for name, notes in _notes(options).items():
        value = getattr(parsed, name.replace("-", "_"))
        if value is None:
            continue
        for note in (Bounds(0, MAX_SEED), *notes) if name == "seed" else notes:
            if isinstance(note, OptionConstraint):
                note.check(f"--{name}", value)
    return parsed


def _notes(options: type) -> dict[str, tuple[Any, ...]]:
    """What is noted beside the type of each option, by the option's name."""
    hints = get_type_hints(options, include_extras=True)
    return {
        name.replace("_", "-"): getattr(hint, "__metadata__", ()) for name, hint in hints.items()
    }


def _require_bare(options: type, words: Sequence[str], command: str) -> None:
    """Refuse an option that is meant for a word without a name: the parser knows no similar one."""
    notes = _notes(options)
    for option in (word.partition("=")[0] for word in words if word.startswith("--")):
        name = option[2:] if option[2:] in notes else nearest(option[2:], notes)
        found = notes.get(name, ())
        if Positional in found:
            metavars = [note.metavar for note in found if getattr(note, "metavar", None)]
            # The word itself, of [TOWN], or FILE [FILE ...].
            bare = re.findall(r"\w+", metavars[0] if metavars else name)[0].upper()
            raise ConfigError(
                f"{option} is not an option of {command}; give {bare} without a name: "
                f"wcsim {command} {bare}"
            )


def _numbers() -> tyro.constructors.ConstructorRegistry:
    """How options that are numbers are read: messages do not speak of Python's types."""
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
        raise ValueError(f"got {escape(word, 40)!r}, expected {expected}") from None


def run_subcommand(words: list[str], command: str, parts: Parts) -> int:
    """Run the part of a command that the first word names, or print them; returns the exit code.

    Args:
        words: What follows the command.
        command: Its name.
        parts: Its parts.

    Raises:
        ConfigError: The word is missing or unknown, or as `parse_options` and the part itself do.
    """
    name = words[0] if words else ""
    if name in parts:
        options, work = parts[name]
        return work(parse_options(options, words[1:], f"{command} {name}"))
    if name in ("-h", "--help"):
        lines = [f"usage: wcsim {command} {'|'.join(parts)} [options]", ""]
        lines += [
            f"  {word:<10}{(part.__doc__ or '').strip()}" for word, (part, _) in parts.items()
        ]
        print("\n".join(lines))
        return 0
    fault = f"unknown {command} command {name!r}" if words else f"{command} needs a command"
    near = meant(name, parts) if words else ""
    raise ConfigError(
        f"{fault}; expected one of: {', '.join(parts)} (wcsim {command} --help){near}"
    )


def split_comma_list(text: str) -> tuple[str, ...]:
    """The items of a comma-separated option; empty ones are left out.

    >>> split_comma_list("monaco, manhattan")
    ('monaco', 'manhattan')
    """
    return tuple(word.strip() for word in text.split(",") if word.strip())


def has_option(words: Sequence[str], option: str) -> bool:
    """Whether a command has an option, as `--option VALUE` or `--option=VALUE`."""
    return any(word == option or word.startswith(f"{option}=") for word in words)


def split_nonempty_list(option: str, text: str) -> tuple[str, ...]:
    """The items of a comma-separated option. Raises ConfigError when there is none."""
    found = split_comma_list(text)
    if not found:
        raise ConfigError(f"{option} {text!r}: expected one or more names, separated by commas")
    return found


def shorten_lines(lines: Sequence[str], what: str) -> list[str]:
    """The first five lines, and how many more of `what` there are."""
    more = len(lines) - _MOST_LINES
    return [*lines[:_MOST_LINES], f"and {more} more {what}"] if more > 0 else list(lines)


def resolve_worker_count(count: int | None) -> int:
    """The number of processes of `--worlds`; by default one for each core, at most 4."""
    if count is not None:
        return count
    from wcsim.physics.sensors.drawing_threads import cores

    return min(cores(), _USUAL_WORLDS)


def workers_from_options(cluster: str, workers: int | None, option: str) -> WorkerPoolSettings:
    """The machines of `--cluster`, or this one.

    Args:
        cluster: The address as typed; "" for this machine.
        workers: Number of workers; None for that of `resolve_worker_count`, or of a cluster's
            nodes.
        option: Name of the option that sets the workers.

    Raises:
        ConfigError: There are no such machines.
    """
    from wcsim.server.workers.machines import LOCAL, WorkerPoolSettings, require_reachable_cluster

    if not cluster:
        return WorkerPoolSettings(count=resolve_worker_count(workers))

    count = resolve_worker_count(workers) if cluster == LOCAL else workers or 1
    if cluster != LOCAL and count > 1:
        raise ConfigError(
            f"{option} {count} and --cluster {cluster}: `ray start --num-cpus` sets the workers of "
            "a node there; leave one of the two out"
        )
    require_reachable_cluster(cluster)
    return WorkerPoolSettings(count=count, cluster=cluster)


def serve_page(start: DriveOrder | PlayStart, page: WebPageOptions) -> int:
    """Serve a page until Ctrl-C: a film, or a drive."""
    import asyncio

    from wcsim.drive.serving.server import DriveServer

    try:
        asyncio.run(DriveServer(start, page.host, page.port, partial(print, flush=True)).run())
    except KeyboardInterrupt:
        print("the page is closed")
    return 0


def require_writable_folder(option: str, folder: Path) -> None:
    """Raise ConfigError for a folder that can be neither made nor written to."""
    if not is_writable_folder(folder):
        raise ConfigError(
            f"{option}: {escape(find_existing_ancestor(folder))} is not a folder that can be "
            f"written to; choose another with {option}"
        )


def write_json(path: Path | None, data: Any) -> None:
    """Write a result file where there is a path, in one step; it never holds NaN or infinity."""
    if path is None:
        return
    text = format_json(path, data)
    with write_result_atomically(path) as part:
        part.write_text(text, encoding="utf-8")


def format_json(path: Path, data: Any, indent: int | None = 2) -> str:
    """The text of a result file. Raises ConfigError for NaN and infinity."""
    try:
        return json.dumps(data, indent=indent, allow_nan=False) + "\n"
    except ValueError as error:
        raise ConfigError(
            f"{path}: a result contains a number that is not finite ({error})"
        ) from None


@contextmanager
def write_result_atomically(path: Path) -> Iterator[Path]:
    """As `write_file_atomically`, and notes that it made a folder for it.

    Raises:
        ConfigError: Its folder cannot be made.
        DiskFullError: There is no room.
    """
    with report_created_folder(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot be written ({error.strerror}); choose another place"
            ) from None
        with write_file_atomically(path) as part:
            yield part


@contextmanager
def remove_folders_on_failure(folder: Path) -> Iterator[None]:
    """Leave no empty folders behind when the block fails."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        yield
    except BaseException:
        for place in missing:
            # Another process may have put something there.
            with suppress(OSError):
                place.rmdir()
        raise


@contextmanager
def report_created_folder(path: Path) -> Iterator[None]:
    """Note at the end which folder was made for a result, so that a mistyped one is seen."""
    missing = [folder for folder in reversed(path.parents) if not folder.exists()]
    yield
    if missing:
        print(f"note: made the folder {escape(missing[0])}", file=sys.stderr)
