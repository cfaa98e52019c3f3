"""`wcsim users record`: a simulated user drives through a town, and what it does is kept in a file."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from wcsim.cli.shared.common import Bounds, Keys, OutFile, Repeated, TownWord, write_json
from wcsim.cli.shared.run_config import require_user
from wcsim.config import resolve
from wcsim.core.constants import RECORDED
from wcsim.core.files import check_new_file
from wcsim.core.reading import counted, escaped
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town
from wcsim.users.profiles import PROFILE_SUFFIX, UserProfile, profile, read_profile

SMALL_CAMERA = ("cameras.0.width_px=16", "cameras.0.height_px=12")  # nobody looks at the pictures
_TELL_EVERY_S = 60.0


@dataclass
class UserRecordOptions:
    """Let a simulated user drive through a town and record the drive."""

    town: TownWord
    """A town's name, its folder, or a .sumocfg file."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """New file for the recording."""
    profile: str = "competent"
    """Profile of the simulated user, or FILE.toml. One user is drawn and stays the same after a crash."""
    minutes: Annotated[float, Bounds(0.01, 600.0)] = 10.0
    """Length of the drive in minutes."""
    seed: int = 0
    """Seed of the town, the starts and the user."""
    set: Annotated[Repeated, Keys({"env.profile": "expected --profile NAME"})] = ()
    """section.key=value, overrides preset quick; may be repeated."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: UserRecordOptions) -> int:
    """Drive and record."""
    check_new_file(options.out, "--out")
    base = _profile(options.profile)
    config = resolve("quick", (*SMALL_CAMERA, *options.set))
    town = find_town(options.town)

    from wcsim.bridge.user_drives import UserDriveOrder, drawn_user, record_user  # loads the simulators

    user, ticks = drawn_user(base, options.seed), max(2, round(60.0 * options.minutes / config.world.tick_s))

    def show(done: int) -> None:
        if done % round(_TELL_EVERY_S / config.world.tick_s) == 0:
            print(f"{done * config.world.tick_s / 60.0:.0f} of {options.minutes:g} minutes", file=sys.stderr)

    order = UserDriveOrder(town=town, config=config, user=user, ticks=ticks, seed=options.seed)
    crashes = record_user(order, options.out, show)
    print(f"wrote {options.out}: {ticks} ticks of a {user.name} user in {town.name}, {counted(crashes, 'crash')}")
    told = {"town": town.name, "seed": options.seed, "ticks": ticks, "crashes": crashes, "user": asdict(user)}
    write_json(options.json, told)
    return 0


def _profile(name: str) -> UserProfile:
    if name.startswith(RECORDED):
        raise ConfigError(f"--profile {escaped(name, 80)} is a recording; expected a profile, or FILE.toml")
    require_user(name)
    return read_profile(Path(name)) if name.endswith(PROFILE_SUFFIX) else profile(name)
