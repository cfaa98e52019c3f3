"""Whose a crash is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from wcsim.config import RewardConfig
from wcsim.supervisor.rewards import is_collision
from wcsim.types import Contact

Fault = Literal["own", "other"]


def hardest(contacts: Sequence[Contact], config: RewardConfig) -> Contact | None:
    """The touch with the largest impulse of those that count as a collision, None when there is none."""
    counting = [contact for contact in contacts if is_collision(contact, config)]
    return max(counting, key=lambda contact: contact.impulse_Ns, default=None)


def fault(reason: str, contacts: Sequence[Contact], config: RewardConfig) -> Fault:
    """Whose a crash is: the cause of its hardest touch; without a collision the chair's own."""
    hit = hardest(contacts, config) if reason == "collision" else None
    return "own" if hit is None else hit.cause
