"""Whose a crash is, and what it was in words."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

from wcsim.config import RewardConfig
from wcsim.supervisor.rewards import is_collision
from wcsim.types import Contact

Fault = Literal["own", "other"]
_NO_TOUCH = {"drop": "fell off a kerb", "tilt": "tilted too far", "acceleration": "was shaken too hard"}
_STANDING = {"ground": "the ground", "kerb": "a kerb", "static": "something that stands in the street"}
_LONGEST_ID = 100


def hardest(contacts: Sequence[Contact], config: RewardConfig) -> Contact | None:
    """The touch with the largest impulse of those that count as a collision, None when there is none."""
    counting = [contact for contact in contacts if is_collision(contact, config)]
    # At a tie the first one; contacts come sorted by kind, actor and part.
    return max(counting, key=lambda contact: contact.impulse_Ns, default=None)


def fault(reason: str, contacts: Sequence[Contact], config: RewardConfig) -> Fault:
    """Whose a crash is: the cause of its hardest touch; without a collision the chair's own."""
    hit = hardest(contacts, config) if reason == "collision" else None
    return "own" if hit is None else hit.cause


def blamed(reason: str, whose: str, words: str) -> str:
    """A crash in a line: its reason, whose fault it is, and `words` as those of `crash_words`."""
    return f"{reason}, {whose} fault: it {words}"


def crash_words(reason: str, contacts: Sequence[Contact], config: RewardConfig) -> str:
    """What a chair did that crashed, with whom by SUMO's id, and who came into whom.

    >>> hit = Contact(kind="car", part="body", impulse_Ns=9.0, cause="other", actor_id="v:flow.3")
    >>> crash_words("collision", (hit,), RewardConfig()), crash_words("drop", (), RewardConfig())
    ('was hit by car flow.3', 'fell off a kerb')
    """
    hit = hardest(contacts, config) if reason == "collision" else None
    if hit is None:
        return _NO_TOUCH.get(reason, reason)
    name = re.sub(r"~\d+$", "", hit.actor_id.partition(":")[2])[:_LONGEST_ID]  # of something articulated: the whole
    whom = _STANDING.get(hit.kind, f"{hit.kind} {name}".strip())
    return f"was hit by {whom}" if hit.cause == "other" else f"drove into {whom}"
