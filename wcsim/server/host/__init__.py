"""A world process from inside: opens the world, runs the loop, reports. Not what starts it."""
