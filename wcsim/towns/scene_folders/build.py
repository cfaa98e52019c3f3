"""Scenes: short hand-written streets, built with netconvert when they are needed, with the seats of their chairs."""

import hashlib
import re
from pathlib import Path

import numpy as np

from wcsim.config import RunConfig, read_toml
from wcsim.config.scene import SceneFile, SceneSeat
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
# normalisation off: the net keeps the coordinates that the author wrote
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

    Raises TownError.
    """
    scenes = {folder.name: folder for folder in list_scenes()}
    if name_or_path in scenes:
        return scenes[name_or_path]
    path = expanded(name_or_path)
    if name_or_path and is_file(path / "scene.toml"):
        return path
    known = ", ".join(scenes) or "(no scene is installed)"
    raise TownError(
        f"unknown scene {name_or_path!r}; expected one of: {known}, or a path to a folder with a scene.toml"
    )


def _scene_of(folder: Path) -> SceneFile:
    """The `scene.toml` of a scene.

    Raises ConfigError or TownError with every fault and its place.
    """
    return read_toml(folder / "scene.toml", SceneFile, SCENE)


def build_scene(folder: Path, work: Path) -> tuple[Town, SceneFile]:
    """Build a scene's net into `work` and return it as a town.

    Net coordinates are world coordinates.

    Raises:
        TownError: a file of the scene is missing, broken, or elsewhere.
        SumoError: netconvert refuses it.
    """
    scene = _scene_of(folder)
    work.mkdir(parents=True, exist_ok=True)
    _build_net(scene, folder, work)
    additional = []
    for kind in ("rou", *_MORE_FILES):
        source = _only(folder, kind, needed=kind == "rou")
        if source is not None:
            copy_file(source, work / f"{scene.name}.{kind}.xml")
            additional += [f"{scene.name}.{kind}.xml"] if kind != "rou" else []
    text = sumocfg_text(
        scene.name, scene.seed, routes=f"{scene.name}.rou.xml", additional=tuple(additional)
    )
    (work / f"{scene.name}.sumocfg").write_text(text, encoding="utf-8")
    toml = town_toml_text(name=scene.name, split="scene", kerb_height_m=scene.kerb_height_m)
    (work / "town.toml").write_text(toml, encoding="utf-8")
    return open_town(work / f"{scene.name}.sumocfg"), scene


def _build_net(scene: SceneFile, folder: Path, work: Path) -> None:
    name = scene.name
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
            f"scene {name}: no net could be built: {run.reason()}; correct the XML files in {folder}"
        )
    write_gzip(work / f"{name}.net.xml.gz", without_comments(plain.read_bytes()))
    plain.unlink()


def _only(folder: Path, kind: str, *, needed: bool) -> Path | None:
    found = sorted(
        path for path in folder.glob(f"*.{kind}.xml") if re.fullmatch(r"[\w.-]+", path.name)
    )
    if len(found) > 1 or (needed and not found):
        raise TownError(
            f"scene {folder}: has {len(found)} files *.{kind}.xml; expected {'one' if needed else 'at most one'}"
        )
    for path in found:
        check_file(path, folder, folder)
    return found[0] if found else None


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
    return tuple(_spec(folder, seat, origin_m) for seat in scene.seats)


def scene_config(scene: SceneFile, base: RunConfig) -> RunConfig:
    """The same configuration with the scene's own settings of the world.

    Who looks is not drawn, as it is the scene.
    """
    street = base.world.street if scene.street == "usual" else scene.street
    own = {"warmup_s": scene.warmup_s, "attention_share": scene.attention_share, "street": street}
    vary = base.vary.model_copy(update={"attention": {}, "reaction": {}})
    return base.model_copy(update={"world": base.world.model_copy(update=own), "vary": vary})


def _spec(folder: Path, wanted: SceneSeat, origin_m: XY) -> SeatSpec:
    start = frames.world_from_net(np.array(wanted.start_m), origin_m)
    goal = frames.world_from_net(np.array(wanted.goal_m or wanted.start_m), origin_m)
    profile = wanted.profile
    if wanted.recording is not None:
        file = folder / wanted.recording
        check_file(file, folder, folder / "scene.toml")
        profile = f"{RECORDED}{file}"
    return SeatSpec(
        profile=profile,
        start=StartSpec(
            p_W_m=(float(start[0]), float(start[1])),
            yaw_rad=frames.yaw_from_sumo(wanted.heading_deg),
            goal_W_m=(float(goal[0]), float(goal[1])),
        ),
    )
