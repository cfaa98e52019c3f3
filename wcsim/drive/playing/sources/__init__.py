"""What films are made of: states of a log, a log replayed, a run that grows, episodes. Each in its own process."""
