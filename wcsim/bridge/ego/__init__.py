"""One wheelchair of a world with its user and its episode: slots, falls, what its cameras show."""
