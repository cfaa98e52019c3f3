"""Processes that watch each other: start, look after, start again, end. A spawner for other machines goes here."""
