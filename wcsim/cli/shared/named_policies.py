"""What a command does about a policy that it is given by name, before the simulators and torch are loaded for it."""

from __future__ import annotations

from wcsim.agents.networks.names import check_network, is_own, require_named
from wcsim.agents.policy_api import VETO
from wcsim.agents.runs.policy_file import is_danger, read_danger_file, read_policy_file
from wcsim.agents.runs.policy_name import policy_name
from wcsim.agents.runs.run_folder import policy_path
from wcsim.core.plugins import find_class
from wcsim.core.reading import escaped
from wcsim.errors import PolicyError


def require_policy(name: str, network: str) -> None:
    """Refuse what names no policy, and one with a network of somebody's own that was not named.

    Args:
        name: The policy; one that is module:Class is imported.
        network: The own network that was named, "" for none.

    Raises:
        PolicyError: There is no such policy or class, or its network was not named.
    """
    named = policy_name(name)
    if named.kind == "class":
        find_class(named.inner, "policy")
    elif named.is_network:
        used = _network_of(name)
        if is_own(used):
            require_named(escaped(name), used, network)


def require_driver(name: str, network: str) -> None:
    """The same for a command with a single policy, which also has to use the network that was named.

    Raises:
        PolicyError: As `require_policy`, or there is no such network, or another one.
    """
    require_policy(name, network)
    if not network:
        return
    check_network(network)
    if not policy_name(name).is_network or _network_of(name) != network:
        raise PolicyError(f"--network {escaped(network, 80)}: {escaped(name)} does not use it; leave it out")


def require_without_veto(name: str, does: str) -> None:
    """Refuse a policy behind a veto, where only its network is used. Raises PolicyError."""
    named = policy_name(name)
    if named.veto:
        raise PolicyError(
            f"{escaped(name)}: {does} uses the network alone; expected {escaped(named.inner)}, without {VETO}"
        )


def _network_of(name: str) -> str:
    """What a run's policy looks at pictures with. Raises PolicyError when there is no such run."""
    path = policy_path(name)
    return (read_danger_file if is_danger(path) else read_policy_file)(path).net.network
