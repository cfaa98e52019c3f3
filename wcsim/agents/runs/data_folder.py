"""Recorded driving: segments of some hundred ticks, in a folder with a manifest.

A segment is a world of its own with several chairs, one piece of work and one file of plain arrays
(NumPy's .npy format in a zip, compressed as a whole by zstd); nothing in it is code. It is written
in one step under the name of its key: a file that exists is whole, and is never written again.
"""

import hashlib
import io
import re
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import zstandard

from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY
from wcsim.agents.runs.policy_file import CAMERA_KEYS, SIGHT_KEYS, parse_saved
from wcsim.config import CameraConfig, ChairConfig, RunConfig
from wcsim.config.plant import read_own_plant_bytes
from wcsim.config.run_file import DrivingDataFile
from wcsim.core import files, reading
from wcsim.core.reading import SEGMENT, JsonObject, decompress_zstd, escape, read_bytes, read_json
from wcsim.errors import PolicyError
from wcsim.types import F32, F64, U8, Bool

Hashes = dict[str, str]  # SHA-256 of files, by name

# What chose an action: the user alone, the blinded oracle, the network, or the user's stick with a
# random offset.
FOLLOW, ORACLE, NETWORK, RECKLESS = range(4)
DRIVERS: Final = ("follow", "oracle", "network", "reckless")

# Codes of danger: the seconds until a crash in steps of 0.05 s, or safe.
SAFE: Final = 255
STEP_S: Final = 0.05

# Teachers that need no oracle, and what is learned from them.
BY_EVENTS: Final = MappingProxyType(
    {"crashes": "crashes that happened", "returns": "rewards that followed"}
)

MANIFEST: Final = "data.json"
# The data folder of a run.
DATA: Final = "data"
SEGMENTS: Final = "segments"
_NAME: Final = re.compile(r"([0-9]+)-([0-9]{3,})-([0-9]{4,})\.npz\.zst", re.ASCII)
# Of zstd.
_LEVEL: Final = 3
# Of a number, metres, seconds and newtons alike.
_LARGEST: Final = 1e9
# Unpacked data may have so many times the bytes of packed data, and these beside.
_MAX_RATIO: Final = 100
_FREE_BYTES: Final = 64 << 20
_SETTINGS: Final = (
    *("cameras.0.width_px", "cameras.0.height_px", "cameras.0.hfov_deg"),
    *("chair", "env.actions", "env.classes"),
)
# Also of the world that was seen. They are not in the digest, so that older folders' stay the same.
_ALSO: Final = (
    *(f"cameras.0.{key}" for key in SIGHT_KEYS if key != "hfov_deg"),
    *("env.camera", "world.tick_s"),
)
# What a message names where it differs.
_COMPARED: Final = (
    *(name for name in _SETTINGS if name != "chair"),
    *(f"chair.{key}" for key in ChairConfig.model_fields),
    *_ALSO,
)
# The kind of each column, and the numbers in a row; 0 for any number.
COLUMNS: Final[Mapping[str, tuple[str, tuple[int, ...]]]] = {
    **dict.fromkeys(("depth", "seg"), ("u1", (0, 0))),
    **dict.fromkeys(("visible", "truth"), ("u1", (0,))),
    **dict.fromkeys(("action", "driver", "delay"), ("u1", ())),
    **dict.fromkeys(("crashed", "own", "ended"), ("b1", ())),
    **dict.fromkeys(("odometry", "stick", "wish"), ("f4", (2,))),
    "imu": ("f4", (0,)),
    "reward": ("f4", ()),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingSegmentKey:
    """The place of a segment in a run's driving; its random numbers follow from it."""

    run: int  # its seed
    round: int
    index: int

    @property
    def name(self) -> str:
        """Its name in files and messages.

        >>> DrivingSegmentKey(run=3, round=0, index=12).name
        '3-000-0012'
        """
        return f"{self.run}-{self.round:03d}-{self.index:04d}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrivingSegment:
    """Steps of several chairs, sorted by chair and step: the observation, then the action."""

    # (N, H, W) newest image, see `supervisor/observation.py`; several cameras one below the other
    depth: U8
    seg: U8  # (N, H, W)
    imu: F32  # (N, I)
    odometry: F32  # (N, 2)
    stick: F32  # (N, 2) the user's
    wish: F32  # (N, 2) the stick that was answered: the user's, maybe with a random offset
    action: U8  # (N,) executed
    driver: U8  # (N,) see DRIVERS
    # (N, A) see `crash_times_to_codes`, of the oracle that knows what the cameras showed; (N, 0)
    # without one
    visible: U8
    truth: U8  # (N, A) or (N, 0), the same of the oracle that knows all
    reward: F32  # (N,) of the step
    crashed: Bool  # (N,) the step ended in a crash
    own: Bool  # (N,) in one of the chair's own fault, see `supervisor.rewards.judge_crash_fault`
    ended: Bool  # (N,) it was the last one of its episode here
    delay: U8  # (N,) ticks from a command to the chair that obeys it

    def __len__(self) -> int:
        """The number of steps."""
        return len(self.action)

    def arrays(self) -> dict[str, np.ndarray]:
        """All columns by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def segment_images(
    segment: DrivingSegment, row: int, eyes: Mapping[str, CameraConfig]
) -> dict[str, U8]:
    """The images (1, H, W) of a step by their keys in an observation; `eyes` of `RunConfig`."""
    ends = np.cumsum([camera.height_px for camera in eyes.values()])[:-1]
    return {
        prefix + key: image[None]
        for key, images in ((DEPTH_KEY, segment.depth), (CLASS_KEY, segment.seg))
        for prefix, image in zip(eyes, np.split(images[row], ends), strict=True)
    }


def join_segments(segments: list[DrivingSegment]) -> DrivingSegment:
    """The steps of several segments, one after the other. Raises ValueError for none."""
    if not segments:
        raise ValueError("no segments to join; expected one at least")
    columns = {
        name: np.concatenate([part.arrays()[name] for part in segments])
        for name in segments[0].arrays()
    }
    return DrivingSegment(**columns)


def crash_times_to_codes(first_s: F64) -> U8:
    """Seconds until a crash (A,), infinity for none, as codes of 0.05 s; 255 is safe.

    >>> crash_times_to_codes(np.array([0.0, 0.26, np.inf, 40.0])).tolist()
    [0, 5, 255, 254]
    """
    steps = np.where(
        np.isinf(first_s), SAFE, np.minimum(np.rint(np.minimum(first_s, 1e3) / STEP_S), SAFE - 1)
    )
    return steps.astype(np.uint8)


def mask_soon_unsafe_actions(codes: U8, ends: Bool, ahead: int) -> Bool:
    """(N, A) the positions that are unsafe now or within `ahead` steps, as long as one is safe.

    Args:
        codes: (N, A) of successive steps, see `crash_times_to_codes`.
        ends: (N,) with which an episode ended.
        ahead: Steps to look ahead.
    """
    safe = codes == SAFE
    allowed = safe.copy()
    at = np.arange(len(codes))
    for _ in range(ahead):
        goes_on = ~ends[at] & (at < len(codes) - 1)
        at = np.where(goes_on, at + 1, at)
        both = allowed & safe[at]
        allowed = np.where(both.any(axis=1, keepdims=True), both, allowed)
    unsafe: Bool = ~allowed
    return unsafe


def segment_path_from_name(folder: Path, name: str) -> Path:
    """Where the segment of that name lies, see `DrivingSegmentKey`."""
    return folder / SEGMENTS / f"{name}.npz.zst"


def segment_key_from_name(name: str) -> DrivingSegmentKey:
    """The key of a segment's file. Raises PolicyError for any other name.

    >>> segment_key_from_name("3-010-0007.npz.zst")
    DrivingSegmentKey(run=3, round=10, index=7)
    """
    found = _NAME.fullmatch(name)
    if found is None:
        raise PolicyError(
            f"{escape(name)!r} is no segment's file; expected SEED-ROUND-INDEX.npz.zst"
        )
    run, number, index = map(int, found.groups())
    return DrivingSegmentKey(run=run, round=number, index=index)


def sort_segment_names(segments: Iterable[str]) -> list[str]:
    """Names of segments in the order of learning. Raises as `segment_key_from_name`.

    >>> sort_segment_names(["3-1000-0000.npz.zst", "3-999-0001.npz.zst", "3-999-0000.npz.zst"])
    ['3-999-0000.npz.zst', '3-999-0001.npz.zst', '3-1000-0000.npz.zst']
    """
    return sorted(segments, key=lambda name: (segment_key_from_name(name).round, name))


def segment_to_bytes(segment: DrivingSegment) -> bytes:
    """A segment as its file holds it, compressed."""
    return zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True).compress(_packed(segment))


def read_segment(path: Path, sha256: str = "") -> DrivingSegment:
    """Read a segment.

    Raises:
        PolicyError: It is missing, truncated, damaged, or has another hash than `sha256`.
    """
    data = read_bytes(path, SEGMENT)
    digest = hashlib.sha256(data).hexdigest()
    if sha256 and digest != sha256:
        raise PolicyError(
            f"{escape(path)} has SHA-256 {digest[:12]}..., expected {sha256[:12]}...: damaged or "
            "replaced; collect it again"
        )
    try:
        columns = _columns(data)
    except Exception as error:  # of zstd, zipfile or NumPy, by what is wrong with the bytes
        raise PolicyError(
            f"{escape(path)} cannot be read ({escape(error)}); expected a segment as `wcsim "
            "collect` writes it"
        ) from None
    _require_whole(path, columns)
    return DrivingSegment(**columns)


def write_data_manifest(folder: Path, config: RunConfig, towns: Hashes, segments: Hashes) -> str:
    """Write the folder's settings, its towns with their hashes, and the segments' hashes by name.

    Returns:
        The SHA-256 of all segments, see `hash_segments`.

    Raises:
        ConfigError: The user's own plant file cannot be read.
    """
    digest = hash_segments(segments)
    data = {
        "schema_version": 3,
        "settings_sha256": _settings_digest(config),
        "config": config.model_dump(mode="json"),
        "plant_sha256": _plant_sha256(config),
        "towns": towns,
        "segments": segments,
        "data_sha256": digest,
    }
    files.write_json(folder / MANIFEST, data)
    return digest


def read_data_manifest(folder: Path) -> DrivingDataFile:
    """Read `data.json`. Raises PolicyError."""
    path = folder / MANIFEST
    return parse_saved(DrivingDataFile, read_json(path, reading.DATA), escape(path))


def require_same_data_settings(folder: Path, file: DrivingDataFile, config: RunConfig) -> None:
    """Refuse data of another camera, chair, action set or tick.

    Raises:
        PolicyError: It is.
        ConfigError: The user's own plant file cannot be read.
    """
    recorded = _by_content(file.config, file.plant_sha256)
    own = config_to_plain_settings(config)
    further = range(1, len(config.eyes))
    names = (*_COMPARED, *(f"cameras.{n}.{key}" for n in further for key in CAMERA_KEYS))
    other = [name for name in names if _part(recorded, name) != _part(own, name)]
    if other or file.settings_sha256 != _settings_digest(config):
        raise PolicyError(
            f"{escape(folder)} was driven with other settings "
            f"({', '.join(other) or 'of another version'}); expected "
            "those of this run: train with the configuration in its data.json"
        )


def _settings_digest(config: RunConfig) -> str:
    """SHA-256 over the settings that data and its learner share: camera, chair, actions."""
    settings = config_to_plain_settings(config)
    parts = [_part(settings, name) for name in _SETTINGS]
    return files.sha256_from_text(repr(parts))


def config_to_plain_settings(config: RunConfig) -> JsonObject:
    """All settings as plain values; the user's own plant by its file's hash, not its path.

    Raises:
        ConfigError: The file cannot be read.
    """
    return _by_content(config.model_dump(mode="json"), _plant_sha256(config))


def _plant_sha256(config: RunConfig) -> str:
    """SHA-256 of the user's own plant file; "" for a plant that comes with wcsim."""
    text = read_own_plant_bytes(config.chair.plant)
    return hashlib.sha256(text).hexdigest() if text else ""


def _by_content(dumped: JsonObject, plant_sha256: str) -> JsonObject:
    chair = dumped.get("chair")
    if not plant_sha256 or not isinstance(chair, dict):
        return dumped
    return {**dumped, "chair": {**chair, "plant": plant_sha256}}


def hash_segments(segments: Hashes) -> str:
    """SHA-256 over all segments, in any order."""
    rows = (f"{name} {segments[name]}" for name in sorted(segments))
    return files.sha256_from_text("\n".join(rows))


def _part(dumped: JsonObject, name: str) -> Any:
    here: Any = dumped
    for word in name.split("."):
        if word.isdecimal():
            here = here[int(word)] if isinstance(here, list) and int(word) < len(here) else None
        else:
            here = here.get(word) if isinstance(here, dict) else None
    return here


def _columns(data: bytes) -> dict[str, np.ndarray]:
    """The arrays of a packed segment from any source.

    Raises:
        Exception: The bytes are damaged: an error of NumPy, zipfile or zstd, or ValueError.
    """
    unpacked = decompress_zstd(data, min(SEGMENT.limit_bytes, _FREE_BYTES + _MAX_RATIO * len(data)))
    with zipfile.ZipFile(io.BytesIO(unpacked)) as held:
        # Stored items alone, so that none unpacks to more.
        if any(item.compress_type != zipfile.ZIP_STORED for item in held.infolist()):
            raise ValueError("packed in another way")
        names = [
            field.name
            for field in fields(DrivingSegment)
            if field.name != "own" or "own.npy" in held.namelist()
        ]
        columns = {
            name: np.lib.format.read_array(io.BytesIO(held.read(f"{name}.npy"))) for name in names
        }
    # Older data does not record whose fault a crash was: then none counts as the chair's own.
    return {"own": np.zeros_like(columns["crashed"]), **columns}


def _require_whole(path: Path, columns: dict[str, np.ndarray]) -> None:
    wrong = [name for name, (kind, wide) in COLUMNS.items() if not _fits(columns[name], kind, wide)]
    if wrong:
        raise PolicyError(
            f"{escape(path)} has another form ({', '.join(wrong)}); expected a segment of this "
            "version"
        )
    lengths = {len(column) for column in columns.values()}
    finite = all(
        (np.abs(column) <= _LARGEST).all()
        for column in columns.values()
        if column.dtype.kind == "f"
    )
    if len(lengths) != 1 or not finite:
        raise PolicyError(
            f"{escape(path)} has columns of {sorted(lengths)} rows, or numbers not finite or too "
            "large; collect it again"
        )
    pictures = columns["depth"].shape == columns["seg"].shape
    actions = columns["visible"].shape[1]
    labels = actions == columns["truth"].shape[1]
    acted = columns["action"].max(initial=0) < (actions or SAFE)
    if (
        0 in lengths
        or not (pictures and acted and labels)
        or columns["driver"].max() >= len(DRIVERS)
    ):
        raise PolicyError(
            f"{escape(path)} has columns that do not fit each other; collect it again"
        )


def _fits(column: np.ndarray, kind: str, wide: tuple[int, ...]) -> bool:
    """Whether a column is of that kind, and its rows of that form; 0 is any number."""
    rows = column.shape[1:]
    return (
        column.dtype.str.lstrip("<|") == kind
        and len(column.shape) == 1 + len(wide)
        and all(size in (0, row) for size, row in zip(wide, rows, strict=True))
    )


def _packed(segment: DrivingSegment) -> bytes:
    """An .npz file; `np.savez` would write the time into it."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as held:
        for name, column in segment.arrays().items():
            array = io.BytesIO()
            np.lib.format.write_array(array, np.ascontiguousarray(column), allow_pickle=False)
            held.writestr(zipfile.ZipInfo(f"{name}.npy"), array.getvalue())
    return out.getvalue()
