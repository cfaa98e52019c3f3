"""Hostile policies: descriptions that are spoilt or ask for too much, weights of every wrong kind."""

import functools
import hashlib
import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.agents.toy import ToyStreet, toy_camera
from tests.attack.outcomes import Case
from tests.attack.scenarios.twists import (
    NASTY,
    PLACES,
    Data,
    Rng,
    cleared,
    draws,
    integer,
    json_text,
    pick,
    spoiled,
    twisted,
)
from wcsim.agents.learning.build import build_q_learner
from wcsim.agents.learning.saved_policy import load_policy, save_policy
from wcsim.agents.runs.policy_file import POLICY_JSON, WEIGHTS
from wcsim.config import LearnConfig, RunConfig

CAMERA = toy_camera(24, 32)
WIDTHS = {"F64": 8, "F32": 4, "F16": 2, "BF16": 2, "I64": 8, "I32": 4, "I16": 2, "I8": 1, "U8": 1, "BOOL": 1,
          "F8_E4M3": 1, "F8_E5M2": 1, "C64": 8, "U64": 8, "F4": 1, "x": 4, "": 4}  # fmt: skip
SOUND_NETWORKS = ("patch", "conv3d", "patch", "fig6")
SIZES = (0, 1, 7, 8, 64, 4096, 65_536, 10**7, 2**31, 2**63, 2**64 - 1)
Tensors = dict[str, tuple[str, list[Any], bytes]]  # type, shape and bytes of each
Changed = tuple[Tensors, str]
Change = Callable[[Tensors, Rng], Changed]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sound:
    """A policy as wcsim wrote it, and what it sees."""

    about: Data
    weights: bytes
    observation: Data


def sound_policy(work: Path, network: str = "patch") -> Sound:
    """A small one, of a network that was never trained."""
    config = RunConfig(cameras=(CAMERA,), learn=LearnConfig(replay_frames=100, network=network))
    env = ToyStreet(CAMERA)
    folder = save_policy(work / "sound", build_q_learner(config, env, 0), CAMERA, "ab" * 32)
    about, weights = json.loads((folder / POLICY_JSON).read_text()), (folder / WEIGHTS).read_bytes()
    cleared(folder)
    return Sound(about=about, weights=weights, observation=env.reset(seed=2)[0])


# --- the format of the weights, written here once more ---


def unpacked(data: bytes) -> Tensors:
    """The tensors of a safetensors file."""
    size = int.from_bytes(data[:8], "little")
    head, body = json.loads(data[8 : 8 + size]), data[8 + size :]
    return {
        name: (entry["dtype"], entry["shape"], body[slice(*entry["data_offsets"])])
        for name, entry in head.items()
        if name != "__metadata__"
    }


def packed(tensors: Tensors, change: Callable[[Data], None] = lambda head: None) -> bytes:
    """A safetensors file, whatever it says."""
    head: Data = {}
    at = 0
    for name, (dtype, shape, data) in tensors.items():
        head[name] = {"dtype": dtype, "shape": shape, "data_offsets": [at, at + len(data)]}
        at += len(data)
    change(head)
    return _framed(json_text(head).encode(), b"".join(data for _, _, data in tensors.values()))


def _framed(head: bytes, body: bytes, size: int | None = None) -> bytes:
    return (len(head) if size is None else size).to_bytes(8, "little") + head + body


def _cast(tensors: Tensors, rng: Rng) -> Changed:
    """Another type, with right shapes and enough bytes, for one tensor or for all."""
    dtype = pick(rng, sorted(WIDTHS))
    chosen = set(tensors) if integer(rng, 2) else {pick(rng, sorted(tensors))}
    value = pick(rng, (b"\0", b"\1", b"\x3f", bytes(rng.bytes(1))))
    out = {
        name: (dtype, shape, value * (int(np.prod(shape)) * WIDTHS[dtype])) if name in chosen else (kind, shape, data)
        for name, (kind, shape, data) in tensors.items()
    }
    return out, f"{len(chosen)} of type {dtype!r}"


def _as_doubles(tensors: Tensors, rng: Rng) -> Changed:
    value = pick(rng, (1e300, -1e39, 0.01))
    return {name: ("F64", shape, np.full(shape, value).tobytes()) for name, (_, shape, _) in tensors.items()}, "doubles"


def _filled(tensors: Tensors, rng: Rng) -> Changed:
    value = pick(rng, (3e38, -3e38, 1e30, np.nan, np.inf, -np.inf, 1e-45, 0.0))
    chosen = set(tensors) if integer(rng, 2) else {pick(rng, sorted(tensors))}
    out = {
        name: (kind, shape, np.full(shape, value, "<f4").tobytes() if name in chosen else data)
        for name, (kind, shape, data) in tensors.items()
    }
    return out, f"{len(chosen)} filled with {value}"


def _reshaped(tensors: Tensors, rng: Rng) -> Changed:
    name = pick(rng, sorted(tensors))
    kind, shape, data = tensors[name]
    near = (shape[::-1], [*shape, 1], [1, *shape], [int(np.prod(shape))])
    odd = pick(rng, (*near, [], [0], [-1], [2**63], "x", None, [0.5]))
    return {**tensors, name: (kind, odd, data)}, f"{name} is {odd}"


def _renamed(tensors: Tensors, rng: Rng) -> Changed:
    name = pick(rng, sorted(tensors))
    out = dict(tensors)
    match integer(rng, 4):
        case 0:
            del out[name]
        case 1:
            out[pick(rng, ("x", "", "\0", "a" * 5000, "__metadata__"))] = out.pop(name)
        case 2:
            out[pick(rng, ("more", "_points", "encoder._planes"))] = out[name]
        case _:
            other = pick(rng, sorted(tensors))
            out[name], out[other] = out[other], out[name]
    return out, f"{name} elsewhere"


CHANGES: tuple[Change, ...] = (_cast, _cast, _as_doubles, _filled, _filled, _reshaped, _renamed)


def bad_header(tensors: Tensors, rng: Rng) -> tuple[bytes, str]:
    """A file whose header is wrong, and whose tensors are not."""
    name, what = pick(rng, sorted(tensors)), integer(rng, 9)
    sound = packed(tensors)
    size = int.from_bytes(sound[:8], "little")
    head, body = sound[8 : 8 + size], sound[8 + size :]
    told = f"header {what}"
    match what:
        case 0:
            return _framed(head, body, pick(rng, (0, 1, size - 1, size + 1, 2**31, 2**63, 2**64 - 1))), told
        case 1:
            return _framed(head + b" " * pick(rng, (7, 1 << 10, 1 << 21)), body), told
        case 2:
            return _framed(head[:-1] + b', "' + name.encode() + b'": ' + json.dumps([1]).encode() + b"}", body), told
        case 3:
            first, later = head.split(b"}", 1)
            return _framed(first + b"}, " + first[1:] + b"}" + later, body), told
        case 4:
            other = pick(rng, (b"", b"{}", b"[]", b"[" * 5000, b'{"a":' * 5000, b"null", b"\xff\xfe"))
            return _framed(other, body), told
        case 5:
            offsets = pick(rng, ([0, 0], [0, 2**63], [-4, 0], [8, 4], [0], None, "x", [0.5, 1.5], [0, 10**30]))
            return packed(tensors, lambda h: h[name].update(data_offsets=offsets)), f"{told}: {offsets}"
        case 6:
            note = pick(rng, ({}, {"a": "b"}, {"a": 1}, [], "x", {"a": {"b": "c"}}))
            return packed(tensors, lambda h: h.update(__metadata__=note)), f"{told}: {note}"
        case 7:
            number = integer(rng, len(NASTY))
            key = pick(rng, ("dtype", "shape", "data_offsets", "more"))
            return packed(tensors, lambda h: h[name].update({key: NASTY[number]})), f"{told}: {key} = nasty {number}"
        case _:
            return sound[: integer(rng, len(sound))], f"{told}: cut"


# --- cases ---


def cases(count: int, seed: int, work: Path) -> Iterator[Case]:
    """So many hostile policies, one after the other, each in the same folder."""
    sounds = [sound_policy(work, network) for network in SOUND_NETWORKS]
    for number, rng in draws(count, seed):
        sound = sounds[number % len(sounds)]
        tensors = unpacked(sound.weights)
        about, weights, told, lay = json_text(sound.about).encode(), sound.weights, "sound", None
        how = integer(rng, 20)
        if how < 5:
            changed, told = _other_description(sound.about, rng)
            about = json_text(changed).encode()
        elif how < 8:
            about, told = spoiled(about, rng)
        elif how < 12:
            changed_tensors, told = pick(rng, CHANGES)(tensors, rng)
            weights = packed(changed_tensors)
        elif how < 15:
            weights, told = bad_header(tensors, rng)
        elif how < 18:
            weights, told = spoiled(weights, rng)
        elif how < 19:
            told = f"{pick(rng, (POLICY_JSON, WEIGHTS))}: {pick(rng, sorted(PLACES))}"
            lay = told
        if how >= 8 and integer(rng, 10):  # else the digest tells
            about = json_text({**sound.about, "weights_sha256": hashlib.sha256(weights).hexdigest()}).encode()
        area = "policy.json" if how < 8 else "weights"
        feed = functools.partial(_feed, sound, work / "p", {POLICY_JSON: about, WEIGHTS: weights}, lay)
        yield Case(area=area, name=f"{number}: {told}", feed=feed)


def _other_description(about: Data, rng: Rng) -> tuple[Data, str]:
    if integer(rng, 3):
        return twisted(about, rng)
    net, size = dict(about["net"]), pick(rng, SIZES)
    what = pick(rng, ("hidden", "image_hw_px", "vector_size", "window", "network"))
    if what == "hidden":
        return {**about, "net": {**net, "hidden": size}}, f"hidden {size}"
    if what == "network":
        name = pick(rng, ("patch", "fig6", "conv3d", "convlstm", "os:system", "nowhere", "patch "))
        return {**about, "net": {**net, "network": name}, "window": pick(rng, (1, 4, 16))}, name
    value = [size, pick(rng, (24, 2048))] if what == "image_hw_px" else size
    return {**about, what: value}, f"{what} {value}"


def _feed(sound: Sound, folder: Path, files: dict[str, bytes], lay: str | None) -> bool:
    folder.mkdir()
    try:
        for name, data in files.items():
            (folder / name).write_bytes(data)
        if lay is not None:
            name, _, place = lay.partition(": ")
            cleared(folder / name)
            PLACES[place](folder / name)
        return _usable(sound, folder)
    finally:
        for name in files:
            with suppress(FileNotFoundError):
                cleared(folder / name)
        folder.rmdir()


def _usable(sound: Sound, folder: Path) -> bool:
    """Whether what was loaded is what the file holds, and acts."""
    policy = load_policy(folder)
    state = policy.net.state_dict()
    told = unpacked((folder / WEIGHTS).read_bytes())
    same = set(state) == set(told) and all(
        kind == "F32"
        and str(state[name].dtype) == "torch.float32"
        and list(state[name].shape) == shape
        and np.array_equal(state[name].numpy().ravel(), np.frombuffer(data, "<f4"))
        and bool(np.isfinite(state[name].numpy()).all())
        for name, (kind, shape, data) in told.items()
    )
    if policy.file.image_hw_px != (24, 32) or policy.file.vector_size != sound.about["vector_size"]:
        return same  # of another shape than what there is to be seen
    if policy.file.window != 1:
        return same
    return same and 0 <= policy.act(sound.observation) < 81
