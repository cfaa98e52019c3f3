"""Attack by maps: extracts, nets, heights, town.toml and scenes, spoilt in their bytes, their size or their place."""

import bz2
import functools
import gzip
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import osmium
import rasterio
from numpy.random import Generator
from rasterio.transform import from_bounds

from tests.attack.outcomes import LIMIT_BYTES, Case
from tests.attack.scenarios.parts import ENCODINGS, PACKINGS
from tests.cli.towns import tiny_osm
from tests.towns.fuzz.flipped_bytes import DISK, RAW, pick
from wcsim.core.seeding import make_rng
from wcsim.errors import WcsimError
from wcsim.towns.checks.validate import _scan_net
from wcsim.towns.importing.elevation import Heights, _own_projections, make_dem
from wcsim.towns.osm.read import Box, read_extract
from wcsim.towns.scenario.town import open_town
from wcsim.towns.scene_folders.build import _scene_of, build_scene, find_scene
from wcsim.towns.sumo.net import Net, read_net
from wcsim.towns.sumo.xml_io import MAX_XML_BYTES, read_bytes, read_root

BOX = Box(24.999, 59.9995, 25.0046, 60.0023)
LIMIT_S = 10.0  # of a machine that does other things as well; the rule of five holds for one alone
SOUND_EVERY = 100  # one of so many is as it was, and must be taken
_KINDS = ("osm", "osm.gz", "osm.bz2", "net", "net.gz", "tif", "toml", "scene")
_SLOW_EVERY = 200  # one of so many starts a tool: libosmium for a .pbf, netconvert for a scene
_TOML = b"""name = "mine"
split = "train"
origin_m = [10, 20]
kerb_height_m = 0.12
sumocfg = "a.sumocfg"
[hashes]
a = "b"
"""
_WORDS = (
    *(b"[" * 60_000, b"a." * 400 + b"a = 1\n", b"9" * 5000, b"\nx = inf\n", b'\nsumocfg = "../x/a.sumocfg"\n', b"<!--"),
    *(
        b'sumocfg = "/etc/passwd"\n',
        b'sumocfg = "\\u0000"\n',
        b"\0",
        b"\xff\xfe",
        b"<a>" * 5000,
        b"&#0;",
        b"<![CDATA[",
        b"]]>",
    ),
    *(
        b"nan",
        b"1e999",
        b"-1",
        b'"' * 9000,
        b" " * 200_000,
        b"<include href='/etc/hostname'/>",
        b"<!DOCTYPE a>",
        b"\x1b[31m",
    ),
)
_TOKENS = (
    b'"mine"',
    b"10",
    b"0.12",
    b'"a.sumocfg"',
    b"60.000",
    b"25.0",
    b'id="',
    b"<node",
    b"</way>",
    b"<lane",
    b"shape=",
)


class NotTakenError(Exception):
    """A sound file was refused, or one that was taken does not make the same again."""


@dataclass(frozen=True, slots=True)
class Target:
    """A sound file, and how wcsim takes it: again from what it made of it, where it can be written."""

    name: str
    data: bytes
    take: Callable[[Path], None]


def cases(count: int, seed: int, work: Path) -> Iterator[Case]:
    """Spoilt files of every kind, one after the other."""
    for number in range(count):
        kind = _KINDS[number % len(_KINDS)]
        if number % _SLOW_EVERY == _SLOW_EVERY - 1:
            kind = "pbf" if number % (2 * _SLOW_EVERY) < _SLOW_EVERY else "built"
        feed = partial(_feed, kind, number, seed, work)
        name, most = f"{kind} {number} of {seed}", LIMIT_BYTES + MAX_XML_BYTES  # a net may be as large as that
        yield Case(area=f"maps, {kind}", name=name, feed=feed, limit_s=LIMIT_S, limit_bytes=most)


def _feed(kind: str, number: int, seed: int, work: Path) -> bool:
    target, rng = targets()[kind], make_rng(seed, "maps", number)
    sound = (number // len(_KINDS)) % SOUND_EVERY == 0
    with _place(work / f"map-{number}") as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        path = _written(target, folder)
        done = "nothing" if sound else spoil(path, rng)
        before = sorted(folder.rglob("*"))
        try:
            target.take(path)
        except WcsimError as error:
            if sound:
                raise NotTakenError(str(error)) from error
            raise
        except Exception as error:
            raise NotTakenError(f"{done}: {error!r}") from error
        finally:
            (folder / "again").exists() and shutil.rmtree(folder / "again")
        if sorted(folder.rglob("*")) != before:
            raise NotTakenError(f"{done}: left {sorted(set(folder.rglob('*')) - set(before))}")
    return True


def spoil(path: Path, rng: Generator) -> str:
    """Change a file in one way, and say in which."""
    way = float(rng.random())
    if way < 0.06:
        name = pick(rng, (*sorted(DISK), "device", "link", "loop", "giant"))
        _misplace(path, name)
        return name
    data = path.read_bytes()
    if way < 0.16:
        name = pick(rng, sorted(RAW))
        try:
            path.write_bytes(RAW[name](data, rng))
        except (UnicodeDecodeError, ValueError):  # it is no text
            path.write_bytes(data[::-1])
        return name
    if way < 0.26:
        packing = int(rng.integers(len(PACKINGS)))
        path.write_bytes(PACKINGS[packing](data))
        return f"packing {packing}"
    if way < 0.34:
        codec = pick(rng, ENCODINGS)[1]
        path.write_bytes(data.decode("latin-1").encode(codec, "replace"))
        return codec
    changed = bytearray(data)
    for _ in range(pick(rng, (1, 1, 2, 5))):
        _change(changed, rng)
    path.write_bytes(changed)
    return "bytes"


def _change(data: bytearray, rng: Generator) -> None:
    """One change to bytes; where the file begins and where it ends are hit more often than by chance."""
    size = max(1, len(data))
    place = int(pick(rng, (rng.integers(size), rng.integers(min(size, 400)), size - 1 - rng.integers(min(size, 200)))))
    other, length = int(rng.integers(size)), int(pick(rng, (1, 4, 30, 500)))
    way = int(rng.integers(7))
    if way == 0:
        data[place : place + 1] = bytes([data[place] ^ 1 << int(rng.integers(8))]) if data else b"x"
    elif way == 1:
        del data[place:]
    elif way == 2:
        del data[place : place + length]
    elif way == 3:
        data[place:place] = data[other : other + length]
    elif way == 4:
        data[place:place] = pick(rng, _WORDS)
    elif way == 5:
        data[place : place + length] = rng.integers(256, size=length, dtype=np.uint8).tobytes()
    else:
        token = pick(rng, _TOKENS)
        at = data.find(token, place)
        if at >= 0:
            data[at : at + len(token)] = pick(rng, _WORDS)


def _misplace(path: Path, name: str) -> None:
    if name in DISK:
        DISK[name](path)
        return
    path.unlink()
    if name == "giant":
        with path.open("wb") as file:
            file.write(b"<osm>")
            file.truncate(3 << 30)
    else:
        path.symlink_to({"device": "/dev/zero", "link": "/etc/hostname", "loop": path.name}[name])


# --- what is taken, and made again ---


@functools.cache
def targets() -> dict[str, Target]:
    """A sound file of each kind."""
    osm = tiny_osm().encode()
    with tempfile.TemporaryDirectory() as folder:
        town = build_scene(find_scene("pedestrian-crossing"), Path(folder))[0]
        net = read_bytes(town.net)
        (Path(folder) / "a.osm").write_bytes(osm)
        with osmium.SimpleWriter(str(Path(folder) / "a.osm.pbf")) as writer:
            for item in osmium.FileProcessor(str(Path(folder) / "a.osm")):
                writer.add(item)
        pbf = (Path(folder) / "a.osm.pbf").read_bytes()
        tif = _heights(Path(folder) / "a.tif")
    scene = (find_scene("pedestrian-crossing") / "scene.toml").read_bytes()
    made = (
        Target("a.osm", osm, _take_extract),
        Target("a.osm.gz", gzip.compress(osm), _take_extract),
        Target("a.osm.bz2", bz2.compress(osm), _take_extract),
        Target("a.net.xml", net, _take_net),
        Target("a.net.xml.gz", gzip.compress(net), _take_net),
        Target("a.tif", tif, _take_heights),
        Target("town.toml", _TOML, _take_town),
        Target("scene.toml", scene, _take_scene),
        Target("a.osm.pbf", pbf, _take_extract),
        Target("spoilt.edg.xml", next(find_scene("pedestrian-crossing").glob("*.edg.xml")).read_bytes(), _build),
    )
    return dict(zip((*_KINDS, "pbf", "built"), made, strict=True))


def _heights(path: Path) -> bytes:
    west, south, east, north = (BOX[0] - 0.02, BOX[1] - 0.02, BOX[2] + 0.02, BOX[3] + 0.02)
    rows, cols = np.meshgrid(np.linspace(0.0, 9.0, 60), np.linspace(0.0, 5.0, 60), indexing="ij")
    profile = {"driver": "GTiff", "width": 60, "height": 60, "count": 1, "dtype": "float32", "crs": "EPSG:4326"}
    profile |= {"transform": from_bounds(west, south, east, north, 60, 60), "compress": "deflate"}
    with _own_projections(), rasterio.open(path, "w", **profile) as file:
        file.write((rows + cols).astype(np.float32), 1)
        file.update_tags(note="x" * 20)
    return path.read_bytes()


def _again(path: Path, name: str) -> Path:
    folder = path.parent / "again"
    folder.mkdir(exist_ok=True)
    return folder / name


def _take_extract(path: Path) -> None:
    first = read_extract(path, BOX)
    copy = _again(path, "b.osm")
    copy.write_bytes(first.xml())
    second = read_extract(copy, BOX)
    _require((second.xml(), second.box) == (first.xml(), first.box), "another extract")


def _take_net(path: Path) -> None:
    root = read_root(path)
    _scan_net(root, str(path))
    first = read_net(path)
    copy = _again(path, "b.net.xml")
    copy.write_bytes(ElementTree.tostring(root, encoding="utf-8"))
    _require(_told(read_net(copy)) == _told(first), "another net")
    _require(all(np.isfinite(lane.points_m).all() for edge in first.edges for lane in edge.lanes), "no numbers")


def _told(net: Net) -> str:
    with np.printoptions(threshold=100_000):
        return repr(net)


def _take_heights(path: Path) -> None:
    relief = Heights(dem=path)
    first = make_dem(relief, BOX, 0)
    assert first is not None
    _require(bool(np.isfinite(first.height_m).all()) and float(np.abs(first.height_m).max()) < 9000.0, "no heights")
    first.write(relief.max_grade, _again(path, "b.tif"))
    second = make_dem(Heights(dem=path.parent / "again" / "b.tif"), BOX, 0)
    assert second is not None
    _require(bool(np.allclose(second.height_m, first.height_m, atol=1e-2)), "other heights")


def _take_town(path: Path) -> None:
    town = open_town(path.parent)
    _require(town.sumocfg.resolve().is_relative_to(path.parent.resolve()), f"{town.sumocfg} is elsewhere")
    _require(type(town.file).model_validate(town.file.model_dump()) == town.file, "another town.toml")


def _take_scene(path: Path) -> None:
    scene = _scene_of(path.parent)
    _require(type(scene).model_validate(scene.model_dump()) == scene, "another scene.toml")


def _build(path: Path) -> None:
    for file in find_scene("pedestrian-crossing").iterdir():
        if file.suffix in (".xml", ".toml") and not file.name.endswith(".edg.xml"):
            shutil.copyfile(file, path.parent / file.name)
    try:
        build_scene(path.parent, _again(path, "built"))
    finally:
        for file in [file for file in path.parent.iterdir() if file.is_file() and file != path]:
            file.unlink()


def _require(good: bool, told: str) -> None:
    if not good:
        raise NotTakenError(told)


def _written(target: Target, folder: Path) -> Path:
    if target.name == "town.toml":
        (folder / "a.sumocfg").write_bytes(b"<c><n value='a.net.xml'/></c>")
        (folder / "a.net.xml").write_bytes(b'<net><location convBoundary="0,0,9,9"/></net>')
    path = folder / target.name
    path.write_bytes(target.data)
    return path


@contextmanager
def _place(folder: Path) -> Iterator[Path]:
    folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder)
