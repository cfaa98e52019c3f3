"""The names of wcsim's own networks, without loading torch.

`agents/networks/registry.py` has the classes.
"""

import re
import sys
from typing import Final

from wcsim.core.plugins import import_class
from wcsim.core.reading import escape
from wcsim.errors import PolicyError, meant

NETWORK_NAMES: Final = ("conv3d", "convlstm", "fig6", "patch")
_MOST_CHARACTERS: Final = 56  # of a client's name, so that a number fits behind it


def client_name_from_network(network: str) -> str:
    """The name of a client with this network, unless its user gives one: a plain word.

    >>> client_name_from_network("own_file:OwnNet"), client_name_from_network("fig6")
    ('OwnNet', 'fig6')
    """
    return re.sub(r"[^A-Za-z0-9_-]", "_", network.rpartition(":")[2])[:_MOST_CHARACTERS]


def is_custom_network(name: str) -> bool:
    """Whether a network is a user's own class, `module:Class`."""
    return ":" in name


def require_known_network(name: str) -> None:
    """Refuse what is no network before torch is loaded for it; `find_network` checks the class.

    Raises:
        PolicyError: There is no such name, module or class; importing the module of `module:Class`
            runs its code.
    """
    # A caller that registered own names has loaded it.
    registry = sys.modules.get("wcsim.agents.networks.registry")
    if is_custom_network(name):
        import_class(name, "network")
    elif name not in NETWORK_NAMES and not (registry is not None and name in registry.NETWORKS):
        raise unknown_network_error(name, NETWORK_NAMES)


def unknown_network_error(name: str, known: tuple[str, ...]) -> PolicyError:
    """The error for a name that no network has."""
    names = ", ".join(sorted(known))
    message = f"unknown network {escape(name, 80)!r}; expected one of {names}, or module:Class"
    return PolicyError(message + meant(name, known))


def require_trusted_network(where: str, name: str, named: str | None) -> None:
    """Refuse a policy whose own network its user has not named: loading it runs its code.

    Args:
        where: The policy, as its user calls it.
        name: Its network.
        named: The one that was named.

    Raises:
        PolicyError: They differ.
    """
    if name != named:
        raise PolicyError(
            f"{where} uses the network {escape(name, 80)!r}, which is not part of wcsim, and "
            f"loading it runs its code; if you trust it, name it: --network {escape(name, 80)}"
        )
