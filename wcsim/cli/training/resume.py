"""`wcsim train --resume`: everything is taken from the run folder; what is typed again may not say otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from wcsim.agents.runs.own_code import own_classes, require_own
from wcsim.agents.runs.resumed_folder import extend
from wcsim.agents.runs.run_folder import CONFIG, MANIFEST, Manifest, ResolvedRun, open_run, read_json, with_kept_plant
from wcsim.cli.shared.common import some_words
from wcsim.cli.shared.run_config import DQN, QUICK, learning, learns_in_rounds, resolve_run
from wcsim.config import RunConfig, parse, resolve
from wcsim.config.plant import plant_text
from wcsim.core.files import locked
from wcsim.errors import PolicyError, TownError
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.scenario.town import Town, streets_hash


@dataclass(frozen=True, slots=True, kw_only=True)
class Typed:
    """What was typed beside --resume; None and () where nothing was."""

    town: str | None = None
    preset: str | None = None
    config: Path | None = None
    set: tuple[str, ...] = ()
    network: str | None = None
    reward: tuple[str, ...] = ()
    hook: str | None = None
    steps: int | None = None
    seed: int | None = None


def given(words: Sequence[str]) -> frozenset[str]:
    """The names of the options among the words of a command.

    >>> sorted(given(["--seed", "1", "--config-for=a=b", "--resume"]))
    ['config_for', 'resume', 'seed']
    """
    return frozenset(w[2:].partition("=")[0].replace("-", "_") for w in words if w.startswith("--"))


def _value_of(command: Sequence[str], option: str) -> str | None:
    """The last value of an option in a command that was typed once; None where it was left out.

    >>> _value_of(["wcsim", "train", "--town", "a", "--town=b"], "town")
    'b'
    """
    found = None
    for number, word in enumerate(command):
        name, equals, value = word.partition("=")
        if name == f"--{option}":
            found = value if equals else (command[number + 1] if number + 1 < len(command) else None)
    return found


def is_of_clients(path: Path) -> bool:
    """Whether a folder is a run of several clients. Raises PolicyError when it is no run."""
    return "clients" in read_json(path, MANIFEST)


def town_of(path: Path, manifest: Manifest, typed: Typed) -> Town:
    """The town that a run was made in, of several the first one.

    Raises:
        PolicyError: Others were typed, or one has other streets by now.
        TownError: One is not found under the name that it had.
    """
    said = typed.town or _value_of(manifest.command, "town") or manifest.town
    try:
        towns = [asked_town(word) for word in some_words("--town", said)]
        kept = [asked_town(word) for word in manifest.more_towns]
    except TownError as error:
        if typed.town is not None:
            raise
        raise TownError(f"{path} was made in the town {said!r}: {error}; give its location: --town FOLDER") from None
    of_run = [manifest.town_sha256, *manifest.more_towns.values()]
    for found in (towns, [towns[0], *kept]):
        if [streets_hash(town) for town in found] != of_run:
            own = ", ".join((manifest.town, *manifest.more_towns))
            raise _another(path, "town or other streets", f"--town {said}", own)
    return towns[0]


def require_same(path: Path, manifest: Manifest, typed: Typed, meant: str = DQN) -> None:
    """Raise PolicyError for an option that says otherwise than the run was made with.

    Args:
        path: Its folder.
        manifest: Its manifest.
        typed: The options.
        meant: The preset where the run's command named none.
    """
    if typed.seed is not None and typed.seed != manifest.seed:
        raise _another(path, "seed", f"--seed {typed.seed}", manifest.seed)
    if typed.reward and typed.reward != manifest.rewards:
        raise _another(path, "rewards", f"--reward {' '.join(typed.reward)}", ", ".join(manifest.rewards) or "none")
    if typed.hook is not None and typed.hook != manifest.hook:
        raise _another(path, "hook", f"--hook {typed.hook}", manifest.hook or "none")
    preset = _value_of(manifest.command, "preset") or meant
    if typed.preset is not None and typed.preset != preset:
        raise _another(path, "preset", f"--preset {typed.preset}", preset)


def require_own_classes(
    path: Path, manifest: Manifest, networks: Sequence[str], typed: Typed, named: Sequence[str] = ()
) -> None:
    """Refuse code that only the run folder names, unless the run was made here.

    Args:
        path: The folder.
        manifest: Of the run.
        networks: Of its configuration, or of its clients'.
        typed: The options.
        named: Networks that were named in another option.

    Raises:
        PolicyError: Classes of somebody else would be loaded.
    """
    said = {typed.network or "", typed.hook or "", *typed.reward, *named}
    said |= {text.partition("=")[2].strip("\"' ") for text in typed.set if text.startswith("learn.network=")}
    require_own(path, own_classes(manifest.hook, manifest.rewards, networks), manifest.own_code, said)


def require_same_config(path: Path, config: RunConfig, typed: Typed, files: Sequence[Path] = ()) -> None:
    """Raise PolicyError for a setting that says otherwise than a run's configuration.

    Args:
        path: Its folder.
        config: As it is resumed.
        typed: The options.
        files: Further files laid over it.
    """
    network = () if typed.network is None else (f'learn.network="{typed.network}"',)
    for file in (*([] if typed.config is None else [typed.config]), *files):
        _require_equal(path, config, resolve(config, file), f"the file {file}")
    words = (*typed.set, *network)
    if _equal(path, config, resolve(config, words)):  # a later word may take back an earlier one
        return
    for text in reversed(words):
        said = f"--network {typed.network}" if text in network else f"--set {text}"
        _require_equal(path, config, resolve(config, (text,)), said)


def _require_own_config(path: Path, manifest: Manifest) -> None:
    """Raise PolicyError when a run's configuration is not the one that its manifest has the hash of.

    Another version of wcsim may know more settings, and so have another hash of the same file.
    """
    if manifest.versions.get("wcsim") != metadata.version("wcsim"):
        return
    known = manifest.config_sha256, read_json(path, MANIFEST).get("config_was_sha256")
    if parse(RunConfig, read_json(path, CONFIG), str(path / CONFIG)).digest() not in known:
        raise PolicyError(f"{path / CONFIG} does not match the run: changed or damaged; restore it")


def _require_equal(path: Path, config: RunConfig, other: RunConfig, said: str) -> None:
    if not _equal(path, config, other):
        raise _another(path, "configuration", said)


def _equal(path: Path, config: RunConfig, other: RunConfig) -> bool:
    """Whether both are one configuration to a run that keeps its plant."""
    same = plant_text(other.chair.plant) == plant_text(config.chair.plant)
    typed, own = learning(with_kept_plant(other, path)), learning(config)
    return same and typed.with_usual_warmup() == own.with_usual_warmup()


def steps_of(path: Path, config: RunConfig, typed: Typed) -> int:
    """Steps in all: those of the run, or more. Raises PolicyError for fewer."""
    total = config.learn.total_steps
    if typed.steps is None:
        return total
    if typed.steps < total:
        raise PolicyError(f"--steps {typed.steps}: {path} was made for {total}; expected at least as many")
    return typed.steps


def resumed(path: Path, typed: Typed) -> tuple[ResolvedRun, Town]:
    """What a run of one network goes on with.

    Raises:
        PolicyError: It is no such run, or an option says otherwise.
        TownError: Its town is not there.
        ConfigError: An option cannot be used.
    """
    run = open_run(path)
    _require_own_config(path, run.manifest)
    require_same(path, run.manifest, typed, QUICK if learns_in_rounds(run.config) else DQN)
    require_own_classes(path, run.manifest, (run.config.learn.network,), typed)
    town = town_of(path, run.manifest, typed)
    steps = steps_of(path, run.config, typed)
    require_same_config(path, run.config, typed)
    begun = "config_was_sha256" in read_json(path, MANIFEST)  # by a process that ended between two files
    if begun or steps != run.config.learn.total_steps:
        with locked(path):  # by nobody else at work: a run in use keeps its steps
            extend(path, steps)
        run = open_run(path)
    return resolve_run(learning(run.config), run.manifest.info, town, path, resume=True), town


def _another(path: Path, what: str, said: str, own: object = None) -> PolicyError:
    its = "" if own is None else f" ({own})"
    return PolicyError(f"{said}: {path} was made with another {what}{its}; resume with the same one, or leave it out")
