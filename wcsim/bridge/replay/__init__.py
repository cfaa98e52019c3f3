"""Worlds made again from their logs: played, verified."""
