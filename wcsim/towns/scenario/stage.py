"""A scenario on its way into a world: copies in the run folder; its author's files stay."""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from wcsim.config import RunConfig
from wcsim.config.world import JUPEDSIM
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
    NET,
    PEOPLE,
    Override,
    Settings,
    forced,
    overrides_of,
)
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.thin_ground import widen_ground
from wcsim.towns.sumo.warning_log import ERROR_LOG
from wcsim.towns.sumo.xml_io import is_true, read_root

# Matches the name of an output, what fcd-output writes, and its leader distance, if SUMO dies when
# it writes that as parquet: it does so as soon as two elements differ.
_UNEVEN = (
    r"((tripinfo|personinfo|vehroute|personroute|full)-output|netstate-dump|(message-|error-)?log|"
    r"save-state\.(prefix|files)) "
    r"|fcd-output (.*\b(all|stage|vehicle)\b|.* [0.]*[1-9])"
)
_WIDE = "wide.net.xml"


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
        outputs: More outputs, by SUMO's names without "-output" ("fcd", "tripinfo").

    Raises:
        TownError: a file is missing or broken, or the scenario cannot be run here.
        ConfigError: there is no such output.
    """
    # 1. Read it, and make the folder.
    config = read_configuration(town.sumocfg)
    if is_true(config.value("mesosim") or "false"):
        raise TownError(
            f"{config.path}: is mesoscopic (mesosim): vehicles have no positions; "
            "remove that option"
        )
    files = FilteredFiles(folder.absolute(), town.border)
    names = files.names
    names.unique(town.sumocfg.name)
    wide = names.folder / names.unique(_WIDE)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TownError(
            f"{folder}: cannot be created ({error.strerror}); choose another run folder"
        ) from None

    # 2. Gather the options with their values, which leads their files into the folder.
    set_here = dict(forced(settings, config.scale)) | _implied_outputs(config, names)
    people = set_here.get(PEOPLE) or config.value(PEOPLE)
    options = [
        (item.option, _value(item, config, names, files, people))
        for item in config.given
        if item.value
        and item.option.treatment is not Treatment.DROP
        and item.option.name not in set_here
    ]
    options += _more_outputs(outputs, config, names)
    options += [(sumo_options()[name], value) for name, value in set_here.items()]
    _refuse_uneven_parquet(options, config)

    # 3. Write the configuration.
    root = ElementTree.Element("sumoConfiguration")
    for option, value in options:
        topic = root.find(option.topic)
        topic = ElementTree.SubElement(root, option.topic) if topic is None else topic
        ElementTree.SubElement(topic, option.name, value=value)
    ElementTree.indent(root, "    ")
    text = ElementTree.tostring(root, encoding="unicode") + "\n"
    sumocfg = names.folder / town.sumocfg.name
    sumocfg.write_text(text, encoding="utf-8")

    # 4. List what was changed.
    moved = [
        (option.name, value.replace(f"{names.folder}/", "sumo/"))
        for option, value in options
        if option.treatment is Treatment.OUTPUT or value == _quoted(wide)
        if config.value(option.name) is not None
    ]
    return Scenario(
        sumocfg=sumocfg,
        overrides=overrides_of(config, settings, moved),
        notes=_notes_of(config),
        outputs=names.paths,
        warnings=next((value for option, value in options if option.name == ERROR_LOG), ""),
        author_scale=config.scale,
        begin_s=config.seconds("begin", "0"),
        digest=_digest(text, settings, names.folder, files),
        inputs=tuple(files.read),
    )


def scenario_overrides(town: Town, settings: Settings) -> tuple[Override, ...]:
    """What a world overrides of a town's scenario; raises as `stage_scenario`."""
    with create_temporary_folder() as folder:
        return stage_scenario(town, settings, folder).overrides


def files_of(town: Town, config: RunConfig) -> tuple[Path, ...]:
    """Every file that a scenario is made of, its .sumocfg first, and what wcsim itself knows of it.

    Raises:
        TownError: as `stage_scenario`: one is not there, or cannot be read. SUMO opens none of
            them.
    """
    with create_temporary_folder() as folder:
        inputs = stage_scenario(town, Settings(world=config.world, seed=1), folder).inputs
    toml = town.folder.absolute() / "town.toml"
    known = (toml,) if toml.is_file() else ()
    return tuple(dict.fromkeys((town.sumocfg.absolute(), *inputs, *known)))


def _notes_of(config: Configuration) -> tuple[str, ...]:
    """What the users of a scenario should know of its own choices."""
    notes = []
    if config.number("lateral-resolution", 0.0) <= 0.0:
        notes.append(
            "the scenario has no lateral-resolution, so vehicles pass a wheelchair only by "
            "changing lanes; to let them pass within a lane, set "
            '<lateral-resolution value="0.8"/>'
        )
    if config.value("pedestrian.model") == JUMPING:
        notes.append(
            f"with pedestrian.model {JUMPING} pedestrians jump between streets and ignore "
            "wheelchairs; to let them walk round it, set "
            '<pedestrian.model value="striping"/>'
        )
    return tuple(notes)


def _value(
    item: GivenOption,
    config: Configuration,
    names: OutputNames,
    files: FilteredFiles,
    people: str | None,
) -> str:
    """The value that an option has in the filtered copy."""
    folder = config.path.parent
    if item.option.treatment is Treatment.OUTPUT:
        instead = f"{item.option.name}.xml"
        written = [part.strip() for part in item.value.split(",") if part.strip()]
        return ",".join(
            part if part in NOWHERE else str(names.place(part, folder, instead)) for part in written
        )
    if item.option.treatment is Treatment.INPUT:
        read = [files.place_option(item.option, p, config.path) for p in item.files(folder)]
        if item.option.name == NET and people == JUPEDSIM:
            net = widen_ground(read_root(read[0]))
            if net is not None:
                wide = names.folder / _WIDE
                wide.write_bytes(net)
                return _quoted(wide)
        return ",".join(map(_quoted, read))
    return item.value


def _implied_outputs(config: Configuration, names: OutputNames) -> dict[str, str]:
    """Options, and their values, that lead what SUMO writes where its author names no file.

    Safety devices and states write beside the configuration or into the current folder. Electric
    vehicles write files that are called by their ids, which may hold a path.
    """
    found = {}
    # SUMO makes this file with the first such device.
    if not config.value("device.ssm.file"):
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


def _more_outputs(
    outputs: Sequence[str], config: Configuration, names: OutputNames
) -> list[tuple[SumoOption, str]]:
    """The outputs that the user of this run requests besides the author's."""
    more = []
    for word in outputs:
        option = sumo_options().get(f"{word}-output")
        if option is None or option.kind != "FILE":
            found = [name for name in sumo_options() if name.endswith("-output")]
            known = ", ".join(sorted(name.removesuffix("-output") for name in found))
            raise ConfigError(
                f"--outputs {word!r}: SUMO has no such output; expected some of: {known}"
            )
        if not config.value(option.name):
            more.append((option, str(names.place(f"{word}.xml", names.folder, f"{word}.xml"))))
    return more


def _refuse_uneven_parquet(
    options: Sequence[tuple[SumoOption, str]], config: Configuration
) -> None:
    """Raise TownError where SUMO would die of an output that it writes as parquet."""
    fcd = [config.value(f"fcd-output.{key}") for key in ("attributes", "max-leader-distance")]
    for option, value in options:
        is_parquet = value.endswith(".parquet") or config.value("output.format") == "parquet"
        if is_parquet and re.match(_UNEVEN, f"{option.name} {fcd[0]} {fcd[1]}"):
            raise TownError(
                f"{config.path}: SUMO dies when it writes <{option.name}> as parquet; expected XML "
                "or CSV: end its file's name in .xml, without <output.format>"
            )


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
