"""What the barrier and its messages cost a tick."""
