"""Scenes: short streets of their authors, built with netconvert, and the seats of their chairs."""

import hashlib
import re
from pathlib import Path

import numpy as np

from wcsim.config import RunConfig, read_toml
from wcsim.config.scene import SceneFile
from wcsim.core import frames
from wcsim.core.constants import RECORDED
from wcsim.core.reading import SCENARIO, SCENE, is_file, read_bytes
from wcsim.errors import SumoError, TownError
from wcsim.towns.importing.adopt import copy_file
from wcsim.towns.importing.folder_texts import sumocfg_text, town_toml_text
from wcsim.towns.scenario.files import FilteredFiles, check_file
from wcsim.towns.scenario.town import Town, expanded, open_town, town_roots
from wcsim.towns.sumo.tools import run_tool
from wcsim.towns.sumo.xml_io import without_comments, write_gzip
from wcsim.types import SeatSpec, StartSpec

GOLDEN = "golden.trace"

NETCONVERT_FILES = (("-n", "nod"), ("-e", "edg"), ("-x", "con"), ("-t", "typ"))
"""Options of netconvert and netedit, and the kinds of files that they take."""

_MORE_FILES = ("add", "poly")
# Without normalisation, the net has the coordinates that the author wrote.
_OPTIONS = [
    "--walkingareas",
    "--junctions.corner-detail",
    "5",
    "--no-turnarounds",
    "--offset.disable-normalization",
]
XY = tuple[float, float]


def list_scenes() -> tuple[Path, ...]:
    """Folders of all scenes that can be found by name, sorted by name."""
    found: dict[str, Path] = {}
    for root in town_roots():
        for file in sorted((root / "scenes").glob("*/scene.toml")):
            found.setdefault(file.parent.name, file.parent)
    return tuple(found[name] for name in sorted(found))


def find_scene(name_or_path: str) -> Path:
    """The folder of a scene by name (in ./scenarios/sumo/scenes, then in the package) or path.

    Raises:
        TownError: There is no such scene.
    """
    scenes = {folder.name: folder for folder in list_scenes()}
    if name_or_path in scenes:
        return scenes[name_or_path]
    path = expanded(name_or_path)
    if name_or_path and is_file(path / "scene.toml"):
        return path
    known = ", ".join(scenes) or "(no scene is installed)"
    raise TownError(
        f"unknown scene {name_or_path!r}; expected one of: {known}, "
        "or a path to a folder with a scene.toml"
    )


def build_scene(folder: Path, work: Path) -> tuple[Town, SceneFile]:
    """Build a scene's net into `work` and return it as a town.

    Net coordinates are world coordinates.

    Raises:
        ConfigError: the `scene.toml` has a fault.
        TownError: a file of the scene is missing, broken, or elsewhere.
        SumoError: netconvert refuses it.
    """
    # 1. Build the net.
    scene = _scene_of(folder)
    name = scene.name
    work.mkdir(parents=True, exist_ok=True)
    options = ["--lefthand"] if scene.lefthand else []
    files = FilteredFiles(work.absolute(), folder)
    for option, kind in NETCONVERT_FILES:
        source = _only(folder, kind, needed=kind in ("nod", "edg"))
        if source is not None:
            options += [option, str(files.place(source.resolve(), folder))]
    plain = work / f"{name}.net.xml"
    run = run_tool("netconvert", [*options, *_OPTIONS, "-o", plain.name], work)
    if run.returncode:
        raise SumoError(
            f"scene {name}: no net could be built: {run.reason()}; "
            f"correct the XML files in {folder}"
        )
    write_gzip(work / f"{name}.net.xml.gz", without_comments(plain.read_bytes()))
    plain.unlink()

    # 2. Copy the other files beside it.
    additional = []
    for kind in ("rou", *_MORE_FILES):
        source = _only(folder, kind, needed=kind == "rou")
        if source is not None:
            copy_file(source, work / f"{name}.{kind}.xml")
            additional += [f"{name}.{kind}.xml"] if kind != "rou" else []

    # 3. Write what makes a town of them.
    text = sumocfg_text(name, scene.seed, routes=f"{name}.rou.xml", additional=tuple(additional))
    (work / f"{name}.sumocfg").write_text(text, encoding="utf-8")
    toml = town_toml_text(name=name, split="scene", kerb_height_m=scene.kerb_height_m)
    (work / "town.toml").write_text(toml, encoding="utf-8")
    return open_town(work / f"{name}.sumocfg"), scene


def scene_digest(folder: Path) -> str:
    """SHA-256 (hex) over the names and bytes of a scene's files."""
    digest = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        data = read_bytes(path, SCENARIO)
        digest.update(f"{path.name} {len(data)}\n".encode() + data)
    return digest.hexdigest()


def seat_specs(folder: Path, scene: SceneFile, origin_m: XY) -> tuple[SeatSpec, ...]:
    """The seats of the scene in `folder`, whose town has its origin at `origin_m` of the net.

    Raises:
        TownError: A recording is not there.
    """
    specs = []
    for seat in scene.seats:
        start = frames.world_from_net(np.array(seat.start_m), origin_m)
        goal = frames.world_from_net(np.array(seat.goal_m or seat.start_m), origin_m)
        profile = seat.profile
        if seat.recording is not None:
            file = folder / seat.recording
            check_file(file, folder, folder / "scene.toml")
            profile = f"{RECORDED}{file}"
        place = StartSpec(
            p_W_m=(float(start[0]), float(start[1])),
            yaw_rad=frames.yaw_from_sumo(seat.heading_deg),
            goal_W_m=(float(goal[0]), float(goal[1])),
        )
        specs.append(SeatSpec(profile=profile, start=place))
    return tuple(specs)


def scene_config(scene: SceneFile, base: RunConfig) -> RunConfig:
    """The same configuration with the scene's own settings of the world, which are not drawn."""
    street = base.world.street if scene.street == "usual" else scene.street
    own = {"warmup_s": scene.warmup_s, "attention_share": scene.attention_share, "street": street}
    vary = base.vary.model_copy(update={"attention": {}, "reaction": {}})
    return base.model_copy(update={"world": base.world.model_copy(update=own), "vary": vary})


def _scene_of(folder: Path) -> SceneFile:
    """The `scene.toml` of a scene. Raises ConfigError or TownError with every fault."""
    return read_toml(folder / "scene.toml", SceneFile, SCENE)


def _only(folder: Path, kind: str, *, needed: bool) -> Path | None:
    """The one file of a kind in the folder of a scene. Raises TownError for more of them."""
    paths = sorted(folder.glob(f"*.{kind}.xml"))
    found = [path for path in paths if re.fullmatch(r"[\w.-]+", path.name)]
    if len(found) > 1 or (needed and not found):
        expected = "one" if needed else "at most one"
        raise TownError(f"scene {folder}: has {len(found)} files *.{kind}.xml; expected {expected}")
    for path in found:
        check_file(path, folder, folder)
    return found[0] if found else None
