"""A world's process from inside: opens or recovers the world, runs the loop, reports. Not who starts it."""
