"""Processes that watch each other: start, look after, start again, end."""
