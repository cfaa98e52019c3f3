"""On what a network is learned: refused where it cannot be, before anything is driven."""

import pytest

from wcsim.agents.networks.device import validate_device_name
from wcsim.errors import ConfigError


def test_a_device_without_numbers_is_named():
    assert validate_device_name("cpu") == "cpu"
    for name in ("meta", "abacus"):
        with pytest.raises(ConfigError, match=rf"learn\.device='{name}' cannot be used here"):
            validate_device_name(name)
