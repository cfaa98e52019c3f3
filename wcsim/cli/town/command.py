"""`wcsim town import | make | list | check | pave | run`."""

from dataclasses import dataclass

from rich.table import Column

from wcsim.cli.shared.common import Parts, has_option, run_subcommand
from wcsim.cli.shared.consoles import show_table
from wcsim.cli.town import import_, town_check
from wcsim.cli.town import run as traffic
from wcsim.towns.scenario.town import list_towns


@dataclass
class _ListOptions:
    """List the towns that have a name."""


def run(words: list[str]) -> int:
    """Run one of the subcommands."""
    parts: Parts = {
        "import": (
            import_.ScenarioImportOptions
            if has_option(words, "--sumocfg")
            else import_.XodrImportOptions
            if has_option(words, "--opendrive")
            else import_.OsmImportOptions,
            import_.run,
        ),
        "make": (import_.TownMakeOptions, import_.run_town_make),
        "list": (_ListOptions, _list),
        "check": (town_check.TownCheckOptions, town_check.run),
        "pave": (import_.TownPaveOptions, import_.run_town_pave),
        "run": (traffic.TownRunOptions, lambda options: traffic.run(options, words)),
    }
    return run_subcommand(words, "town", parts)


def _list(_: _ListOptions) -> int:
    rows = ((town.folder.name, town.split, str(town.folder)) for town in list_towns())
    show_table(("town", "split", Column("folder", overflow="fold")), rows)
    return 0
