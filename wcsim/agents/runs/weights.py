"""Policy folders with their weights: written, and read from any source, checked before loading."""

import contextlib
import hashlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors.torch import load, save
from torch import Tensor

from wcsim.agents.runs.policy_file import POLICY_JSON, WEIGHTS
from wcsim.core import files, reading
from wcsim.core.reading import escape, read_bytes, read_file_size
from wcsim.core.sources import read_package_version
from wcsim.errors import PolicyError

_MAX_HEADER_BYTES = 1 << 20
Tensors = Mapping[str, Tensor]
Net = TypeVar("Net", bound=torch.nn.Module)


def write_policy_folder(folder: Path, net: torch.nn.Module, facts: Mapping[str, Any]) -> Path:
    """Write a policy folder in one step, replacing an older one; returns it.

    Args:
        folder: The policy folder.
        net: The policy's network.
        facts: The keys of `policy.json` but for versions and the hash of the weights.

    Raises:
        DiskFullError: There is no room.
    """
    with files.write_folder_atomically(folder) as target:
        tensors = {
            key: value.detach().cpu().contiguous() for key, value in net.state_dict().items()
        }
        (target / WEIGHTS).write_bytes(save(tensors))
        versions = {name: read_package_version(name) for name in ("torch", "stable-baselines3")}
        digest = files.sha256_from_file(target / WEIGHTS)
        files.write_json(
            target / POLICY_JSON,
            {"schema_version": 1, **facts, "weights_sha256": digest, "versions": versions},
        )
    return folder


def load_network(folder: Path, sha256: str, make: Callable[[], Net], *, own: bool = False) -> Net:
    """The network of a policy folder, with its weights.

    Args:
        folder: The policy folder.
        sha256: The hash of the weights in policy.json.
        make: Makes the network that policy.json describes.
        own: Whether the network is one of wcsim's: its size is known before it gets memory.

    Raises:
        PolicyError: The weights do not fit, or the bytes are no safetensors file.
    """
    path = folder / WEIGHTS
    with torch.device("meta") if own else contextlib.nullcontext():
        net = make()
    data = _read_weights(path, sha256, net.state_dict().values())
    net = make() if own else net
    try:
        tensors = load(data)
    except Exception as error:  # of safetensors or PyTorch, by what is wrong with the bytes
        raise PolicyError(f"{escape(path)} is not a safetensors file: {escape(error)}") from None
    net.load_state_dict(validate_tensors(escape(path), tensors, net.state_dict()))
    return net


def _read_weights(path: Path, sha256: str, tensors: Iterable[Tensor]) -> bytes:
    """The bytes of a weights file of the size of these tensors.

    Raises:
        PolicyError: The file cannot be read, or has another size or digest.
    """
    size = read_file_size(path, reading.WEIGHTS)
    least = sum(tensor.numel() * tensor.element_size() for tensor in tensors)
    if not least <= size <= least + _MAX_HEADER_BYTES:
        raise PolicyError(
            f"{escape(path)} has {size} bytes, and the network that policy.json describes has "
            f"weights of {least}; copy the whole policy folder again"
        )
    data = read_bytes(path, reading.WEIGHTS)
    found = hashlib.sha256(data).hexdigest()
    if found != sha256:
        raise PolicyError(
            f"{escape(path)} has SHA-256 {found[:12]}..., policy.json says {sha256[:12]}...: "
            "the file was damaged or replaced; copy the whole policy folder again"
        )
    return data


def validate_tensors(
    where: str,
    tensors: Tensors,
    expected: Tensors,
    of: str = "the network that policy.json describes",
) -> Tensors:
    """The tensors, if they are finite and have the names, types and shapes of `expected`.

    Raises:
        PolicyError: They do not.
    """
    found = {name: _facts(tensor) for name, tensor in tensors.items()}
    facts = {name: _facts(tensor) for name, tensor in expected.items()}
    odd = sorted(name for name in facts.keys() | found.keys() if facts.get(name) != found.get(name))
    if odd:
        first = odd[0]
        raise PolicyError(
            f"{where} does not fit {of}: {escape(first, 80)} is "
            f"{found.get(first, 'missing')}, expected {facts.get(first, 'nothing')} "
            f"({len(odd)} tensors differ); use the weights it was trained with"
        )
    if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values()):
        raise PolicyError(f"{where} holds numbers that are not finite; train this policy again")
    return tensors


def hash_network_weights(net: torch.nn.Module) -> str:
    """SHA-256 over the weights of a network."""
    text = hashlib.sha256()
    for name, value in sorted(net.state_dict().items()):
        text.update(name.encode() + value.detach().cpu().contiguous().numpy().tobytes())
    return text.hexdigest()


def _facts(tensor: Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"
