"""From an observation to features: class ids become planes, which a registered network reads."""

from collections.abc import Mapping
from typing import Final, Literal

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from wcsim.agents.networks import registry
from wcsim.agents.policy_api import (
    CLASS_KEY,
    COLOURS_KEY,
    DEPTH_KEY,
    IMU_KEY,
    JOYSTICK_KEY,
    RGB_KEY,
)
from wcsim.config.env import Form
from wcsim.errors import PolicyError
from wcsim.types import ClassId as C

Tensors = Mapping[str, Tensor]
Space = spaces.Space[object]
Classes = Literal["cityscapes", "wcsim"]

# Cityscapes has more labelIds than wcsim draws (guard rail 14, bridge 15, tunnel 16, caravan 29,
# trailer 30, ...): a network trained here must meet a real segmentation. An id in no group (void,
# out of roi) leaves all planes at zero.
GROUPS: Final[tuple[tuple[int, ...], ...]] = (
    (C.SIDEWALK, C.KERB, C.LOWERED_KERB),
    (C.ROAD, C.PARKING, C.RAIL_TRACK, C.CROSSWALK),
    (C.GROUND, C.TERRAIN),
    (C.BUILDING, C.WALL, C.FENCE, 14, 15, 16),
    (C.STATIC, C.DYNAMIC, C.POLE, 18, C.TRAFFIC_LIGHT, C.TRAFFIC_SIGN),
    (C.VEGETATION,),
    (C.SKY,),
    (C.PERSON,),
    (C.RIDER, C.MOTORCYCLE, C.BICYCLE),
    (C.CAR, C.TRUCK, C.BUS, 29, 30, C.TRAIN),
)
# Beside the others when classes="wcsim".
WCSIM_GROUPS: Final[tuple[tuple[int, ...], ...]] = ((C.KERB,), (C.LOWERED_KERB, C.CROSSWALK))
_CLASS_KEYS: Final = {CLASS_KEY, COLOURS_KEY}  # one of which every observation has


class ObservationEncoder(BaseFeaturesExtractor):
    """A features extractor of Stable-Baselines3 for wcsim's observations.

    It also serves SB3's own algorithms: `MultiInputPolicy` with
    `policy_kwargs={"features_extractor_class": ObservationEncoder, "normalize_images": False}`.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        network: str = "patch",
        classes: Classes = "cityscapes",
        stateful: bool = False,
    ) -> None:
        if stateful:
            _require_stateful(observation_space, network)
        pictures = [
            key
            for key, box in _require_own(observation_space).spaces.items()
            if len(box.shape or ()) > 1 and key not in {*_CLASS_KEYS, DEPTH_KEY, RGB_KEY}
        ]
        if pictures:
            raise PolicyError(
                f"network {network!r} sees one camera, the observation has {', '.join(pictures)}; "
                "expected one: set env.camera to its name"
            )
        height, width = image_size_from_space(observation_space)
        numbers = vector_size_from_space(observation_space)
        table = _group_table(classes)
        self.form = observation_form_from_space(observation_space)
        # Class planes and depth, with colours or without; or the four planes of Table 3.
        count = {"compact": len(table) + 1, "compact_rgb": len(table) + 4, "table3": 4}[self.form]
        # A windowed network is built with (T, C, H, W), any other with (C, H, W).
        shape: tuple[int, ...] = (count, height, width)
        frames, windowed = (
            window_size_from_space(observation_space),
            registry.is_windowed_network(network),
        )
        if windowed:
            shape = (frames, *shape)
        elif frames > 1:
            others = ", ".join(sorted(filter(registry.is_windowed_network, registry.NETWORKS)))
            raise PolicyError(
                f"network {network!r} reads one image, the observation holds {frames}; expected "
                f"one: set env.window=1, or choose a windowed network ({others})"
            )
        body = registry.build_network(network, shape, numbers)
        super().__init__(
            observation_space, features_dim=_features_dim(network, body, shape, numbers)
        )
        self.body = body
        self.vector_keys = vector_keys_from_space(observation_space)
        self.windowed = windowed
        self.state_size = int(body.state_size) if stateful else 0  # type: ignore[arg-type]
        # (256, G + 1): the last plane is for depth.
        planes = torch.cat([table, torch.zeros(1, 256, dtype=torch.bool)]).t()
        self.register_buffer("_planes", planes.to(torch.float32).contiguous(), persistent=False)

    def forward(self, observations: Tensors) -> Tensor:
        """Features (B, F) of a batch of observations."""
        return torch.as_tensor(self.body(self.image(observations), self.vector(observations)))

    def unroll(self, observations: Tensors, state: Tensor) -> tuple[Tensor, Tensor]:
        """Features (B, T, F) of T observations in a row, and the state (B, state_size) after them.

        Observations are (B, T, ...) each.
        """
        count = state.shape[0], observations[DEPTH_KEY].shape[1]
        flat = {key: value.flatten(0, 1) for key, value in observations.items()}
        image = torch.unflatten(self.image(flat)[:, -1], 0, count)
        vector = torch.unflatten(self.vector(flat), 0, count)
        features, after = self.body.unroll(image, vector, state)  # type: ignore[operator]
        return torch.as_tensor(features), torch.as_tensor(after)

    def image(self, observations: Tensors) -> Tensor:
        """Planes (B, C, H, W) in 0..1; (B, T, C, H, W) for a network that is windowed.

        Class planes and log-depth, then colours where the observation has them; or the four planes
        of Table 3. Channels last in memory train twice as fast.
        """
        if self.form == "table3":
            seen = torch.cat([observations[COLOURS_KEY], observations[DEPTH_KEY]], dim=-3)
            return seen[:, None] if self.windowed and seen.ndim == 4 else seen
        ids = observations[CLASS_KEY].to(torch.int32)
        depth = observations[DEPTH_KEY] / 255.0
        table = torch.as_tensor(self._planes)
        # ONNX Runtime writes one plane of many slowly, half of a decision's time.
        if torch.onnx.is_in_onnx_export():
            groups = nn.functional.embedding(ids, table[:, :-1].contiguous())
            planes = torch.cat([groups.permute(0, 1, 4, 2, 3), depth[:, :, None]], dim=2)
        else:
            planes = nn.functional.embedding(ids, table)  # (B, T, H, W, G + 1)
            planes[..., -1] = depth
            # Not movedim: with -1 it cannot be exported.
            planes = planes.permute(0, 1, 4, 2, 3)
        if self.form == "compact_rgb":
            colours = torch.unflatten(observations[RGB_KEY], 1, (-1, 3)) / 255.0
            planes = torch.cat([planes, colours], dim=2)
        return planes if self.windowed else planes[:, 0]

    def vector(self, observations: Tensors) -> Tensor:
        """What `vector_keys_from_space` names side by side, (B, vector_size) float32."""
        return torch.cat([observations[key] for key in self.vector_keys], dim=1).to(torch.float32)


def vector_keys_from_space(space: Space) -> tuple[str, ...]:
    """What a network's vector is made of, in its order.

    IMU, joystick, then every further row of numbers by name.
    """
    boxes = {
        key: box for key, box in _require_own(space).spaces.items() if isinstance(box, spaces.Box)
    }
    rows = {key for key, box in boxes.items() if box.dtype == np.float32 and len(box.shape) == 1}
    return (IMU_KEY, JOYSTICK_KEY, *sorted(rows - {IMU_KEY, JOYSTICK_KEY}))


def vector_size_from_space(space: Space, keys: tuple[str, ...] = ()) -> int:
    """How many numbers the vector has, or those parts of it that `keys` names.

    In the paper 7, for IMU and joystick.
    """
    return sum(
        int(np.prod(_box(_require_own(space), key).shape))
        for key in keys or vector_keys_from_space(space)
    )


def image_size_from_space(space: Space) -> tuple[int, int]:
    """(H, W) of the observation's images. Raises PolicyError when the space is none of wcsim's."""
    space = _require_own(space)
    dtype = np.float32 if observation_form_from_space(space) == "table3" else np.uint8
    for key in (COLOURS_KEY if COLOURS_KEY in space.spaces else CLASS_KEY, DEPTH_KEY):
        box = _box(space, key)
        most = 4 if dtype == np.float32 else 3
        if box.dtype != dtype or not 3 <= len(box.shape) <= most or box.shape[0] < 1:
            raise PolicyError(
                f"observation {key!r} is {box.dtype} {box.shape}; expected {np.dtype(dtype)} "
                "(planes, H, W): see env.observation"
            )
    height, width = _box(space, DEPTH_KEY).shape[-2:]
    return height, width


def window_size_from_space(space: Space) -> int:
    """How many images the observation holds (`env.window`)."""
    return int(_box(_require_own(space), DEPTH_KEY).shape[0])


def observation_form_from_space(space: Space) -> Form:
    """Which form of `env.observation` a space is of. Raises PolicyError when it is of none."""
    keys = _require_own(space).spaces
    if CLASS_KEY not in keys:
        return "table3"
    return "compact_rgb" if RGB_KEY in keys else "compact"


def _require_own(space: Space) -> spaces.Dict:
    """The space, when it is one of wcsim's. Raises PolicyError."""
    if isinstance(space, spaces.Dict):
        keys = set(space.spaces)
        if keys >= {DEPTH_KEY, IMU_KEY, JOYSTICK_KEY} and keys & _CLASS_KEYS:
            return space
    raise PolicyError(
        f"observation space is {space}; expected a Dict with seg, depth, imu and joystick"
    )


def _box(space: spaces.Dict, key: str) -> spaces.Box:
    box = space.spaces[key]
    if not isinstance(box, spaces.Box):
        raise PolicyError(f"observation {key!r} is {box}; expected a Box")
    return box


def _group_table(classes: Classes) -> Tensor:
    """One row per group: (G, 256) bool, true where a class id belongs to the group."""
    groups = GROUPS + (WCSIM_GROUPS if classes == "wcsim" else ())
    table = torch.zeros(len(groups), 256, dtype=torch.bool)
    for row, ids in enumerate(groups):
        table[row, list(ids)] = True
    return table


def _require_stateful(space: Space, network: str) -> None:
    """Raise PolicyError for a network, or observations, with which no state can be carried."""
    if not registry.is_recurrent_network(network):
        raise PolicyError(
            f"network {network!r} carries no state; expected one with `unroll` (see "
            "networks.registry)"
        )
    if window_size_from_space(space) != 1:
        raise PolicyError(
            f"network {network!r} carries its state from tick to tick and sees "
            f"{window_size_from_space(space)} images at a time; expected one: set env.window=1"
        )


def _features_dim(name: str, body: nn.Module, shape: tuple[int, ...], vector_size: int) -> int:
    """Number of features, from a call with zeros, which also finds a network that is not usable."""
    try:
        with torch.no_grad():
            out = body(torch.zeros(2, *shape), torch.zeros(2, vector_size))
    except (TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise PolicyError(
            f"network {name!r} failed on image (2, {', '.join(map(str, shape))}): {error}"
        ) from error
    if not isinstance(out, Tensor) or out.ndim != 2 or len(out) != 2:
        returned = tuple(out.shape) if isinstance(out, Tensor) else type(out).__name__
        raise PolicyError(
            f"network {name!r} returned {returned} for a batch of 2; expected a tensor "
            "(2, features)"
        )
    # On the device meta, where policies are read, nothing has values.
    if not out.is_meta and not bool(torch.isfinite(out).all()):
        raise PolicyError(
            f"network {name!r} returned numbers that are not finite for an image and a vector of "
            "zeros, which do occur; expected finite ones: look for a division or a logarithm of 0 "
            "in it"
        )
    return int(out.shape[1])
