"""Whose a crash is, and what it was, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

from wcsim.config import RewardConfig
from wcsim.supervisor.rewards import is_collision
from wcsim.types import ClientSnapshot, Contact

Fault = Literal["own", "other"]


def hardest(contacts: Sequence[Contact], config: RewardConfig) -> Contact | None:
    """The touch with the largest impulse of those that count as a collision, None when there is none."""
    counting = [contact for contact in contacts if is_collision(contact, config)]
    return max(counting, key=lambda contact: contact.impulse_Ns, default=None)


def fault(reason: str, contacts: Sequence[Contact], config: RewardConfig) -> Fault:
    """Whose a crash is: the cause of its hardest touch; without a collision the chair's own."""
    hit = hardest(contacts, config) if reason == "collision" else None
    return "own" if hit is None else hit.cause

_CRASHES: Final = {"drop": "fell off a kerb", "tilt": "tilted too far", "acceleration": "was shaken too hard"}
_PARTNERS: Final = {"ground": "the ground", "static": "something that stands in the street", "other": "somebody"}


def crash_words(client: ClientSnapshot, reward: RewardConfig) -> str:
    """What ended an episode, for a person."""
    reason = client.events.crash_reason
    if reason != "collision":
        return _CRASHES.get(reason, reason)
    hit = hardest(client.contacts, reward)
    return "hit something" if hit is None else f"hit {_PARTNERS.get(hit.kind, f'a {hit.kind}')}"
