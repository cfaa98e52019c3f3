"""A study that can begin: its file is read, its places, policy and levels are there, its table is its own."""

from __future__ import annotations

import hashlib
import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.suite.named_policy import config_for, open_named
from wcsim.agents.policy_api import Levelled
from wcsim.agents.runs.policy_file import policy_name
from wcsim.config import CONFIG_FILE, parse
from wcsim.config.study import StudyFile, StudyPlace
from wcsim.core.reading import escaped, is_file, parse_toml, read_text
from wcsim.drive.recording.study_plan import order_words, read_rows, table_columns
from wcsim.drive.starting import PRESET, DriveStart, check_recordable, checked
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import expanded

_MOST_PARTICIPANTS: Final = 9999
_SHIPPED: Final = Path(__file__).parents[2] / "config" / "presets" / "studies"


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenStudy:
    """A study and who takes part in it now."""

    file: StudyFile
    sha256: str  # hex, of the file's bytes
    participant: int  # 1 or more
    out: Path  # the folder of all results
    network: str = ""  # somebody's own, module:Class, that the policy may look with

    @property
    def table(self) -> Path:
        """The only table, of all participants."""
        return self.out / f"{self.file.name}.csv"

    @property
    def folder(self) -> Path:
        """Of this participant's recordings."""
        return self.out / f"participant-{self.participant:03d}"

    @property
    def order(self) -> str:
        """The order of this participant's blocks."""
        return order_words(self.file, self.participant)


def _shipped_studies() -> tuple[str, ...]:
    """The studies that come with wcsim."""
    return tuple(sorted(path.stem for path in _SHIPPED.glob("*.toml")))


def open_study(
    name_or_path: str, participant: int, out: Path | None = None, named: str = "", network: str = ""
) -> OpenStudy:
    """Read a study's file and check all that can be checked before anybody drives.

    Args:
        name_or_path: One that comes with wcsim, or a file.
        participant: From 1 on.
        out: Where results go; studies/NAME where it is not said.
        named: The policy of the file, named again by who starts it: one that is somebody's class runs as code.
        network: An own network of the policy, which runs as code too.

    Raises:
        ConfigError: The file is none, something in it is not there, or the table is another study's.
        TownError: There is no such town.
        PolicyError: There is no such policy, or it has no such level.
    """
    if not 1 <= participant <= _MOST_PARTICIPANTS:
        raise ConfigError(f"--participant {participant}: expected 1 to {_MOST_PARTICIPANTS}")
    path = _SHIPPED / f"{name_or_path}.toml" if name_or_path in _shipped_studies() else expanded(name_or_path)
    if not is_file(path):
        known = ", ".join(_shipped_studies())
        raise ConfigError(f"--study {escaped(name_or_path)}: there is no such study; expected {known}, or a TOML file")
    text = read_text(path, CONFIG_FILE)
    file = parse(StudyFile, parse_toml(text, escaped(path), CONFIG_FILE), escaped(path))
    digest = hashlib.sha256(text.encode()).hexdigest()
    _require_named(file.policy, named, escaped(path))
    place_of_results = out or Path("studies") / file.name
    study = OpenStudy(file=file, sha256=digest, participant=participant, out=place_of_results, network=network)
    for place in (*file.places, *([file.practice_place] if file.practice_place else [])):
        check_recordable(checked(study_start(file, place, network)))
    _require_levels(study, escaped(path))
    participant_rows(study)
    return study


def participant_rows(study: OpenStudy) -> tuple[dict[str, str], ...]:
    """The participant's rows. Raises ConfigError for a table of another study."""
    rows = read_rows(study.table, table_columns(study.file))
    other = next((row for row in rows if row["study_sha256"] != study.sha256[:12]), None)
    if other is not None:
        raise ConfigError(
            f"{escaped(study.table)}: belongs to another study file ({escaped(other['study_sha256'], 12)}, this is "
            f"{study.sha256[:12]}); expected the same file: restore it, or name another folder with --out"
        )
    return tuple(row for row in rows if row["participant"] == str(study.participant))


def study_start(file: StudyFile, place: StudyPlace, network: str) -> DriveStart:
    """What is opened for a place; an episode of a suite has its own user. `network` is as in `OpenStudy`."""
    drives = DriveStart(policy=file.policy, network=network)
    if place.suite:
        return replace(drives, profile="", suite=place.suite, block=place.block, seat=place.seat)
    return replace(drives, town=place.town, profile=file.profile, seed=place.seed)


def _require_named(policy: str, named: str, where: str) -> None:
    """Raise ConfigError for another policy than the file's, or a class that is loaded without being named again."""
    if named and named != policy:
        told = f"{where} says policy = {escaped(policy)!r}"
        raise ConfigError(f"--policy {escaped(named)} with --study: {told}; leave --policy out")
    if policy_name(policy).kind == "class" and not named:
        raise ConfigError(
            f"{where}: its policy is the class {escaped(policy)}, and loading it runs its code; if you "
            f"trust it, name it: --policy {shlex.quote(escaped(policy))}"
        )


def _require_levels(study: OpenStudy, where: str) -> None:
    """Set every level once. Raises PolicyError or ConfigError for one that the policy does not have."""
    file = study.file
    blocks = [*file.blocks, *([file.practice] if file.practice else [])]
    wanted = {block.level: block.name for block in blocks if block.level is not None}
    policy = open_named(file.policy, config_for(file.policy, PRESET, ()), 0, study.network or None)
    try:
        for level, name in wanted.items():
            levels = policy.levels if isinstance(policy, Levelled) else None
            if levels is None or not min(levels) <= level <= max(levels):
                told = "no levels" if levels is None else f"levels of {min(levels):g} to {max(levels):g}"
                raise ConfigError(
                    f"{where}: block {name} has level {level:g}, but policy {policy.name} has {told}; change "
                    "the level or the policy"
                )
    finally:
        close = getattr(policy, "close", None)
        if close is not None:
            close()
