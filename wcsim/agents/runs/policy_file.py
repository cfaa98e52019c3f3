"""Names of policies (`dwa@0.5`, `runs/a:phase1`, `veto:shipped@0.2`, `tcp:5000`); their folders.

`parse_policy_name` reads such a name in one place. Nothing of the policy is loaded here, nor is
torch.
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal

import wcsim
from wcsim.agents.policy_api import (
    BASELINES,
    LEVELLED,
    MODEL_FILE,
    SERVED,
    UPPER_BOUNDS,
    VETO,
    level_of,
)
from wcsim.config import RunConfig, parse
from wcsim.config.load import M
from wcsim.config.run_file import DangerPolicyFile, QPolicyFile, ShippedPolicyHashes
from wcsim.core import files
from wcsim.core.reading import HASHES, POLICY, JsonObject, escape, is_file, is_folder, read_json
from wcsim.errors import ConfigError, PolicyError

POLICY_JSON: Final = "policy.json"
WEIGHTS: Final = "weights.safetensors"

# Of a camera: what makes the same street look different to a network. A key here is compared
# wherever a network meets a camera: tests, collected data, recordings to export with. A new key
# needs `exclude_if` at its default, or all older data folders would differ.
SIGHT_KEYS: Final = (
    *("hfov_deg", "range_m", "near_m", "p_BC_m"),
    *("yaw_deg", "pitch_deg", "roll_deg"),
)
CAMERA_KEYS: Final = ("width_px", "height_px", *SIGHT_KEYS)

SHIPPED: Final = "shipped"
FILES: Final = "files.json"
# Laws of the shipped policy for machines without PyTorch, by their delay in ticks.
EXPORTED: Final = MappingProxyType({0: "model-0.onnx", 2: "model.onnx"})
HELD: Final = (
    "policy.json",
    "weights.safetensors",
    *EXPORTED.values(),
    "meaning.json",
    "reference.npz",
    "MODEL_CARD.md",
)

STAGES: Final = ("phase1", "final")
_LEVEL: Final = re.compile(r"\d+(\.\d*)?|\.\d+")
Kind = Literal["baseline", "served", "onnx", "class", "shipped", "folder"]


def read_value_policy_file(path: Path) -> QPolicyFile:
    """Read and check `policy.json` of a network that gives values. Raises PolicyError."""
    return parse_saved(QPolicyFile, _read(path), escape(path / POLICY_JSON))


def read_danger_policy_file(path: Path) -> DangerPolicyFile:
    """Read and check `policy.json` of a danger network. Raises PolicyError."""
    return parse_saved(DangerPolicyFile, _read(path), escape(path / POLICY_JSON))


def read_policy_algorithm(path: Path) -> object:
    """The algorithm in `policy.json`, unchecked. Raises PolicyError when it is no policy folder."""
    return _read(path).get("algorithm")


def parse_saved(model: type[M], data: JsonObject, where: str) -> M:
    """`parse` for what a run, a policy or a data folder holds. Raises PolicyError."""
    try:
        return parse(model, data, where)
    except ConfigError as error:
        again = (
            ": another version wrote it, make it again" if "schema_version" in str(error) else ""
        )
        raise PolicyError(f"{error}{again}") from None


def _read(path: Path) -> JsonObject:
    if not is_file(path / POLICY_JSON):
        raise PolicyError(
            f"{escape(path)} is not a policy folder: it has no {POLICY_JSON}; expected a folder "
            "as `wcsim train` writes it, for example runs/a/policies/final, or RUN:phase1"
        )
    return read_json(path / POLICY_JSON, POLICY)


def get_shipped_policy_path() -> Path:
    """Where it lies in this wcsim, whether it is there or not."""
    return Path(wcsim.__file__).parent / "agents" / SHIPPED


def find_shipped_policy(place: Path | None = None) -> Path:
    """The folder of the shipped policy, its files compared with their hashes.

    Args:
        place: Another folder than the one that comes with wcsim.

    Raises:
        PolicyError: None came with this wcsim, or a file differs from what was shipped.
    """
    folder = get_shipped_policy_path() if place is None else place
    if not is_file(folder / FILES):
        raise PolicyError(
            f"this wcsim comes without a policy: {escape(folder)} has no {FILES}; expected one "
            "made by tools/ship_policy.py RUN: name a run of your own"
        )
    data, where = read_json(folder / FILES, HASHES), escape(folder / FILES)
    hashes = parse_saved(ShippedPolicyHashes, data, where).sha256
    missing = [name for name in HELD if name not in hashes or not is_file(folder / name)]
    other = [
        name
        for name in HELD
        if name not in missing and files.sha256_from_file(folder / name) != hashes[name]
    ]
    if missing or other:
        raise PolicyError(
            f"{escape(folder)} differs from what was shipped: {', '.join(missing + other)} "
            f"{'missing' if missing else 'damaged or replaced'}; install wcsim again"
        )
    return folder


@dataclass(frozen=True, slots=True, kw_only=True)
class _PolicyName:
    """The parts of a policy's name."""

    inner: str  # the name without a veto
    veto: bool
    kind: Kind
    place: str  # without veto and level: RUN:stage, FOLDER, module:Class, an address, or a word
    stage: str = ""  # of RUN:stage
    level: float | None = None  # of assistance, or the threshold of dangers

    @property
    def folder(self) -> Path:
        """Where a run, a policy folder or an ONNX folder lies."""
        return Path(self.place.removesuffix(f":{self.stage}") if self.stage else self.place)

    @property
    def is_network(self) -> bool:
        """Whether it is a network that wcsim trained, in a run, a folder of its own, or shipped."""
        return self.kind in ("shipped", "folder")


def parse_policy_name(text: str) -> _PolicyName:
    """The parts of a policy's name; whether there is such a policy is not asked.

    >>> parse_policy_name("veto:dwa@0.5").kind, parse_policy_name("runs/a:phase1@0.2").stage
    ('baseline', 'phase1')
    >>> parse_policy_name("mine:Policy").kind
    'class'

    Raises:
        PolicyError: It ends with a level that there is not.
    """
    veto, name = text.startswith(VETO), text.removeprefix(VETO)
    word = name.partition("@")[0]
    if word == LEVELLED or name in (*BASELINES, *UPPER_BOUNDS):
        return _PolicyName(inner=name, veto=veto, kind="baseline", place=word, level=level_of(name))
    if name.startswith(SERVED):
        return _PolicyName(inner=name, veto=veto, kind="served", place=name)
    if name != SHIPPED and is_file(Path(name) / MODEL_FILE):
        return _PolicyName(inner=name, veto=veto, kind="onnx", place=name)
    place, level = _with_threshold(name)
    run, colon, stage = place.rpartition(":")
    if colon and stage not in STAGES and not is_folder(Path(run)):
        return _PolicyName(inner=name, veto=veto, kind="class", place=name)
    kind: Kind = "shipped" if place == SHIPPED else "folder"
    stage = stage if colon and not is_folder(Path(place)) else ""
    return _PolicyName(inner=name, veto=veto, kind=kind, place=place, stage=stage, level=level)


def _with_threshold(name: str) -> tuple[str, float | None]:
    """A name without the threshold that it may end with, and that threshold; `b@home` has none."""
    head, at, text = name.rpartition("@")
    if not at or not _LEVEL.fullmatch(text):
        return name, None
    level = float(text)
    if not 0.0 < level <= 1.0:
        raise PolicyError(
            f"policy {escape(name)!r} has no such level of assistance; expected RUN@L with a "
            "danger threshold L above 0 and at most 1"
        )
    return head, level


def require_danger_policy_fits(folder: Path, name: str, config: RunConfig) -> None:
    """Refuse a danger network of another camera, class form or action set. Raises PolicyError."""
    file = read_danger_policy_file(folder)
    learned, seen = (file.camera, *file.more_cameras), tuple(config.eyes.values())
    if len(learned) > len(seen):
        raise PolicyError(
            f"policy {name!r} was trained with {len(learned)} cameras, this test has {len(seen)}; "
            f"expected env.camera={json.dumps([camera.name for camera in learned])}"
        )
    # It does not look at further ones.
    pairs = zip(learned, seen, strict=False)
    other = [key for a, b in pairs for key in CAMERA_KEYS if getattr(a, key) != getattr(b, key)]
    if file.net.actions != config.env.actions:
        other.append("actions")
    if file.classes != config.env.classes:
        other.append("classes")
    if other:
        raise PolicyError(
            f"policy {name!r} was trained with another camera, class form or action set "
            f"({', '.join(other)} differ): set these as in its training, or test it on its own"
        )
