"""Drives of one chair in a world: who records them, and what a person in one wanted."""
