"""A scenario on its way into a world.

Filtered copies in the run folder, the author's own files untouched.
"""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from wcsim.config import RunConfig
from wcsim.core.own_folder import create_temporary_folder
from wcsim.errors import ConfigError, TownError
from wcsim.towns.scenario.files import NOWHERE, FilteredFiles, OutputNames
from wcsim.towns.scenario.options import (
    Configuration,
    GivenOption,
    SumoOption,
    Treatment,
    read_configuration,
    sumo_options,
)
from wcsim.towns.scenario.overrides import (
    AGGREGATED,
    JUMPING,
    Override,
    Settings,
    forced,
    overrides_of,
)
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.warning_log import ERROR_LOG
from wcsim.towns.sumo.xml_io import is_true

_UNEVEN = (  # the name of an output, what fcd-output writes, and its leader distance
    r"((tripinfo|personinfo|vehroute|personroute|full)-output|netstate-dump|(message-|error-)?log|"
    r"save-state\.(prefix|files)) "
    r"|fcd-output (.*\b(all|stage|vehicle)\b|.* [0.]*[1-9])"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A scenario as a world runs it."""

    sumocfg: Path  # the filtered copy, to be opened with sumo or sumo-gui as it is
    overrides: tuple[Override, ...]
    notes: tuple[str, ...]  # what its users should know
    # Files that it may write, besides warnings, and ssm.xml of safety devices.
    outputs: tuple[Path, ...]
    warnings: str  # the file of SUMO's warnings; "" where there is none
    author_scale: float
    begin_s: float
    digest: str  # SHA-256 over everything SUMO reads, without seed and place
    inputs: tuple[Path, ...]  # everything SUMO reads, as its author wrote it


def stage_scenario(
    town: Town, settings: Settings, folder: Path, outputs: Sequence[str] = ()
) -> Scenario:
    """Write the filtered copies of a town's scenario into `folder`, an empty one of its own.

    Args:
        town: The town.
        settings: What the world decides.
        folder: Everything SUMO writes will appear here.
        outputs: More outputs to ask for, by SUMO's names without "-output" ("fcd", "tripinfo").

    Raises:
        TownError: a file is missing or broken, or the scenario cannot be run here.
        ConfigError: there is no such output.
    """
    config = read_configuration(town.sumocfg)
    if is_true(config.value("mesosim") or "false"):
        raise TownError(
            f"{config.path}: is mesoscopic (mesosim): vehicles have no positions; remove that option"
        )
    files = FilteredFiles(folder.absolute(), town.border)
    names = files.names
    names.unique(town.sumocfg.name)
    _make(folder)
    set_here = dict(forced(settings, config.scale))
    unasked = _unasked_outputs(config, names)
    kept = [
        (item.option, _value(item, config, names, files))
        for item in config.given
        if item.value
        and item.option.treatment is not Treatment.DROP
        and item.option.name not in (*set_here, *unasked)
    ]
    kept += _asked_for(outputs, config, names)
    kept += [(sumo_options()[name], value) for name, value in (set_here | unasked).items()]
    # SUMO writes some outputs as parquet until two of their elements differ; then it aborts the process.
    fcd = (
        f"{config.value('fcd-output.attributes')} {config.value('fcd-output.max-leader-distance')}"
    )
    for option, value in kept:
        if re.match(_UNEVEN, f"{option.name} {fcd}") and (
            value.endswith(".parquet") or config.value("output.format") == "parquet"
        ):
            raise TownError(
                f"{config.path}: SUMO dies when it writes <{option.name}> as parquet; expected XML or CSV: end its "
                "file's name in .xml, without <output.format>"
            )
    text = _configuration_text(kept)
    sumocfg = names.folder / town.sumocfg.name
    sumocfg.write_text(text, encoding="utf-8")
    led = [
        (option.name, value.replace(f"{names.folder}/", "sumo/"))
        for option, value in kept
        if option.treatment is Treatment.OUTPUT and config.value(option.name) is not None
    ]
    return Scenario(
        sumocfg=sumocfg,
        overrides=overrides_of(config, settings, led),
        notes=_notes_of(config),
        outputs=names.paths,
        warnings=next((value for option, value in kept if option.name == ERROR_LOG), ""),
        author_scale=config.scale,
        begin_s=config.seconds("begin", "0"),
        digest=_digest(text, settings, names.folder, files),
        inputs=tuple(files.read),
    )


def files_of(town: Town, config: RunConfig) -> tuple[Path, ...]:
    """Every file that a scenario is made of, its .sumocfg first, and what wcsim itself knows of it.

    Raises:
        TownError: as `stage_scenario`: one is not there, or cannot be read. SUMO opens none of
            them.
    """
    with create_temporary_folder() as folder:
        inputs = stage_scenario(town, Settings(world=config.world, seed=1), folder).inputs
    known = town.folder.absolute() / "town.toml"
    return tuple(
        dict.fromkeys((town.sumocfg.absolute(), *inputs, *((known,) if known.is_file() else ())))
    )


def _notes_of(config: Configuration) -> tuple[str, ...]:
    """What the users of a scenario should know of its own choices."""
    notes = []
    if config.number("lateral-resolution", 0.0) <= 0.0:
        notes.append(
            "the scenario has no lateral-resolution, so vehicles pass a wheelchair only by changing lanes; to let "
            'them pass within a lane, set <lateral-resolution value="0.8"/>'
        )
    if config.value("pedestrian.model") == JUMPING:
        notes.append(
            f"with pedestrian.model {JUMPING} pedestrians jump between streets and ignore wheelchairs; "
            'to let them walk round it, set <pedestrian.model value="striping"/>'
        )
    return tuple(notes)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TownError(
            f"{folder}: cannot be created ({error.strerror}); choose another run folder"
        ) from None


def _value(
    item: GivenOption, config: Configuration, names: OutputNames, files: FilteredFiles
) -> str:
    """The value that an option has in the filtered copy."""
    folder = config.path.parent
    if item.option.treatment is Treatment.OUTPUT:
        written = [part.strip() for part in item.value.split(",") if part.strip()]
        instead = f"{item.option.name}.xml"
        return ",".join(
            part if part in NOWHERE else str(names.place(part, folder, instead)) for part in written
        )
    if item.option.treatment is Treatment.INPUT:
        return ",".join(
            _quoted(files.place_option(item.option, path, config.path))
            for path in item.files(folder)
        )
    return item.value


def _unasked_outputs(config: Configuration, names: OutputNames) -> dict[str, str]:
    """Options, and their values, that lead what SUMO writes where its author names no file.

    Safety devices write beside the configuration or into the current folder; so do states; and
    electric vehicles write files that are called by their ids, which may hold a path.
    """
    found = {}
    if not config.value("device.ssm.file"):
        # Made when the first such device is.
        found["device.ssm.file"] = str(names.folder / names.unique("ssm.xml"))
    saves = config.value("save-state.period") or config.value("save-state.times")
    if saves and not config.value("save-state.prefix"):
        found["save-state.prefix"] = str(names.place("state", names.folder, "state"))
    if config.value("elechybrid-output"):
        found[AGGREGATED] = "true"
    # SUMO dies of warnings that it shall write as parquet.
    if (config.value(ERROR_LOG) or "") in NOWHERE and config.value("output.format") != "parquet":
        found[ERROR_LOG] = str(names.folder / names.unique("sumo-warnings.log"))
    return found


def _asked_for(
    outputs: Sequence[str], config: Configuration, names: OutputNames
) -> list[tuple[SumoOption, str]]:
    """The outputs that the user of this run wants besides the author's."""
    more = []
    for word in outputs:
        option = sumo_options().get(f"{word}-output")
        if option is None or option.kind != "FILE":
            known = sorted(
                name.removesuffix("-output") for name in sumo_options() if name.endswith("-output")
            )
            raise ConfigError(
                f"--outputs {word!r}: SUMO has no such output; expected some of: {', '.join(known)}"
            )
        if not config.value(option.name):
            more.append((option, str(names.place(f"{word}.xml", names.folder, f"{word}.xml"))))
    return more


def _configuration_text(options: Sequence[tuple[SumoOption, str]]) -> str:
    root = ElementTree.Element("sumoConfiguration")
    for option, value in options:
        topic = root.find(option.topic)
        topic = ElementTree.SubElement(root, option.topic) if topic is None else topic
        ElementTree.SubElement(topic, option.name, value=value)
    ElementTree.indent(root, "    ")
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _quoted(path: Path) -> str:
    """A path as SUMO reads it back from a configuration, where %41 is an A and ${HOME} a folder."""
    return str(path).replace("%", "%25").replace("${", "%24{")


def _digest(text: str, settings: Settings, folder: Path, files: FilteredFiles) -> str:
    """Equal for equal scenarios, wherever they lie and whatever the seed."""
    neutral = text.replace(str(folder), "").replace(f'<seed value="{settings.seed}"', "")
    digest = hashlib.sha256()
    for path in files.read:
        neutral = neutral.replace(_quoted(path), path.name)
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    digest.update(neutral.encode())
    return digest.hexdigest()
