"""On what a network is learned."""

from __future__ import annotations

import torch

from wcsim.errors import ConfigError


def checked_device(name: str) -> str:
    """The device's name. Raises ConfigError for one that PyTorch does not know or this machine does not have."""
    try:
        torch.zeros(1, device=name).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).splitlines()[0][:120]
        message = f"learn.device={name!r} cannot be used here ({reason}); expected cpu, or cuda with a card"
        raise ConfigError(message) from None
    return name
