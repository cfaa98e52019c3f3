"""On what a network is learned: refused where it cannot be, before anything is driven."""

import pytest

from wcsim.agents.networks.device import checked_device
from wcsim.errors import ConfigError


def test_a_device_without_numbers_is_named():
    assert checked_device("cpu") == "cpu"
    for name in ("meta", "abacus"):
        with pytest.raises(ConfigError, match=rf"learn\.device='{name}' cannot be used here"):
            checked_device(name)
