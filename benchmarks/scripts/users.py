"""`python -m benchmarks users`: what the simulated users do, beside their parameters, and how far they come."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table

from wcsim.cli.shared.common import (
    AllowedSettingKeys,
    Bounds,
    OutFile,
    OutFolder,
    Repeated,
    require_writable_folder,
    split_nonempty_list,
    write_json,
)
from wcsim.cli.shared.consoles import stderr_console, stdout_console
from wcsim.config import RunConfig, resolve
from wcsim.towns.scenario.town import Town, find_town
from wcsim.users.profiles import find_builtin_profile, list_profile_names

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from benchmarks.users.drives import DrivenRoute
    from benchmarks.users.table import Statistic

TINY_CAMERA = ("cameras.0.width_px=16", "cameras.0.height_px=12")  # nobody looks at the pictures
LONGEST_S = 900.0
_PICTURE_S = 30.0
_PICTURE = "users.png"


@dataclass
class UsersOptions:
    """Compare the statistics of each user profile with its parameters; how often users arrive and crash."""

    towns: str = "helsinki,monaco,manhattan"
    """Towns that share the routes: each a town's name, its folder, or a .sumocfg file, separated by commas."""
    profiles: str = ",".join(list_profile_names())
    """Profiles to measure, separated by commas."""
    routes: int = 20
    """Routes for each profile, and for each figure below the table."""
    seconds: float = 60.0
    """Seconds of each route for the statistics."""
    arrivals: bool = True
    """Also drive whole routes: a competent user in an empty town, an inattentive one in traffic."""
    pictures: OutFolder = None
    """Draw 30 seconds of each profile's joystick into this folder, as users.png."""
    set: Repeated = ()
    """Setting as section.key=value; overrides the preset."""
    seed: int = 0
    """Seed of towns, starts and users."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: UsersOptions) -> int:
    """Run the bench."""
    Bounds(1, 1000).check("--routes", options.routes)
    Bounds(20.0, LONGEST_S).check("--seconds", options.seconds)
    AllowedSettingKeys({"env.profile": "expected --profiles NAME,..."}).check("--set", options.set)
    if options.pictures is not None:
        require_writable_folder("--pictures", options.pictures)
    names = tuple(find_builtin_profile(name).name for name in split_nonempty_list("--profiles", options.profiles))
    towns = tuple(find_town(name) for name in split_nonempty_list("--towns", options.towns))
    config = resolve("quick", (*TINY_CAMERA, *options.set))
    # A seed of its own for each town: with one for all, the same few users would be drawn in each again.
    seeds = range(options.seed, options.seed + len(towns))
    driven = _drive(options, towns, config, names, options.seconds, seeds)
    rows = {name: _statistics(routes) for name, routes in driven.items()}
    console = stdout_console()
    console.print(_table(rows))
    result: dict[str, Any] = {name: {key: asdict(row) for key, row in found.items()} for name, found in rows.items()}
    if options.arrivals:
        result.update(_arrivals(options, towns, config))
        for title in ("empty_town", "traffic"):
            console.print(_facts(title, result[title]))
    if options.pictures is not None:
        _draw(options, driven)
    if options.json is not None:
        write_json(options.json, result)
    return 0


def _drive(
    options: UsersOptions,
    towns: Sequence[Town],
    config: RunConfig,
    names: Sequence[str],
    longest_s: float,
    seeds: Sequence[int],
    truth: bool = False,
) -> dict[str, list[DrivenRoute]]:
    """All routes by profile, shared out among the towns."""
    from benchmarks.users.drives import drive_routes

    console = stderr_console()
    found: dict[str, list[DrivenRoute]] = {name: [] for name in names}
    for number, town in enumerate(towns):
        share = len(range(number, options.routes, len(towns)))
        if not share:
            continue
        driven = drive_routes(
            town, config, names, share, longest_s, seeds[number], truth, lambda text: console.print(text, style="dim")
        )
        for name, routes in driven.items():
            found[name] += routes
    return found


def _statistics(routes: Sequence[DrivenRoute]) -> dict[str, Statistic]:
    from benchmarks.users.table import statistics

    return statistics([route.log for route in routes])


def _arrivals(options: UsersOptions, towns: Sequence[Town], config: RunConfig) -> dict[str, Any]:
    """Whole routes: in a town without traffic, and in traffic."""
    empty = config.model_copy(update={"world": config.world.model_copy(update={"demand_scale": 0.0})})
    result: dict[str, Any] = {}
    for title, name, settings in (("empty_town", "competent", empty), ("traffic", "inattentive", config)):
        seeds = [options.seed] * len(towns)
        driven = _drive(options, towns, settings, (name,), LONGEST_S, seeds, truth=True)
        result[title] = {name: summary(driven[name])}
    return result


def summary(routes: Sequence[DrivenRoute]) -> dict[str, Any]:
    """How routes ended, and what share of their steps was free of danger."""
    steps = sum(len(route.log.speed_mps) for route in routes)
    km = sum(route.driven_m for route in routes) / 1000.0
    count = {how: sum(route.outcome == how for route in routes) for how in ("arrived", "crashed", "gave up")}
    return {
        "routes": len(routes),
        "arrived": count["arrived"],
        "arrived_share": count["arrived"] / max(1, len(routes)),
        "crashed": count["crashed"],
        "gave_up": count["gave up"],
        "km": km,
        "crashes_per_km": count["crashed"] / max(km, 1e-9),
        "free_share": sum(route.free_steps for route in routes) / max(1, steps),
        "ended_badly": [
            {"town": route.town, "how": route.outcome, "reason": route.reason, "p_W_m": route.end_W_m}
            for route in routes
            if route.outcome != "arrived"
        ],
    }


def _table(rows: dict[str, dict[str, Statistic]]) -> Table:
    table = Table("profile", "statistic", "measured", "parameter", "unit", "routes", box=box.SIMPLE_HEAD)
    for name, found in rows.items():
        for number, (key, row) in enumerate(found.items()):
            bound = "at most " if row.at_most else ""
            values = (f"{row.measured:.3f}", f"{bound}{row.parameter:.3f}", row.unit, str(row.routes))
            table.add_row("" if number else name, key, *values)
    return table


def _facts(title: str, found: dict[str, Any]) -> Table:
    table = Table(title.replace("_", " "), "", box=box.SIMPLE_HEAD)
    for name, row in found.items():
        table.add_row(f"{name}: arrived", f"{row['arrived']} of {row['routes']} routes")
        table.add_row("crashed, gave up", f"{row['crashed']}, {row['gave_up']}")
        table.add_row("driven, crashes per km", f"{row['km']:.2f} km, {row['crashes_per_km']:.2f}")
        table.add_row("share of steps without danger", f"{row['free_share']:.3f}")
    return table


def _draw(options: UsersOptions, driven: dict[str, list[DrivenRoute]]) -> None:
    """The first route of each profile that is long enough."""
    from benchmarks.users.user_sheet import write_sheet

    if options.pictures is None:
        return
    hands = {name: max(routes, key=lambda route: len(route.log.speed_mps)).log.hand for name, routes in driven.items()}
    write_sheet(options.pictures / _PICTURE, hands, _PICTURE_S)
    print(f"wrote {options.pictures / _PICTURE}")
