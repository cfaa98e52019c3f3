"""Networks by name.

A network is an `nn.Module` class that is built with `(image_shape, vector_size)` and maps an image
batch and a vector batch to features. What goes in:

- `image`: (B, C, H, W) float32 in 0..1; one plane per group of pixel classes, then the log-depth
  (0 near, 1 far); built with `image_shape` (C, H, W);
- `vector`: (B, 7) float32 in -1..1; IMU (ax, ay, az, roll, pitch) and joystick (x right, y
  forward), then `[sensors]`.

What comes out: (B, F) float32 for any F, which is found by a first call. The head that turns
features into values of actions gets the vector once more beside the features, so that a network may
ignore it; Stable-Baselines3's own algorithms give their heads the features alone. An example is
`examples/own_network.py`.

A class with `windowed = True` gets the images of the last T ticks (`env.window`), the newest last:
it is built with `image_shape` (T, C, H, W) and called with (B, T, C, H, W). Its `window` is the T
that `wcsim train` takes when the user sets none; it must work with any T, 1 included. Nothing is
remembered from one call to the next.

A windowed class that can also carry a state from tick to tick has `state_size` after it is built
(numbers of its state) and `unroll(image, vector, state)` with the same weights. It maps image
(B, T, C, H, W) and vector (B, T, V) of T ticks in a row, and the state (B, state_size) before them
(zeros where an episode begins), to features (B, T, F) and the state after them.
`learn.memory=groups` uses it, with one image in an observation.
"""

from collections.abc import Callable
from typing import Any

from torch import nn

from wcsim.agents.networks.convolutional import Conv3dNet, ConvLstmNet, Figure6Net, PatchNet
from wcsim.agents.networks.names import unknown_network_error
from wcsim.core.plugins import import_class
from wcsim.errors import PolicyError

NetworkClass = Callable[[Any, int], nn.Module]  # (image_shape, vector_size)

NETWORKS: dict[str, NetworkClass] = {
    "patch": PatchNet,
    "fig6": Figure6Net,
    "convlstm": ConvLstmNet,
    "conv3d": Conv3dNet,
}


def register(name: str, network: NetworkClass) -> None:
    """Register a network under a name. Raises PolicyError if it is taken or contains a colon."""
    if ":" in name or NETWORKS.get(name, network) is not network:
        raise PolicyError(
            f"network name {name!r} is taken or contains a colon; expected a new plain name"
        )
    NETWORKS[name] = network


def find_network(name: str) -> NetworkClass:
    """The network of that name, or the class of `module:Class`.

    A module is found in the current folder or on the Python path. Raises PolicyError when there is
    none; importing `module` runs its code.
    """
    if name in NETWORKS:
        return NETWORKS[name]
    if ":" not in name:
        raise unknown_network_error(name, tuple(NETWORKS))
    found = import_class(name, "network")
    if not issubclass(found, nn.Module):
        raise PolicyError(
            f"network {name!r} is not a torch.nn.Module; expected a subclass (see examples/)"
        )
    return found


def is_windowed_network(name: str) -> bool:
    """Whether a network reads a window of images. Raises PolicyError when there is none."""
    return bool(getattr(find_network(name), "windowed", False))


def is_recurrent_network(name: str) -> bool:
    """Whether a network can carry a state between ticks. Raises PolicyError when there is none."""
    return is_windowed_network(name) and callable(getattr(find_network(name), "unroll", None))


def preferred_window_size(name: str) -> int:
    """How many images a window should hold for a network. Raises PolicyError when there is none."""
    return int(getattr(find_network(name), "window", 1)) if is_windowed_network(name) else 1


def build_network(name: str, image_shape: tuple[int, ...], vector_size: int) -> nn.Module:
    """A network for these inputs. Raises PolicyError when its class cannot be built with them."""
    network = find_network(name)
    try:
        return network(image_shape, vector_size)
    except (TypeError, ValueError, RuntimeError) as error:
        raise PolicyError(
            f"network {name!r} could not be built with image_shape={image_shape}, "
            f"vector_size={vector_size}: {error}"
        ) from error
