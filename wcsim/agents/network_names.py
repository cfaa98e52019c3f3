"""The names of wcsim's own networks, for whoever must not load torch; `agents/registry.py` has the classes."""

from __future__ import annotations

import re

MOST_LETTERS = 56  # so that a number fits behind it

NETWORK_NAMES = ("fig6", "gru", "impala", "patch", "small", "stack")


def client_name(network: str) -> str:
    """What a client with this network is called, unless its user says otherwise: a plain word.

    >>> client_name("own_file:OwnNet"), client_name("fig6")
    ('OwnNet', 'fig6')
    """
    return re.sub(r"[^A-Za-z0-9_-]", "_", network.rpartition(":")[2])[:MOST_LETTERS]
