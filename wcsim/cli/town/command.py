"""`wcsim town import | make | list | check | pave | run`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Annotated

import tyro
from rich.table import Column, Table

from wcsim.cli.shared.common import OutFile, parse, subcommand, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.cli.town.import_ import ImportOptions
from wcsim.cli.town.import_ import run as run_import
from wcsim.cli.town.make import TownMakeOptions
from wcsim.cli.town.make import run as run_make
from wcsim.cli.town.pave import PaveOptions
from wcsim.cli.town.pave import run as run_pave
from wcsim.cli.town.report import print_report, report_json
from wcsim.cli.town.run import RunOptions
from wcsim.cli.town.run import run as run_traffic
from wcsim.cli.town.trial import checked
from wcsim.towns.scenario.town import find_town, list_towns


@dataclass
class ListOptions:
    """List the towns that have a name."""


@dataclass
class CheckOptions:
    """Check a town: connected pavements, routes, ground, and whether SUMO runs it."""

    town: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TOWN")]
    """A town's name, its folder, or a .sumocfg file."""
    json: OutFile = None
    """Write the result to this file."""


def run(words: list[str]) -> int:
    """Run one of the subcommands."""
    known = {
        "import": ImportOptions,
        "make": TownMakeOptions,
        "list": ListOptions,
        "check": CheckOptions,
        "pave": PaveOptions,
        "run": RunOptions,
    }
    name = subcommand(words, "town", known, known.__getitem__)
    if name == "import":
        return run_import(parse(ImportOptions, words[1:], "town import"))
    if name == "make":
        return run_make(parse(TownMakeOptions, words[1:], "town make"))
    if name == "list":
        parse(ListOptions, words[1:], "town list")
        return _list()
    if name == "run":
        return run_traffic(parse(RunOptions, words[1:], "town run"), words)
    if name == "pave":
        return run_pave(parse(PaveOptions, words[1:], "town pave"))
    return _check(parse(CheckOptions, words[1:], "town check")) if name else 0


def _list() -> int:
    table = Table("town", "split", Column("folder", overflow="fold"))
    for town in list_towns():
        table.add_row(town.folder.name, town.split, str(town.folder))
    stdout_console().print(table)
    return 0


def _check(options: CheckOptions) -> int:
    started_s = time.monotonic()
    report = checked(find_town(options.town))
    code = print_report(report)
    if options.json is not None:
        write_json(options.json, report_json(report, time.monotonic() - started_s))
    return code
