"""A new town's folder: the text files in it, and what may be in its place before."""

import json
import re
from pathlib import Path
from typing import Any

from wcsim.config import TownFile, parse
from wcsim.core.reading import join_names
from wcsim.errors import TownError
from wcsim.towns.scenario.town import NOT_TOWNS, TOWN_TOML, chair_ways, own_work
from wcsim.towns.sumo.xml_io import without_comments, write_gzip

_SUMOCFG = """\
<sumoConfiguration>
    <input>
        <net-file value="{name}.net.xml.gz"/>
        <route-files value="{routes}"/>
{additional}    </input>
    <time>
        <begin value="0"/>
        <step-length value="0.1"/>
    </time>
    <processing>
        <lateral-resolution value="0.8"/>
        <collision.action value="warn"/>
        <intermodal-collision.action value="warn"/>
        <collision.check-junctions value="true"/>
        <time-to-teleport value="300"/>
        <max-depart-delay value="120"/>
        <ignore-route-errors value="true"/>
        <default.speeddev value="0.1"/>
    </processing>
    <report>
        <no-step-log value="true"/>
    </report>
    <random_number>
        <seed value="{seed}"/>
    </random_number>
</sumoConfiguration>
"""


def sumocfg_text(name: str, seed: int, routes: str, additional: tuple[str, ...]) -> str:
    """A .sumocfg that opens in sumo-gui as it is: file names are relative.

    Vehicles that cannot depart within 120 s are dropped: in a run of days a blocked entry would
    else pile up for ever.
    """
    line = f'        <additional-files value="{",".join(additional)}"/>\n' if additional else ""
    return _SUMOCFG.format(name=name, seed=seed, routes=routes, additional=line)


def write_scenario(folder: Path, name: str, seed: int, vtypes: str) -> None:
    """Write <name>.sumocfg and <name>.add.xml, and pack <name>.net.xml and <name>.poly.xml.

    The demand is left out.
    """
    for kind in ("net", "poly"):
        plain = folder / f"{name}.{kind}.xml"
        write_gzip(folder / f"{plain.name}.gz", without_comments(plain.read_bytes()))
        plain.unlink()
    additional = f"{name}.add.xml", f"{name}.poly.xml.gz"
    (folder / additional[0]).write_text(vtypes, encoding="utf-8")
    text = sumocfg_text(name, seed, f"{name}.rou.xml.gz", additional)
    (folder / f"{name}.sumocfg").write_text(text, encoding="utf-8")


def town_toml_text(*, cycle_paths: bool = False, **values: Any) -> str:
    """`town.toml` with `values` by keys of `config.TownFile`, in its order, without empty texts.

    Raises:
        ConfigError: A value is none that a town can have.
    """
    file = parse(TownFile, {"chair_ways": chair_ways(cycle_paths), **values}, TOWN_TOML)
    keys = file.model_dump(mode="json", exclude={"hashes"}, exclude_none=True)
    lines = [f"{key} = {_quoted(value)}" for key, value in keys.items() if value != ""]
    if file.hashes:
        lines += ["", "[hashes]"]
        lines += [f"{_quoted(key)} = {_quoted(value)}" for key, value in file.hashes.items()]
    return "\n".join(lines) + "\n"


def check_words(name: str, split: str) -> None:
    """Raise TownError unless a town can have this name and this split."""
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", name):
        raise TownError(f"a town cannot be named {name!r}; expected letters, digits, - and _")
    if name in NOT_TOWNS:
        raise TownError(
            f"a town cannot be named {name!r}: that folder is reserved; choose another name"
        )
    if split not in ("train", "test"):
        raise TownError(f"unknown split {split!r} of town {name}; expected train or test")


def check_new(out: Path) -> None:
    """Raise TownError when a folder is there and not empty."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise TownError(f"{out} already exists; remove it, or choose another folder")


def check_place(out: Path, *, overwrite: bool) -> None:
    """Raise TownError when a folder holds something else than a town, or a town that was edited."""
    if out.exists() and not out.is_dir():
        raise TownError(f"{out} is a file; choose another folder, or remove it")
    if out.is_dir() and any(out.iterdir()) and not (out / "town.toml").is_file():
        raise TownError(f"{out} is not empty and not a town; choose another folder, or empty it")
    work = own_work(out) if (out / "town.toml").is_file() and not overwrite else ()
    if work:
        raise TownError(
            f"{out} contains files that were changed or added later: {join_names(work, 5)}; "
            "choose another name or --out, or use --replace, which discards them"
        )


def _quoted(value: object) -> str:
    """A value of TOML, which knows no pairs of escapes, as JSON writes them beyond 16 bits."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
