"""Supervised learning of dangers: binary cross-entropy over all joystick positions of a step whose label is known."""

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from wcsim.agents.danger.dataset import UNKNOWN, Dataset
from wcsim.agents.danger.network import DangerNet, channels_last, spec_of
from wcsim.agents.networks.device import validate_device_name
from wcsim.agents.runs.checkpoint import Arrays
from wcsim.agents.runs.weights import validate_tensors
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.errors import PolicyError

_CLIP = 5.0
_WARM_UP = 0.05  # share of all updates in which the rate rises
_SMOOTH, _LEAST = 0.98, 0.04
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # of AdamW


class DangerLearner:
    """The network with its optimiser; the learning rate follows one cycle over all rounds.

    Args:
        config: Of the run.
        seed: Of the run.
        total: Updates of the whole run, over which the learning rate rises and falls.

    Raises:
        ConfigError: `learn.device` cannot be used here.
    """

    def __init__(self, config: RunConfig, seed: int, total: int) -> None:
        danger = config.danger
        # Here, and not once for a run: the first weights must not depend on what was drawn before.
        torch.manual_seed(seeding.derive_seed(seed, "agent", "danger"))
        self._device = validate_device_name(config.learn.device)
        self.net = channels_last(DangerNet(spec_of(config))).to(self._device)
        self._optimizer = torch.optim.AdamW(
            self.net.parameters(), lr=danger.learning_rate, weight_decay=danger.weight_decay
        )
        self._total, self._rate = max(total, 1), danger.learning_rate
        self.updates, self.loss = 0, float("nan")

    def learn(self, data: Dataset, updates: int, on_update: Callable[[int], object] = lambda done: None) -> float:
        """Do so many updates, and call `on_update` after each; the smoothed loss.

        Raises:
            PolicyError: A loss or gradient is not finite.
        """
        self.net.train()
        for done in range(1, updates + 1):
            for group in self._optimizer.param_groups:
                group["lr"] = self._rate * _rate_share(self.updates / self._total)
            batch = data.draw()
            seen, unsafe = (part.to(self._device) for part in batch.inputs), batch.unsafe.to(self._device)
            known = unsafe < UNKNOWN
            loss = functional.binary_cross_entropy_with_logits(self.net(*seen)[known], unsafe[known])
            now = float(loss.detach())
            self._optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            norm = float(nn.utils.clip_grad_norm_(self.net.parameters(), _CLIP))  # an infinite one cannot be clipped
            if not (np.isfinite(now) and np.isfinite(norm)):
                raise PolicyError(
                    f"the loss was {now} and the norm of its gradient {norm} after {self.updates} updates; expected "
                    "finite numbers: start a new run with a smaller danger.learning_rate"
                )
            # Only now, as a step with a gradient that is not finite would destroy the weights for good.
            self._optimizer.step()
            self.updates += 1
            self.loss = now if np.isnan(self.loss) else _SMOOTH * self.loss + (1.0 - _SMOOTH) * now
            on_update(done)
        self.net.train(False)
        return self.loss

    def arrays(self) -> dict[str, Arrays]:
        """The weights, and what the optimiser remembers of each, by name."""
        names: dict[object, str] = {parameter: name for name, parameter in self.net.named_parameters()}
        weights = {name: value.detach().cpu().numpy() for name, value in self.net.state_dict().items()}
        moments = {
            f"{names[parameter]}.{key}": value.detach().cpu().numpy()
            for parameter, held in self._optimizer.state.items()
            for key, value in held.items()
        }
        return {"weights": weights, "moments": moments}

    def restore(self, arrays: dict[str, Arrays], updates: int, loss: float) -> None:
        """Go on after so many updates with what `arrays` gave then.

        Raises:
            PolicyError, KeyError: It is of another network, or not finite.
        """
        weights, moments = (
            {name: torch.from_numpy(value) for name, value in arrays[part].items()} for part in ("weights", "moments")
        )
        self.net.load_state_dict(validate_tensors("the weights", weights, self.net.state_dict()))
        parameters = dict(self.net.named_parameters())
        names = sorted({name.rpartition(".")[0] for name in moments})
        # Of those that were moved: a parameter without a gradient has no moments yet.
        wanted = {
            f"{name}.{key}": torch.zeros(() if key == "step" else parameters[name].shape)
            for name in names
            for key in _MOMENTS
        }
        held = validate_tensors("the moments", moments, wanted)
        # Whatever the optimiser has gathered since would be mixed with what it had then.
        self._optimizer.state.clear()
        for name in names:
            # The count of steps stays on the CPU, where AdamW keeps it.
            self._optimizer.state[parameters[name]] = {
                key: held[f"{name}.{key}"].clone().to("cpu" if key == "step" else self._device) for key in _MOMENTS
            }
        self.updates, self.loss = updates, loss


def _rate_share(done: float) -> float:
    """Of the learning rate, when the share `done` of all updates is done: up to its whole, then down along a cosine.

    >>> [round(_rate_share(done), 3) for done in (0.0, 0.05, 0.525, 1.0)]
    [0.04, 1.0, 0.5, 0.0]
    """
    done = min(done, 1.0)
    if done < _WARM_UP:
        return _LEAST + (1.0 - _LEAST) * done / _WARM_UP
    return 0.5 * (1.0 + math.cos(math.pi * (done - _WARM_UP) / (1.0 - _WARM_UP)))
