"""Hostile files of danger networks: their segments, and their checkpoints, hashes made to fit what was put there."""

import functools
import io
import json
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

from tests.agents.danger.sights import a_segment, lectures, small_config
from tests.attack.files.family import Family, Twist
from tests.attack.files.policies import CHANGES, bad_header, packed, unpacked
from tests.attack.scenarios.twists import Rng, cleared, integer, json_text, pick, spoiled, twisted
from wcsim.agents.danger.dataset import Dataset
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.rounds.train_rounds import _make_restore, _save_round
from wcsim.agents.runs.checkpoint import STATE, _restore_newest, checkpoint_number_from_path
from wcsim.agents.runs.data_folder import read_segment, segment_to_bytes
from wcsim.core import files
from wcsim.core.reading import is_file

ROUND = "round-007"
WEIGHTS, MOMENTS = "weights.safetensors", "moments.safetensors"
PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)


def families(work: Path) -> list[Family]:
    """A segment, and each file of a checkpoint."""
    learner, segment = _learner(), segment_to_bytes(a_segment(rows=6, ends=(3,)))
    _save_round(work, 7, learner, {"3-007-0000.npz.zst": "0" * 64})
    kinds = [Family(name="segment", file="a.npz.zst", sound=segment, twist=_segment_twist, take=_take_segment)]
    held = {name: (work / ROUND / name).read_bytes() for name in (STATE, WEIGHTS, MOMENTS)}
    for name, data in held.items():
        kinds.append(
            Family(
                name=f"round, {name.partition('.')[0]}",
                file=f"{ROUND}/{name}",
                sound=data,
                twist=_state_twist(json.loads(data)) if name == STATE else _tensors_twist(data),
                take=_take_round,
                beside=tuple((f"{ROUND}/{other}", held[other]) for other in held if other != name),
            )
        )
    cleared(work / ROUND)
    return kinds


@functools.cache
def _learner() -> DangerLearner:
    learner = DangerLearner(small_config(), 9, 60)
    learner.learn(lectures(small_config()), 2)
    return learner


# --- segments ---


def _take_segment(path: Path) -> bool:
    """What is read, written again, is read as the same, and can be learned from."""
    segment = read_segment(path)
    path.write_bytes(segment_to_bytes(segment))
    again = read_segment(path).arrays()
    Dataset(small_config()).add(segment)
    return all(np.array_equal(column, again[name]) for name, column in segment.arrays().items())


def _segment_twist(rng: Rng) -> tuple[bytes, str]:
    """A file of the zip is another, is packed otherwise, or is none; all hashes are right."""
    out, packing = io.BytesIO(), pick(rng, PACKINGS)
    columns = a_segment(rows=6, ends=(3,)).arrays()
    chosen, what = pick(rng, sorted(columns)), integer(rng, 6)
    with zipfile.ZipFile(out, "w", packing) as held:
        for name, column in columns.items():
            data = _npy(column)
            if name == chosen:
                if what == 0:
                    continue
                data = _other_npy(column, data, rng, what)
            held.writestr(f"{name}.npy", data)
    zipped = spoiled(out.getvalue(), rng)[0] if integer(rng, 3) == 0 else out.getvalue()
    return zstandard.ZstdCompressor(write_checksum=True).compress(zipped), f"{chosen} {what}, packed {packing}"


def _npy(column: Any) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array(out, column, allow_pickle=True)
    return out.getvalue()


def _other_npy(column: Any, data: bytes, rng: Rng, what: int) -> bytes:
    """Other numbers, a header that lies, or very many zeros."""
    if what == 1:
        value = pick(rng, (255, 1e38, np.nan, np.inf))
        return _npy(np.full_like(column, value if column.dtype.kind == "f" else 255))
    if what == 2:
        kinds = (column[:-1], column[:0], column[None], column.astype(object), column.astype(">f8"), column.ravel())
        return _npy(pick(rng, kinds))
    if what == 3:
        shapes = ("(-1,)", f"({2**62},)", "(0,)", "(" * 3000, "-" * 9000 + "1", "'x'", "(6, 2**70)", "((6,),)", "[6]")
        head = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {pick(rng, shapes)}, }}".ljust(117) + "\n"
        return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode() + b"x" * 9
    return bytes(pick(rng, (64, 1 << 20, 400 << 20))) if what == 4 and integer(rng, 20) == 0 else spoiled(data, rng)[0]


# --- checkpoints ---


def _state_twist(data: dict[str, Any]) -> Twist:
    def twist(rng: Rng) -> tuple[bytes, str]:
        changed, told = twisted(data, rng)
        text = json_text(changed)
        return (_sealed(text), f"{told}, sealed") if integer(rng, 4) else (text.encode(), told)

    return twist


def _sealed(text: str) -> bytes:
    """As it stands, with the right seal where it can have one."""
    try:
        data = json.loads(text)
        data.pop("seal", None)
        seal = files.sha256_from_text(json.dumps(data, sort_keys=True, allow_nan=False))
    except (ValueError, RecursionError, AttributeError):
        return text.encode()
    return json.dumps({**data, "seal": seal}).encode()


def _tensors_twist(data: bytes) -> Twist:
    def twist(rng: Rng) -> tuple[bytes, str]:
        tensors = unpacked(data)
        if integer(rng, 2):
            return bad_header(tensors, rng)
        changed, told = pick(rng, CHANGES)(tensors, rng)
        return packed(changed), told

    return twist


def _resealed(path: Path) -> None:
    """Give the state the hash that another file has by now."""
    state = path.with_name(STATE)
    if path.name != STATE and is_file(path) and path.stat().st_size < 1 << 24 and state.is_file():
        data = json.loads(state.read_text())
        with suppress(OSError):
            data["sha256"][path.name] = files.sha256_from_file(path)
        state.write_bytes(_sealed(json.dumps(data)))


def _take_round(path: Path) -> bool:
    _resealed(path)
    learner = _learner()
    found = _restore_newest(path.parents[1], _make_restore(learner))
    return _same(
        found.path, learner, lambda out: _save_round(out, checkpoint_number_from_path(found.path), learner, found.value)
    )


def _same(folder: Path, learner: DangerLearner, save: Callable[[Path], object]) -> bool:
    """Whether a learner holds what its files say, and is saved as the same again."""
    out = folder.parent / "again"
    save(out)
    again = out / folder.name
    said, now = (json.loads((place / STATE).read_text("utf-8-sig")) for place in (folder, again))
    keys = said.keys() - {"seal", "sha256", "schema_version"}
    tensors = all(
        unpacked((folder / name).read_bytes()) == unpacked((again / name).read_bytes()) for name in (WEIGHTS, MOMENTS)
    )
    return tensors and all(said[key] == now.get(key) for key in keys)
