"""The names of wcsim's own networks, for whoever must not load torch; `agents/registry.py` has the classes."""

from __future__ import annotations

NETWORK_NAMES = ("fig6", "gru", "impala", "patch", "small", "stack")
