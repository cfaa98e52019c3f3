"""What the words of a suite's page mean: its policies, its parts, its users."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from wcsim.view.report.markup import Markup, el, joined
from wcsim.view.report.page import facts

POLICIES: Mapping[str, str] = MappingProxyType(
    {
        "follow": "the user alone: the stick as it is, no help",
        "stop": "no throttle before what the depth picture shows in the way",
        "dwa": "a classical controller on the chair's own senses: the stick position nearest to the user's that can "
        "still be braked",
        "zero": "the chair stands; for comparison",
        "random": "any stick position; for comparison",
        "oracle": "knows the true street and everybody in it: no help that could be built, but a bound",
        "oracle-visible": "the same, but of the others it knows those alone whom the camera has shown lately: a bound",
    }
)
PARTS: Mapping[str, str] = MappingProxyType(
    {
        "free": "ways of 60 to 160 m along pavements and over crossings; done by arriving",
        "crossing": "one crossing each; done by arriving",
        "hazard": "ways on which the user alone crashes: the policy takes over 10 s before, for 30 s; done by "
        "surviving",
        "tight": "generated scenes of what cannot be seen, or needs more than stopping; done by surviving",
    }
)
USERS: Mapping[str, str] = MappingProxyType(
    {
        "competent": "practised, obeys lights",
        "inattentive": "sees a third of what comes, looks away, keeps to a light four times of five",
        "ataxic": "a shaking hand, and no network was trained with it",
        "slow": "late and slow",
        "tremor": "a trembling hand",
        "switch": "on or off, no in between",
    }
)


def glossary(policies: Iterable[str], parts: Iterable[str], users: Iterable[str]) -> Markup:
    """A list of those that occur."""
    rows = [(name, _policy(name)) for name in policies]
    rows += [(f"part {name}", PARTS.get(name, "")) for name in parts]
    rows += [(f"user {name}", USERS.get(name, "a simulated user of one's own")) for name in users if ":" not in name]
    return joined((el("h3", "Who and what"), facts(rows)))


def _policy(name: str) -> str:
    who, at, level = name.partition("@")
    said = POLICIES.get(who, "a policy that was brought to the test")
    return f"{said}; assistance level {level}" if at else said
