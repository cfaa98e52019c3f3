"""On what a network is learned, and how PyTorch works meanwhile."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from wcsim.config import LearnConfig
from wcsim.errors import ConfigError


def validate_device_name(name: str) -> str:
    """The device's name.

    Raises ConfigError for one that PyTorch does not know or this machine does not have.
    """
    try:
        torch.zeros(1, device=name).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).splitlines()[0][:120]
        raise ConfigError(
            f"learn.device={name!r} cannot be used here ({reason}); expected cpu, or cuda with a "
            "card"
        ) from None
    return name


@contextmanager
def temporary_torch_settings(learn: LearnConfig) -> Iterator[None]:
    """Threads and determinism while a network learns, and what was set before after it."""
    threads, mode = torch.get_num_threads(), torch.get_deterministic_debug_mode()
    torch.set_num_threads(learn.threads)
    # As `torch.use_deterministic_algorithms`, which loads PyTorch's compiler besides: 1.5 s.
    torch.set_deterministic_debug_mode("error" if learn.device == "cpu" else "warn")
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        torch.set_deterministic_debug_mode(mode)
