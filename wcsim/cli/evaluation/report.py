"""`wcsim report FOLDER`: the page of a finished test on a suite, or of a training."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from wcsim.cli.evaluation.judged_suite import MOST_JOBS
from wcsim.cli.shared.common import Repeated, check_folder, in_bounds, parse
from wcsim.core.reading import is_file, is_folder, shown
from wcsim.errors import ConfigError, FileError

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.agents.evaluation.suite.result_files import KeptResult
    from wcsim.view.report.failures import FailedEpisode
    from wcsim.view.report.illustrate import Illustration, Key

_MOST_PICTURES = 1000


@dataclass
class Options:
    """Write report.html and its figures into the folder of a finished test on a suite, or of a training."""

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
    """What `wcsim test --suite` or `wcsim train` wrote."""
    pictures: int = 8
    """Failures that are shown in pictures, the worst of each policy; each is driven once more, up to a minute."""
    own: Repeated = ()
    """module:Class: a policy or network of your own in this test, whose code may run for pictures."""
    jobs: int = 1
    """Processes that drive them."""


def run(words: list[str]) -> int:
    """Write the page and say where it is."""
    options = parse(Options, words, "report")
    in_bounds("--pictures", options.pictures, 0, _MOST_PICTURES)
    in_bounds("--jobs", options.jobs, 1, MOST_JOBS)
    is_test, is_run = (is_file(options.folder / name) for name in ("result.json", "manifest.json"))
    if not is_folder(options.folder) or not (is_test or is_run):
        raise ConfigError(
            f"{shown(options.folder)}: nothing to report; expected a folder that `wcsim test --suite` or `wcsim train` "
            "wrote"
        )
    check_folder("FOLDER", options.folder)
    if find_spec("matplotlib") is None:
        raise ConfigError("figures are drawn by matplotlib, which is not here: python -m pip install 'wcsim[report]'")
    path = _of_test(options) if is_test else _of_training(options.folder)
    Console(highlight=False).print(f"{path}: open it in a browser", soft_wrap=True, markup=False)
    return 0


def _of_training(folder: Path) -> Path:
    from wcsim.view.report.training_page import read_training, write_training_page

    return write_training_page(read_training(folder), folder)


def _of_test(options: Options) -> Path:
    from wcsim.agents.evaluation.suite.result_files import read_result
    from wcsim.view.report.failures import failures_of
    from wcsim.view.report.suite_page import write_suite_page

    result = read_result(options.folder)
    failures = failures_of(result, options.folder)
    try:
        pictures, why_none = _pictures(options, result, failures), ""
    except FileError as error:  # the numbers stand without pictures
        pictures, why_none = {}, f"No pictures: {error}"
        Console(stderr=True, highlight=False).print(why_none, soft_wrap=True, markup=False)
    return write_suite_page(result, options.folder, failures, pictures, why_none)


def _pictures(options: Options, result: KeptResult, failures: tuple[FailedEpisode, ...]) -> dict[Key, Illustration]:
    from wcsim.view.report.illustrate import chosen, illustrated, order_of

    wanted = chosen(failures, options.pictures)
    if not wanted:
        return {}
    told = Console(stderr=True, highlight=False)
    return illustrated(
        order_of(result, options.folder, options.own),
        wanted,
        options.own,
        options.jobs,
        lambda done, of: told.print(f"pictures: {done} of {of} blocks", style="dim"),
    )
