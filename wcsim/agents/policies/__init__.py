"""Policies that learn nothing: follow, dwa, oracle and others; and those of other projects."""
