"""What the words of a suite's page mean: its policies, its parts, its users."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from wcsim.view.report.markup import Markup, el, joined
from wcsim.view.report.page import facts

POLICIES: Mapping[str, str] = MappingProxyType(
    {
        "follow": "the user alone, without assistance",
        "shipped": "the policy that comes with wcsim",
        "stop": "stops when the depth image shows an obstacle in the way",
        "dwa": "a classical controller on the chair's own sensors: the stick position nearest to the user's from which "
        "it can still brake",
        "zero": "never moves; for comparison",
        "random": "any stick position; for comparison",
        "oracle": "knows the true state of the street: an upper bound, not an assistant that can be built",
        "oracle-visible": "the same, but knows only the road users that the camera showed lately: an upper bound",
    }
)
PARTS: Mapping[str, str] = MappingProxyType(
    {
        "free": "routes along pavements and over crossings; the aim is to arrive",
        "crossing": "one crossing each; the aim is to arrive",
        "hazard": "routes on which the user alone crashes: the policy takes over 10 s before, for 30 s; the aim is not "
        "to crash",
        "tight": "generated scenes with dangers that are out of view or need more than stopping; the aim is not to "
        "crash",
    }
)
USERS: Mapping[str, str] = MappingProxyType(
    {
        "competent": "practised, obeys lights",
        "inattentive": "notices a third of what comes, looks away, obeys four lights of five",
        "ataxic": "a shaking hand; no network was trained with it",
        "slow": "slow, with late reactions",
        "tremor": "a trembling hand",
        "switch": "four switches: full stick or none",
    }
)


def glossary(policies: Iterable[str], parts: Iterable[str], users: Iterable[str]) -> Markup:
    """A list of those that occur."""
    rows = [(name, _policy(name)) for name in policies]
    rows += [(f"part {name}", PARTS.get(name, "")) for name in parts]
    rows += [(f"user {name}", USERS.get(name, "a simulated user of your own")) for name in users if ":" not in name]
    return joined((el("h3", "Policies, parts and users"), facts(rows)))


def _policy(name: str) -> str:
    kind, at, level = name.partition("@")
    said = POLICIES.get(kind, "a policy named in the command")
    return f"{said}; assistance level {level}" if at else said
