"""`wcsim report FOLDER...`: the page of a finished test on a suite, or of trainings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional, arg

from wcsim.cli.shared.common import (
    Bounds,
    Jobs,
    OutFolder,
    Repeated,
    parse_options,
    require_writable_folder,
)
from wcsim.cli.shared.consoles import print_note, stderr_console, stdout_console
from wcsim.core.reading import escape, is_file, is_folder, pluralize
from wcsim.errors import ConfigError, FileError, check_installed

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.view.report.failures import Illustration, Key

_MOST_PICTURES: Final = 1000


@dataclass
class _Options:
    """Write report.html and figures into the folder of a test on a suite or a training.

    For several trainings, one page has the curves of all.
    """

    folders: Annotated[tuple[Path, ...], Positional, arg(metavar="FOLDER [FOLDER ...]")]
    """Folders of `wcsim test --suite` or `wcsim train`."""
    out: OutFolder = None
    """Folder for the page. (default: the one folder, or runs/report for several)"""
    pictures: Annotated[int, Bounds(0, _MOST_PICTURES)] = 8
    """Failures with pictures, the worst of each policy. Each is driven again, which takes up to a minute."""  # noqa: E501
    own: Repeated = ()
    """module:Class: a policy or network of your own in this test; its code may run for pictures."""
    jobs: Jobs = 1
    """Parallel processes that drive them."""


def run(words: list[str]) -> int:
    """Write the page and say where it is."""
    options = parse_options(_Options, words, "report")
    kinds = [_is_test(folder) for folder in options.folders]
    if not kinds or (len(kinds) > 1 and any(kinds)):
        raise ConfigError(
            f"got {pluralize(len(kinds), 'folder')}, {sum(kinds)} of tests; expected one, or "
            "several of `wcsim train`"
        )
    out = options.out or (options.folders[0] if len(kinds) == 1 else Path("runs") / "report")
    require_writable_folder("FOLDER" if options.out is None and len(kinds) == 1 else "--out", out)
    check_installed("figures need matplotlib", "report", "matplotlib")
    if kinds[0]:
        path = _write_test_page(options, out)
    else:
        path = _write_trainings_page(options.folders, out)
    stdout_console().print(f"{path}: open it in a browser", soft_wrap=True)
    return 0


def _is_test(folder: Path) -> bool:
    """Whether a folder is of a test, else of a training. Raises ConfigError for any other."""
    is_test, is_run = (is_file(folder / name) for name in ("result.json", "manifest.json"))
    if not is_folder(folder) or not (is_test or is_run):
        raise ConfigError(
            f"{escape(folder)}: nothing to report; expected a folder of `wcsim test --suite` or "
            "`wcsim train`"
        )
    return is_test


def _write_trainings_page(folders: tuple[Path, ...], out: Path) -> Path:
    from wcsim.view.report.learning_curve import crossing, read_training
    from wcsim.view.report.training_page import rounds_summary, write_training_page

    training = read_training(folders)
    page = write_training_page(training, out)
    for name, steps in training.steps.items():
        stdout_console().print(f"{name}: {crossing(steps).told()}", soft_wrap=True)
    for name, rounds in training.rounds.items():
        if rounds:
            stdout_console().print(f"{name}: {rounds_summary(rounds)}", soft_wrap=True)
    return page


def _write_test_page(options: _Options, out: Path) -> Path:
    from wcsim.agents.evaluation.suite.result_files import read_result
    from wcsim.view.report.failures import chosen, failures_of, illustrated, order_of
    from wcsim.view.report.suite_page import write_suite_page

    tested = options.folders[0]
    result = read_result(tested)
    failures = failures_of(result, tested)
    shown = chosen(failures, options.pictures)
    pictures: dict[Key, Illustration] = {}
    why_none = ""
    if shown:
        try:
            pictures = illustrated(
                order_of(result, tested, options.own),
                shown,
                options.own,
                options.jobs,
                lambda done, of: print_note(f"pictures: {done} of {of} blocks"),
            )
        except FileError as error:
            # The numbers stand without pictures.
            why_none = f"No pictures: {error}"
            stderr_console().print(why_none, soft_wrap=True)
    return write_suite_page(result, tested, failures, pictures, why_none, out)
