"""Drives of one chair in a world: a simulated user's recorded, and a recording made again. Their format: users."""
