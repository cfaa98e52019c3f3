"""What a piece of driving needs of this machine's files, for machines that have no disk in common with it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from wcsim.agents.runs.policy_name import policy_name
from wcsim.agents.runs.run_folder import CONFIG, MANIFEST, PLANT, policy_path
from wcsim.config import RunConfig
from wcsim.config.load import Layer
from wcsim.core.constants import RECORDED
from wcsim.core.reading import escaped, is_file
from wcsim.errors import ConfigError, TownError
from wcsim.server.workers.worker_api import At, Parcel
from wcsim.towns.scenario.stage import files_of
from wcsim.towns.scenario.town import find_town
from wcsim.users.profiles import is_of_file


@lru_cache(maxsize=256)
def town_parcel(address: str) -> Parcel:
    """A town, as its SUMO files and its town.toml. Raises TownError."""
    town = find_town(address)
    folder, files = town.folder.absolute(), files_of(town, RunConfig())
    outside = [path for path in files if not path.is_relative_to(folder)]
    if outside:
        raise TownError(
            f"town {town.name} has a file outside of its folder, {escaped(outside[0])}; expected all in "
            f"{escaped(folder)}, as the folder is sent to other machines"
        )
    names = tuple(sorted(path.relative_to(folder).as_posix() for path in files))
    inner = "" if Path(town.address).is_dir() else town.sumocfg.name
    return Parcel(address=address, folder=folder, names=names, inner=inner, kept=True)


def policy_parcel(name: str) -> Parcel:
    """A policy by its name without a level, with what its run says of it. Raises PolicyError."""
    policy = policy_path(name).resolve()
    alone, run = folder_parcel(policy, name), policy.parent.parent
    if not is_file(run / MANIFEST):
        return alone
    said = [file for file in (MANIFEST, CONFIG, PLANT) if is_file(run / file)]
    inner = policy.relative_to(run).as_posix()
    return replace(alone, folder=run, names=(*said, *(f"{inner}/{file}" for file in alone.names)), inner=inner)


def folder_parcel(folder: Path, address: str = "") -> Parcel:
    """The files of a folder, without those in folders of it."""
    names = tuple(path.name for path in sorted(folder.iterdir()) if path.is_file())
    return Parcel(address=address or str(folder), folder=folder.absolute(), names=names)


def plant_parcels(config: RunConfig) -> tuple[Parcel, ...]:
    """The user's own wheelchair, where the configuration names one."""
    plant = config.chair.plant
    if not plant.endswith(".toml"):
        return ()
    path = Path(plant).absolute()
    return (Parcel(address=plant, folder=path.parent, names=(path.name,), inner=path.name),)


def plant_at(config: RunConfig, at: At) -> Layer:
    """Where that wheelchair lies now."""
    return {"chair": {"plant": at(config.chair.plant)}} if config.chair.plant.endswith(".toml") else None


def policy_at(name: str, at: At) -> str:
    """A policy's name, veto and level included, where it lies now."""
    place = policy_name(name).place
    before, _, after = name.partition(place)
    return before + at(place) + after


def require_travels(
    config: RunConfig, settings: Collection[str] = (), own_code: Collection[str] = (), users: Collection[str] = ()
) -> None:
    """Refuse what other machines cannot have: code of the user's own, and files that settings name.

    Args:
        config: Of the run.
        settings: What else is set, as section.key=value.
        own_code: Classes that are named.
        users: Profiles beside those of the configuration.

    Raises:
        ConfigError: It says what, and how to go on without a cluster.
    """
    users = (config.env.profile, *config.collect.profiles, *users)
    words = " ".join((*settings, *config.collect.variants)).split()
    found = [f"class {escaped(name, 80)}" for name in own_code if ":" in name]
    found += [f"user {escaped(user, 80)}" for user in users if is_of_file(user)]
    found += [escaped(word, 80) for word in words if ".toml" in word or RECORDED in word]
    if found:
        raise ConfigError(
            f"--cluster: {', '.join(found)} exists on this machine only and cannot be sent; expected parts of wcsim "
            "alone: leave it out, or drive without --cluster"
        )
