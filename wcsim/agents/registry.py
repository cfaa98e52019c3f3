"""Networks by name.

A network is an `nn.Module` class that is built with `(image_shape, vector_size)` and maps an image batch and a vector
batch to features. What goes in:

- `image`: (B, C, H, W) float32 in 0..1; one plane per group of pixel classes, then the log-depth (0 near, 1 far);
- `vector`: (B, 7) float32 in -1..1; IMU (ax, ay, az, roll, pitch) and the user's joystick (x right, y forward).

What comes out: (B, F) float32 for any F, which is found by a first call. The head that turns features into values of
actions gets the vector once more beside the features, so that a network may ignore it. An example is
`examples/own_network.py`.
"""

from __future__ import annotations

from collections.abc import Callable

from torch import nn

from wcsim.agents.nets.impala import ImpalaNet
from wcsim.agents.nets.strided import PatchNet, SmallNet
from wcsim.errors import PolicyError
from wcsim.plugins import find_class

NetworkClass = Callable[[tuple[int, int, int], int], nn.Module]

NETWORKS: dict[str, NetworkClass] = {"small": SmallNet, "patch": PatchNet, "impala": ImpalaNet}


def register(name: str, network: NetworkClass) -> None:
    """Make a network known under a name. Raises PolicyError when the name is taken by another one or holds a colon."""
    if ":" in name or NETWORKS.get(name, network) is not network:
        raise PolicyError(f"network name {name!r} is taken or holds a colon; expected a new plain name")
    NETWORKS[name] = network


def is_registered(name: str) -> bool:
    """Whether a name stands for a network of wcsim itself or one given to `register`."""
    return name in NETWORKS


def find_network(name: str) -> NetworkClass:
    """The network of that name, or the class of `module:Class` from the current folder or the Python path.

    Raises PolicyError when there is none; importing `module` runs its code.
    """
    if name in NETWORKS:
        return NETWORKS[name]
    if ":" not in name:
        raise PolicyError(f"unknown network {name!r}; expected one of {', '.join(sorted(NETWORKS))}, or module:Class")
    found = find_class(name, "network")
    if not issubclass(found, nn.Module):
        raise PolicyError(f"network {name!r} is no torch.nn.Module; expected a class that is one (see examples/)")
    return found


def build(name: str, image_shape: tuple[int, int, int], vector_size: int) -> nn.Module:
    """A network of that name for these inputs. Raises PolicyError when its class cannot be built with them."""
    network = find_network(name)
    try:
        return network(image_shape, vector_size)
    except (TypeError, ValueError, RuntimeError) as error:
        raise PolicyError(
            f"network {name!r} could not be built with image_shape={image_shape}, vector_size={vector_size}: {error}"
        ) from error
