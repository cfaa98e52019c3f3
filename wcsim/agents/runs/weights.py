"""Policy folders with their weights, written, and read from bytes that may come from others: checked, then loaded."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors.torch import load, save

from wcsim.agents.runs.policy_file import POLICY_JSON, WEIGHTS
from wcsim.core import files, reading
from wcsim.core.reading import escaped, read_bytes, regular_size
from wcsim.core.sources import version_of
from wcsim.errors import PolicyError

_MAX_HEADER_BYTES = 1 << 20
Tensors = Mapping[str, torch.Tensor]
Net = TypeVar("Net", bound=torch.nn.Module)


def write_policy(folder: Path, net: torch.nn.Module, said: Mapping[str, Any]) -> Path:
    """Write a policy folder in one step, replacing an older one; returns it.

    Args:
        folder: Of the policy.
        net: Its network.
        said: What `policy.json` says of it, but for its versions and the hash of its weights.

    Raises:
        DiskFullError: There is no room.
    """
    with files.whole_folder(folder) as target:
        tensors = {
            key: value.detach().cpu().contiguous() for key, value in net.state_dict().items()
        }
        (target / WEIGHTS).write_bytes(save(tensors))
        versions = {name: version_of(name) for name in ("torch", "stable-baselines3")}
        digest = files.sha256(target / WEIGHTS)
        files.write_json(
            target / POLICY_JSON,
            {"schema_version": 1, **said, "weights_sha256": digest, "versions": versions},
        )
    return folder


def load_network(folder: Path, sha256: str, make: Callable[[], Net], *, own: bool = False) -> Net:
    """The network of a policy folder, with its weights.

    Args:
        folder: Of the policy.
        sha256: What policy.json says of its weights.
        make: Makes the network that policy.json describes.
        own: Whether it is one of wcsim's: what it asks for is known before any memory is given to it.

    Raises:
        PolicyError: As `_read_weights` and `checked_tensors` do, or the bytes are none of a safetensors file.
    """
    path = folder / WEIGHTS
    with torch.device("meta") if own else contextlib.nullcontext():
        net = make()
    data = _read_weights(path, sha256, net.state_dict().values())
    net = make() if own else net
    try:
        tensors = load(data)
    except Exception as error:  # of safetensors or PyTorch, by what is wrong with the bytes
        raise PolicyError(f"{escaped(path)} is not a safetensors file: {escaped(error)}") from None
    net.load_state_dict(checked_tensors(escaped(path), tensors, net.state_dict()))
    return net


def _read_weights(path: Path, sha256: str, wanted: Iterable[torch.Tensor]) -> bytes:
    """The bytes of a weights file of the size of these tensors.

    Raises PolicyError: The file cannot be read, or has another size or digest.
    """
    size = regular_size(path, reading.WEIGHTS)
    least = sum(tensor.numel() * tensor.element_size() for tensor in wanted)
    if not least <= size <= least + _MAX_HEADER_BYTES:
        raise PolicyError(
            f"{escaped(path)} has {size} bytes, and the network that policy.json describes has "
            f"weights of {least}; "
            "copy the whole policy folder again"
        )
    data = read_bytes(path, reading.WEIGHTS)
    found = hashlib.sha256(data).hexdigest()
    if found != sha256:
        raise PolicyError(
            f"{escaped(path)} has SHA-256 {found[:12]}..., policy.json says {sha256[:12]}...: "
            "the file was damaged or replaced; copy the whole policy folder again"
        )
    return data


def checked_tensors(
    where: str,
    tensors: dict[str, torch.Tensor],
    wanted: Tensors,
    of: str = "the network that policy.json describes",
) -> dict[str, torch.Tensor]:
    """The same tensors. Raises PolicyError where they are not those of `wanted` in name, type and shape, or finite."""
    got, expected = (
        {name: _facts(tensor) for name, tensor in each.items()} for each in (tensors, wanted)
    )
    odd = sorted(
        name for name in expected.keys() | got.keys() if expected.get(name) != got.get(name)
    )
    if odd:
        first = odd[0]
        raise PolicyError(
            f"{where} does not fit {of}: {escaped(first, 80)} is "
            f"{got.get(first, 'missing')}, expected {expected.get(first, 'nothing')} "
            f"({len(odd)} tensors differ); use the weights it was trained with"
        )
    if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values()):
        raise PolicyError(f"{where} holds numbers that are not finite; train this policy again")
    return tensors


def digest_of(net: torch.nn.Module) -> str:
    """SHA-256 over the weights of a network."""
    text = hashlib.sha256()
    for name, value in sorted(net.state_dict().items()):
        text.update(name.encode() + value.detach().cpu().contiguous().numpy().tobytes())
    return text.hexdigest()


def _facts(tensor: torch.Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"
