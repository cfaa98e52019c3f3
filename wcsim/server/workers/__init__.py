"""Pieces of work that need no barrier, done by processes here or by nodes of a Ray cluster."""
