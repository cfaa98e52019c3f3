"""Supervised learning of dangers.

The loss is binary cross-entropy over all joystick positions with a label.
"""

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

_MAX_NORM = 5.0  # of a gradient, which is clipped to it
_WARM_UP = 0.05  # share of all updates in which the learning rate rises
_LEAST_RATE = 0.04  # share of the learning rate at the first update
_SMOOTHING = 0.98  # weight of the earlier updates in the smoothed loss
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # of AdamW, for each parameter


class DangerLearner:
    """A network and its optimiser; the learning rate has one cycle over all rounds.

    Args:
        config: Of the run.
        seed: Of the run.
        total: Updates of the whole run, over which the learning rate rises and falls.

    Raises:
        ConfigError: `learn.device` cannot be used here.
    """

    def __init__(self, config: RunConfig, seed: int, total: int) -> None:
        danger = config.danger
        # Seeded here: the first weights must not depend on earlier draws of the run.
        torch.manual_seed(seeding.derive_seed(seed, "agent", "danger"))
        self._device = validate_device_name(config.learn.device)
        self.net = channels_last(DangerNet(spec_of(config))).to(self._device)
        self._optimizer = torch.optim.AdamW(
            self.net.parameters(), lr=danger.learning_rate, weight_decay=danger.weight_decay
        )
        self._total, self._rate = max(total, 1), danger.learning_rate
        self.updates, self.loss = 0, float("nan")

    def learn(
        self,
        data: Dataset,
        updates: int,
        on_update: Callable[[int], object] = lambda done: None,
    ) -> float:
        """Do so many updates; the smoothed loss.

        Args:
            data: Its batches are learned from.
            updates: How many.
            on_update: Gets the number of finished updates after each.

        Raises:
            PolicyError: A loss or gradient is not finite, or no step of the data has a label.
        """
        self.net.train()
        for done in range(1, updates + 1):
            # 1. The loss of a batch, at the learning rate of this update.
            for group in self._optimizer.param_groups:
                group["lr"] = self._rate * _rate_share(self.updates / self._total)
            batch = data.draw()
            inputs = (part.to(self._device) for part in batch.inputs)
            unsafe = batch.unsafe.to(self._device)
            known = unsafe < UNKNOWN
            loss = functional.binary_cross_entropy_with_logits(
                self.net(*inputs)[known], unsafe[known]
            )
            now = float(loss.detach())

            # 2. The gradient. An infinite one cannot be clipped, and would destroy the weights.
            self._optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            norm = float(nn.utils.clip_grad_norm_(self.net.parameters(), _MAX_NORM))
            if not (np.isfinite(now) and np.isfinite(norm)):
                raise PolicyError(
                    f"the loss was {now} and the norm of its gradient {norm} after "
                    f"{self.updates} updates; expected finite numbers: start a new run with a "
                    "smaller danger.learning_rate"
                )

            # 3. The update.
            self._optimizer.step()
            self.updates += 1
            first = np.isnan(self.loss)
            self.loss = now if first else _SMOOTHING * self.loss + (1.0 - _SMOOTHING) * now
            on_update(done)
        self.net.train(False)
        return self.loss

    def arrays(self) -> dict[str, Arrays]:
        """`weights` and `moments`: those of the network and of the optimiser, by name."""
        names: dict[object, str] = {
            parameter: name for name, parameter in self.net.named_parameters()
        }
        weights = {
            name: value.detach().cpu().numpy() for name, value in self.net.state_dict().items()
        }
        moments = {
            f"{names[parameter]}.{key}": value.detach().cpu().numpy()
            for parameter, state in self._optimizer.state.items()
            for key, value in state.items()
        }
        return {"weights": weights, "moments": moments}

    def restore(self, arrays: dict[str, Arrays], updates: int, loss: float) -> None:
        """Continue after so many updates.

        Args:
            arrays: As `arrays` returned them then.
            updates: How many there were.
            loss: The smoothed loss then.

        Raises:
            PolicyError, KeyError: The arrays are of another network, or not finite.
        """
        # 1. The weights.
        weights, moments = (
            {name: torch.from_numpy(value) for name, value in arrays[part].items()}
            for part in ("weights", "moments")
        )
        self.net.load_state_dict(validate_tensors("the weights", weights, self.net.state_dict()))

        # 2. The moments. A parameter that never had a gradient has none.
        parameters = dict(self.net.named_parameters())
        names = sorted({name.rpartition(".")[0] for name in moments})
        expected = {
            f"{name}.{key}": torch.zeros(() if key == "step" else parameters[name].shape)
            for name in names
            for key in _MOMENTS
        }
        valid = validate_tensors("the moments", moments, expected)
        # Those of updates since then must not remain.
        self._optimizer.state.clear()
        for name in names:
            # AdamW keeps its count of steps on the CPU.
            self._optimizer.state[parameters[name]] = {
                key: valid[f"{name}.{key}"].clone().to("cpu" if key == "step" else self._device)
                for key in _MOMENTS
            }
        self.updates, self.loss = updates, loss


def _rate_share(done: float) -> float:
    """The share of the learning rate when the share `done` of all updates is done.

    It rises to 1 in a line, and falls to 0 along a cosine.

    >>> [round(_rate_share(done), 3) for done in (0.0, 0.05, 0.525, 1.0)]
    [0.04, 1.0, 0.5, 0.0]
    """
    done = min(done, 1.0)
    if done < _WARM_UP:
        return _LEAST_RATE + (1.0 - _LEAST_RATE) * done / _WARM_UP
    return 0.5 * (1.0 + math.cos(math.pi * (done - _WARM_UP) / (1.0 - _WARM_UP)))
