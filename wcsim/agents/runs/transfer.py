"""What of a run reaches other machines: files that are sent with work, and code that is not.

Code in a run folder from elsewhere must not run here because the folder names it. A run that is
made here gets a mark with a key that only this user's machine has. Where the mark fits,
`wcsim resume` loads the classes that the run was made with; elsewhere they have to be named on the
command line.
"""

import hashlib
import hmac
import json
import os
import secrets
from collections.abc import Collection, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Final

from wcsim.config import RunConfig
from wcsim.core.constants import RECORDED
from wcsim.core.reading import KEY, escape, read_bytes
from wcsim.errors import ConfigError, FileError, PolicyError, TownError
from wcsim.server.workers.machines import WorkInputFiles
from wcsim.towns.cache.folder import cache_folder
from wcsim.towns.scenario.stage import files_of
from wcsim.towns.scenario.town import find_town
from wcsim.users.profiles import is_user_file_name

KEY_FILE: Final = "own-runs.key"


@lru_cache(maxsize=256)
def town_to_input_files(address: str) -> WorkInputFiles:
    """A town to send: its SUMO files and its town.toml. Raises TownError."""
    town = find_town(address)
    folder = town.folder.absolute()
    files = files_of(town, RunConfig())
    outside = [path for path in files if not path.is_relative_to(folder)]
    if outside:
        raise TownError(
            f"town {town.name} has a file outside of its folder, {escape(outside[0])}; expected "
            f"all in {escape(folder)}, as the folder is sent to other machines"
        )
    names = tuple(sorted(path.relative_to(folder).as_posix() for path in files))
    inner = "" if Path(town.address).is_dir() else town.sumocfg.name
    return WorkInputFiles(address=address, folder=folder, names=names, inner=inner)


def folder_to_input_files(folder: Path, address: str = "") -> WorkInputFiles:
    """The files of a folder to send, without those in folders of it."""
    names = tuple(path.name for path in sorted(folder.iterdir()) if path.is_file())
    return WorkInputFiles(address=address or str(folder), folder=folder.absolute(), names=names)


def require_sendable_run(
    config: RunConfig,
    settings: Collection[str] = (),
    own_code: Collection[str] = (),
    users: Collection[str] = (),
) -> None:
    """Refuse what other machines cannot have: the user's own code, and files that settings name.

    Args:
        config: The run's configuration.
        settings: What else is set, as section.key=value.
        own_code: Classes that are named.
        users: Profiles beside those of the configuration.

    Raises:
        ConfigError: It names the parts, and how to continue without a cluster.
    """
    users = (config.env.profile, *config.collect.profiles, *users)
    words = " ".join((*settings, *config.collect.variants)).split()
    parts = [f"class {escape(name, 80)}" for name in own_code if ":" in name]
    parts += [f"user {escape(user, 80)}" for user in users if is_user_file_name(user)]
    parts += [escape(word, 80) for word in words if ".toml" in word or RECORDED in word]
    if parts:
        raise ConfigError(
            f"--cluster: {', '.join(parts)} exists on this machine only and cannot be sent; "
            "expected parts of wcsim alone: leave it out, or drive without --cluster"
        )


def custom_class_names(
    hook: str, rewards: Sequence[str], networks: Collection[str]
) -> tuple[str, ...]:
    """The names that are `module:Class`, sorted."""
    return tuple(sorted({name for name in (hook, *rewards, *networks) if ":" in name}))


def sign_custom_classes(classes: Sequence[str]) -> str:
    """A mark that only this user's machine makes of these names.

    It is "" without any name, or where no key can be stored.
    """
    key = _key(make=True) if classes else b""
    return _mark(key, classes) if key else ""


def require_trusted_classes(
    path: Path, classes: Sequence[str], mark: str, named: Collection[str]
) -> None:
    """Refuse a run from elsewhere with own classes that this command line does not name.

    Raises:
        PolicyError: It says which, and how to name it.
    """
    unnamed = [name for name in classes if name not in named]
    if not unnamed or (mark and hmac.compare_digest(mark, _mark(_key(make=False), classes))):
        return
    names = ", ".join(escape(name, 80) for name in unnamed)
    raise PolicyError(
        f"{path} was made elsewhere with custom classes ({names}); resuming runs their code: name "
        f"each if you trust it, as --trust {escape(unnamed[0], 80)}"
    )


def _mark(key: bytes, classes: Sequence[str]) -> str:
    return hmac.new(key, json.dumps(list(classes)).encode(), hashlib.sha256).hexdigest()


def _key(make: bool) -> bytes:
    """The key of this user's machine, b"" where there is none."""
    path = cache_folder() / KEY_FILE
    try:
        if make and not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(number, "wb") as file:
                file.write(secrets.token_bytes(KEY.limit_bytes))
        key = read_bytes(path, KEY)
    except (OSError, FileError):
        return b""
    return key if len(key) == KEY.limit_bytes else b""
